"""A browser's hold for tests: sends 20 times a second until it is released."""

import json
import threading
import time

import httpx
from websockets.sync.client import connect

from server.accounts.accounts import COOKIE


class Hold:
    """Use as a context manager; `throw_id` is set once fire has answered."""

    def __init__(self, url: str, client: httpx.Client, machine_id: str = "m001", **headers: str):
        self._address = f"ws{url.removeprefix('http')}/api/v1/machines/{machine_id}/hold"
        self._headers = {"Origin": url, "Cookie": f"{COOKIE}={client.cookies.get(COOKIE)}"}
        self._headers |= headers
        self.throw_id: str | None = None
        self.holding = True
        self.silent = False
        self.replies: list[dict[str, object]] = []
        self._done = threading.Event()

    def __enter__(self):
        self.socket = connect(self._address, additional_headers=self._headers, proxy=None)
        self._threads = [
            threading.Thread(target=target, daemon=True) for target in (self._send, self._receive)
        ]
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_):
        self._done.set()
        self._threads[0].join()
        self.socket.close()
        self._threads[1].join()

    def _send(self):
        while not self._done.is_set():
            if self.throw_id is not None and not self.silent:
                seen = self.replies[-1]["machine_t_mono_ns"] if self.replies else None
                said = {"throw_id": self.throw_id, "holding": self.holding}
                self.socket.send(json.dumps(said | {"machine_t_mono_ns": seen}))
            time.sleep(0.03)

    def _receive(self):
        for message in self.socket:
            self.replies.append(json.loads(message))
