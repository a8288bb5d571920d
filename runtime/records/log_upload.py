"""Sends finished throw logs to the server by HTTP PUT, oldest first, until the server has them.

Repeating an upload is harmless: the address names the throw and the header the content. Throws never wait
for it; the thread only reads files.
"""

import http.client
import logging
import threading
import urllib.error
import urllib.request
from dataclasses import dataclass
from enum import Enum
from hashlib import sha256
from pathlib import Path
from typing import Final

from runtime.records.journal import Journal
from runtime.records.outbox import OutboxError
from runtime.records.recorder import log_path

logger = logging.getLogger(__name__)

TIMEOUT_S: Final = 20.0
RETRY_MIN_S: Final = 1.0
RETRY_MAX_S: Final = 60.0
FINAL_REFUSALS: Final = frozenset({400, 409, 413, 415, 422})
"""The server has looked at this content and will never take it; the file stays on the machine."""


class UploadOutcome(Enum):
    """How one attempt went."""

    STORED = "stored"
    REFUSED = "refused"
    RETRY = "retry"


@dataclass(frozen=True, slots=True)
class UploadTarget:
    """The server's HTTP interface, as one machine sees it."""

    server_url: str
    """e.g. ``http://127.0.0.1:8000``"""
    machine_id: str
    token: str


def upload_log(target: UploadTarget, throw_id: str, content: bytes) -> UploadOutcome:
    """PUT one log; never raises for what a network or server may do."""
    request = urllib.request.Request(
        f"{target.server_url.rstrip('/')}/api/v1/machines/{target.machine_id}/throw-logs/{throw_id}",
        data=content,
        method="PUT",
        headers={
            "Authorization": f"Bearer {target.token}",
            "Content-Type": "application/octet-stream",
            "X-Content-SHA256": sha256(content).hexdigest(),
            "X-Requested-With": "downrange-machine",
        },
    )
    try:
        with urllib.request.urlopen(request, timeout=TIMEOUT_S) as answer:
            answer.read()
        return UploadOutcome.STORED
    except urllib.error.HTTPError as error:
        with error:
            text = error.read(500).decode(errors="replace")
        logger.warning("server answers %d to the log of %s: %s", error.code, throw_id, text)
        return UploadOutcome.REFUSED if error.code in FINAL_REFUSALS else UploadOutcome.RETRY
    except (OSError, http.client.HTTPException) as error:
        logger.info("log of %s could not be sent: %s", throw_id, error)
        return UploadOutcome.RETRY


class LogUploader:
    """A thread that empties the journal's list of logs."""

    def __init__(self, target: UploadTarget, journal: Journal, folder: Path) -> None:
        self._target = target
        self._journal = journal
        self._folder = folder
        self._news = threading.Event()
        self._is_closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="log-upload", daemon=True)

    def start(self) -> None:
        """Begin, with what an earlier start left over."""
        self._thread.start()

    def wake(self) -> None:
        """A log was stored."""
        self._news.set()

    def close(self, timeout_s: float = 2.0) -> None:
        """Stop; an upload in flight is abandoned with the process and repeated at the next start."""
        self._is_closing.set()
        self._news.set()
        self._thread.join(timeout_s)

    def _run(self) -> None:
        wait_s = RETRY_MIN_S
        while not self._is_closing.is_set():
            self._news.clear()
            try:
                is_empty, has_progress = self.send_all()
            except OutboxError as error:
                logger.error("%s", error)
                is_empty = has_progress = False
            if is_empty:
                wait_s = RETRY_MIN_S
                self._news.wait()
            elif not has_progress:
                # Also a log that comes meanwhile waits: the server has just shown that it is not there.
                self._is_closing.wait(wait_s)
                wait_s = min(wait_s * 2.0, RETRY_MAX_S)

    def send_all(self) -> tuple[bool, bool]:
        """Try every waiting log once; whether none waited, and whether one was dealt with.

        A log that the server does not want yet (it may not know the throw) holds up no other one.
        """
        throw_ids = self._journal.to_upload()
        has_progress = False
        for throw_id in throw_ids:
            if self._is_closing.is_set():
                break
            if self._send(throw_id) is not UploadOutcome.RETRY:
                self._journal.mark_uploaded(throw_id)
                has_progress = True
        return not throw_ids, has_progress

    def _send(self, throw_id: str) -> UploadOutcome:
        try:
            content = log_path(self._folder, throw_id).read_bytes()
        except OSError as error:
            logger.error("the log of %s is gone from the disk (%s); not uploaded", throw_id, error)
            return UploadOutcome.REFUSED
        return upload_log(self._target, throw_id, content)
