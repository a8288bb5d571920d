"""An HTTP server with what a machine asks of the real one about policies; it can break off and lie."""

import json
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from hashlib import sha256
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from machine.policy_card import CARD_FILE, GOLDEN_FILE, POLICY_FILE, load_card


class PolicyServer(ThreadingHTTPServer):
    daemon_threads = True

    def __init__(self) -> None:
        self.wanted: list[dict[str, Any]] = []
        self.folders: dict[str, Path] = {}
        self.breaks_after_bytes: list[int] = []
        """The next answers end so early."""
        self.ranges: list[str] = []
        self.asked: list[str] = []
        """Queries of the requests for what is wanted."""
        self.may_answer = threading.Event()
        """Cleared: files are asked for and do not come."""
        self.may_answer.set()
        self.has_ranges = True
        self.spoils = False
        self.trust: dict[str, Any] | None = None
        super().__init__(("127.0.0.1", 0), Handler)

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_address[1]}"

    def want(self, folder: Path, deployment_count: int, *, is_rollback: bool = False) -> str:
        """Deploy a version; replaces what was wanted in its mode."""
        card = load_card(folder)
        self.folders[card.policy_sha256] = folder
        files = [
            {
                "name": name,
                "sha256": sha256((folder / name).read_bytes()).hexdigest(),
                "size_bytes": (folder / name).stat().st_size,
            }
            for name in (POLICY_FILE, CARD_FILE, GOLDEN_FILE)
            if (folder / name).is_file()
        ]
        row = {
            "mode": card.mode.value,
            "deployment_count": deployment_count,
            "is_rollback": is_rollback,
            "policy_sha256": card.policy_sha256,
            "asked_s": time.monotonic(),
            "files": files,
        }
        self.wanted = [w for w in self.wanted if w["mode"] != row["mode"]] + [row]
        return card.policy_sha256


class Handler(BaseHTTPRequestHandler):
    server: PolicyServer

    def do_GET(self) -> None:
        if self.path.partition("?")[0].endswith("/policies/wanted"):
            self.server.asked.append(self.path.partition("?")[2])
            now_s = time.monotonic()
            wanted = [w | {"age_s": now_s - w["asked_s"]} for w in self.server.wanted]
            self._answer(200, json.dumps({"policies": wanted, "trust": self.server.trust}).encode())
            return
        policy_sha256, name = self.path.rsplit("/", 2)[1:]
        content = (self.server.folders[policy_sha256] / name).read_bytes()
        if self.server.spoils:
            content = content[:-1] + bytes([content[-1] ^ 1])
        asked = self.headers.get("Range", "")
        self.server.ranges.append(asked)
        self.server.may_answer.wait()
        if asked and self.server.has_ranges:
            first = int(asked.removeprefix("bytes=").rstrip("-"))
            self._answer(206, content[first:])
        else:
            self._answer(200, content)

    def _answer(self, status: int, content: bytes) -> None:
        self.send_response(status)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        is_file = "policy-files" in self.path
        if is_file and self.server.breaks_after_bytes:
            content = content[: self.server.breaks_after_bytes.pop(0)]
        self.wfile.write(content)

    def log_message(self, *_: object) -> None:
        return


@contextmanager
def policy_server() -> Iterator[PolicyServer]:
    server = PolicyServer()
    thread = threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True)
    thread.start()
    try:
        yield server
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
