"""Wall clock and time-ordered ids of the server. Control uses the machine's own clock only."""

import secrets
import threading
import time
from datetime import UTC, datetime
from uuid import UUID

_lock = threading.Lock()
_last_ms_count = 0
_count = 0


def utc_now() -> datetime:
    """Now, aware UTC."""
    return datetime.now(UTC)


def new_id() -> str:
    """A UUID of version 7 (RFC 9562): later ids of this process sort after earlier ones."""
    global _last_ms_count, _count  # one sequence for the whole process
    with _lock:
        now_ms = time.time_ns() // 1_000_000
        if now_ms > _last_ms_count:
            _last_ms_count, _count = now_ms, secrets.randbits(11)
        else:
            # The clock did not advance: continue the count within the last millisecond.
            _count += 1
            if _count >= 1 << 12:
                _last_ms_count, _count = _last_ms_count + 1, 0
        return _assemble(_last_ms_count, _count, secrets.randbits(62))


def first_id_at(moment: datetime) -> str:
    """The smallest id of a moment, so that a bound on time is a bound on ids."""
    return _assemble(int(moment.timestamp() * 1000), 0, 0)


def id_at(moment: datetime) -> str:
    """An id with the time of `moment`, for imported records."""
    return _assemble(int(moment.timestamp() * 1000), secrets.randbits(12), secrets.randbits(62))


def _assemble(ms_count: int, high: int, low: int) -> str:
    value = (max(ms_count, 0) & ((1 << 48) - 1)) << 80
    value |= 0x7 << 76 | high << 64 | 0x2 << 62 | low
    return str(UUID(int=value))
