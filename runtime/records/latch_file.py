"""The latched stop or fault on the disk: one record, written in place, so that a full disk does not matter.

A record that is missing, torn or damaged is unknown, and a machine that does not know starts STOPPED. Only
a folder that never served a machine counts as unlatched.
"""

import json
import os
import threading
import zlib
from pathlib import Path
from typing import Any, Final

from machine.messages import ThrowState
from runtime.records.outbox import OutboxError
from runtime.throw.protocol import Latch

RECORD_BYTES: Final = 512
"""One sector: written whole or not at all."""
REASON_LIMIT_COUNT: Final = 160
"""Characters of a reason that are kept."""
UNKNOWN_ID: Final = "unknown"


class LatchFile:
    """Remembers the latch over restarts; safe from any thread."""

    def __init__(self, path: Path, *, is_new_machine: bool) -> None:
        """Open the file, and reserve its place on the disk where it does not exist.

        Args:
            path: of the record.
            is_new_machine: nothing was ever stored in this folder, so a missing file means no latch.
        """
        self._path = path
        self._lock = threading.Lock()
        self._latch: Latch | None = None
        if is_new_machine and not path.exists():
            self.write(None)
        else:
            self._latch = self._read()

    @property
    def latch(self) -> Latch | None:
        """The latch; one with the id `UNKNOWN_ID` where the record cannot be read."""
        return self._latch

    def write(self, latch: Latch | None) -> None:
        """Store a latch, or that there is none; durable when this returns.

        Raises:
            OutboxError: the disk refuses. What was there before may still be there.
        """
        body: dict[str, Any] = {}
        if latch is not None:
            reason = latch.reason[:REASON_LIMIT_COUNT]
            body = {"latch_id": latch.latch_id, "state": latch.state.value, "reason": reason}
        text = json.dumps(body).encode()
        record = (f"{zlib.crc32(text):08x}".encode() + text).ljust(RECORD_BYTES)
        with self._lock:
            try:
                descriptor = os.open(self._path, os.O_RDWR | os.O_CREAT, 0o600)
                try:
                    os.pwrite(descriptor, record[:RECORD_BYTES], 0)
                    os.fsync(descriptor)
                finally:
                    os.close(descriptor)
            except OSError as error:
                raise OutboxError(f"cannot write {self._path} ({error}); check the disk") from error
            self._latch = latch

    def clear(self, latch_id: str) -> None:
        """Forget a latch; one of another id stays.

        Raises:
            OutboxError: the disk refuses.
        """
        if self._latch is not None and self._latch.latch_id == latch_id:
            self.write(None)

    def _read(self) -> Latch | None:
        try:
            record = self._path.read_bytes()[:RECORD_BYTES].rstrip()
            if int(record[:8], 16) != zlib.crc32(record[8:]):
                raise ValueError("its checksum is wrong")
            body = json.loads(record[8:])
            if not body:
                return None
            return Latch(body["latch_id"], ThrowState(body["state"]), body["reason"])
        except (OSError, ValueError, KeyError, TypeError) as error:
            reason = f"whether this machine was stopped is unknown ({self._path.name}: {error})"
            return Latch(UNKNOWN_ID, ThrowState.STOPPED, reason)
