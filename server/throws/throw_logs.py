"""Log files of throws: taken from machines, kept by their hash, read for charts and replays."""

import hashlib
import os
import secrets
import threading
from collections import OrderedDict
from collections.abc import AsyncIterator
from pathlib import Path

from machine.errors import LogError
from runtime.records.throw_log import ThrowLog
from server.accounts.audit_chain import Actor, AuditChain, Entry
from server.clock import utc_now
from server.errors import ApiError, ConflictError, ForbiddenError, NotFoundError, UnavailableError
from server.schemas.history import ThrowLogView
from server.store.database import Database
from server.store.models import StoredThrowLog, Throw
from server.throws.limited_reader import LimitedLogReader

FOLDER = "throws"
_CACHED_COUNT = 8


class TooLargeError(ApiError):
    """An upload beyond the limit."""

    status_code = 413


class LogStore:
    """Files under the data folder and their rows."""

    def __init__(
        self, database: Database, audit: AuditChain, data_dir: Path, max_bytes: int
    ) -> None:
        self._database = database
        self._audit = audit
        self._root = data_dir
        self._max_bytes = max_bytes
        self._lock = threading.Lock()
        self._reader = LimitedLogReader()
        self._cache: OrderedDict[str, ThrowLog] = OrderedDict()

    def close(self) -> None:
        """End the reader's process."""
        self._reader.close()

    def require_throw(self, machine_id: str, throw_id: str) -> None:
        """Refuse a log before its bytes are taken, unless its throw is known and this machine's.

        Raises:
            NotFoundError: no such throw.
            ForbiddenError: the throw is another machine's.
        """
        with self._database.read() as database:
            _own_throw(database.get(Throw, throw_id), machine_id, throw_id)

    async def receive(self, chunks: AsyncIterator[bytes], expected_sha256: str) -> tuple[Path, int]:
        """Write an upload to a scratch file and check its hash; returns file and size.

        Raises:
            ApiError: too large, empty, or another hash than announced.
        """
        folder = self._root / FOLDER
        folder.mkdir(parents=True, exist_ok=True)
        scratch = folder / f".{secrets.token_hex(8)}.part"
        digest, size_bytes = hashlib.sha256(), 0
        try:
            with scratch.open("wb") as file:
                async for chunk in chunks:
                    size_bytes += len(chunk)
                    if size_bytes > self._max_bytes:
                        raise TooLargeError(
                            "log_too_large", f"The log is larger than {self._max_bytes} bytes."
                        )
                    digest.update(chunk)
                    file.write(chunk)
                file.flush()
                os.fsync(file.fileno())
            if size_bytes == 0 or digest.hexdigest() != expected_sha256:
                # A status that the machine takes as "try again": the bytes were damaged on their way.
                raise UnavailableError(
                    "hash_mismatch",
                    f"{size_bytes} bytes arrived with sha256 {digest.hexdigest()[:12]}, "
                    f"announced was {expected_sha256[:12]}. Send it again.",
                )
        except BaseException:
            scratch.unlink(missing_ok=True)
            raise
        return scratch, size_bytes

    def keep(
        self, scratch: Path, machine_id: str, throw_id: str, log_sha256: str, size_bytes: int
    ) -> bool:
        """Give a checked upload its place and its row; returns whether it was new.

        Raises:
            NotFoundError: no such throw.
            ForbiddenError: the throw is another machine's.
        """
        relative = Path(FOLDER) / log_sha256[:2] / f"{log_sha256}.mcap"
        target = self._root / relative
        try:
            with self._database.write() as database:
                throw = database.get(Throw, throw_id)
                row = database.get(StoredThrowLog, throw_id)
                throw = _own_throw(throw, machine_id, throw_id)
                if row is not None and row.log_sha256 == log_sha256 and target.exists():
                    return False
                target.parent.mkdir(parents=True, exist_ok=True)
                scratch.replace(target)
                values = {
                    "machine_id": machine_id,
                    "log_sha256": log_sha256,
                    "size_bytes": size_bytes,
                    "path": str(relative),
                    "received_utc": utc_now(),
                }
                if row is None:
                    database.add(StoredThrowLog(throw_id=throw_id, **values))
                else:
                    for name, value in values.items():
                        setattr(row, name, value)
                throw.has_log = True
                self._audit.append(
                    database,
                    Entry(
                        Actor(machine_id),
                        "throw.log",
                        "fact",
                        machine_id=machine_id,
                        throw_id=throw_id[:36],
                        detail={"log_sha256": log_sha256, "size_bytes": size_bytes},
                    ),
                )
                return True
        finally:
            scratch.unlink(missing_ok=True)

    def view(self, throw_id: str) -> ThrowLogView | None:
        """What is known about a throw's log."""
        with self._database.read() as database:
            row = database.get(StoredThrowLog, throw_id)
        if row is None:
            return None
        return ThrowLogView(
            log_sha256=row.log_sha256, size_bytes=row.size_bytes, received_utc=row.received_utc
        )

    def path(self, throw_id: str) -> Path:
        """The log file of a throw.

        Raises:
            NotFoundError: none has arrived, or its file is gone.
        """
        with self._database.read() as database:
            row = database.get(StoredThrowLog, throw_id)
        if row is None:
            raise NotFoundError("no_log", f"No log of throw {throw_id[:40]} has arrived (yet).")
        path = self._root / row.path
        if not path.is_file():
            raise NotFoundError("no_log", f"The log file of throw {throw_id} is gone: {row.path}.")
        return path

    def read(self, throw_id: str) -> ThrowLog:
        """The content of a throw's log.

        Raises:
            ApiError: none, or it cannot be read.
        """
        path = self.path(throw_id)
        key = path.stem
        with self._lock:
            if key in self._cache:
                self._cache.move_to_end(key)
                return self._cache[key]
        try:
            content = self._reader.read(path)
        except LogError as error:
            raise ConflictError("log_unreadable", f"The log cannot be read: {error}") from error
        with self._lock:
            self._cache[key] = content
            while len(self._cache) > _CACHED_COUNT:
                self._cache.popitem(last=False)
        return content


def _own_throw(throw: Throw | None, machine_id: str, throw_id: str) -> Throw:
    if throw is None:
        raise NotFoundError("no_throw", f"There is no throw '{throw_id[:40]}' for this log.")
    if throw.machine_id != machine_id:
        raise ForbiddenError("wrong_machine", f"Throw {throw_id} was not made by {machine_id}.")
    return throw
