"""Limit of failed logins, against guessing passwords."""

import threading
import time
from collections import OrderedDict, deque
from collections.abc import Callable

from server.errors import TooManyRequestsError


class LoginRateLimit:
    """Limits failed logins for a name from an address, and for an address in all."""

    WINDOW_S = 300.0
    NAME_LIMIT = 5
    ADDRESS_LIMIT = 50
    KEY_LIMIT = 10_000
    """Keys remembered; the oldest are forgotten."""

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        self._now_s = now_s
        self._lock = threading.Lock()
        self._failures: OrderedDict[tuple[str, str], deque[float]] = OrderedDict()

    def check(self, username: str, address: str) -> None:
        """Refuse another attempt while there were too many.

        Raises:
            TooManyRequestsError: with the time to wait.
        """
        with self._lock:
            now_s = self._now_s()
            for key, limit in self._keys(username, address):
                failures = self._failures.get(key)
                while failures and now_s - failures[0] > self.WINDOW_S:
                    failures.popleft()
                if failures and len(failures) >= limit:
                    wait_s = self.WINDOW_S - (now_s - failures[0])
                    raise TooManyRequestsError(
                        "too_many_logins",
                        f"{len(failures)} failed logins in {self.WINDOW_S / 60:.0f} min; "
                        f"wait {wait_s:.0f} s.",
                        {"retry_after_s": wait_s},
                    )

    def fail(self, username: str, address: str) -> None:
        """Note a failed login."""
        with self._lock:
            for key, limit in self._keys(username, address):
                self._failures.setdefault(key, deque(maxlen=limit)).append(self._now_s())
                self._failures.move_to_end(key)
            while len(self._failures) > self.KEY_LIMIT:
                self._failures.popitem(last=False)

    def succeed(self, username: str, address: str) -> None:
        """Forget the failures of a name that got in."""
        with self._lock:
            self._failures.pop((username, address), None)

    def _keys(self, username: str, address: str) -> list[tuple[tuple[str, str], int]]:
        return [((username, address), self.NAME_LIMIT), (("", address), self.ADDRESS_LIMIT)]
