"""Limit of login attempts, against guessing passwords.

Attempts count for a device that has signed in before (OWASP: device cookies), else for name and address
and for the address. So guessing is slow from every address, and nobody's guesses lock out a person at
another address, or on a browser in which this person has signed in before.
"""

import ipaddress
import threading
import time
from collections import OrderedDict, deque
from collections.abc import Callable

from server.errors import TooManyRequestsError


class LoginRateLimit:
    """Counts attempts that did not succeed, in a sliding window."""

    WINDOW_S = 300.0
    NAME_LIMIT = 5
    """Of a name from one address, or of a known device."""
    ADDRESS_LIMIT = 50
    KEY_LIMIT = 10_000
    """Keys remembered; the oldest are forgotten."""

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        self._now_s = now_s
        self._lock = threading.Lock()
        self._attempts: OrderedDict[tuple[str, str], deque[float]] = OrderedDict()

    def attempt(self, username: str, address: str, device_id: str | None = None) -> None:
        """Count an attempt before its password is checked, so that attempts at one time count too.

        Raises:
            TooManyRequestsError: with the time to wait; a refused attempt does not count.
        """
        keys = self._keys(username, address, device_id)
        with self._lock:
            now_s = self._now_s()
            for key, limit in keys:
                attempts = self._attempts.get(key)
                while attempts and now_s - attempts[0] > self.WINDOW_S:
                    attempts.popleft()
                if attempts and len(attempts) >= limit:
                    wait_s = self.WINDOW_S - (now_s - attempts[0])
                    raise TooManyRequestsError(
                        "too_many_logins",
                        f"{len(attempts)} failed logins in {self.WINDOW_S / 60:.0f} min; "
                        f"wait {wait_s:.0f} s.",
                        {"retry_after_s": wait_s},
                    )
            for key, limit in keys:
                self._attempts.setdefault(key, deque(maxlen=limit)).append(now_s)
                self._attempts.move_to_end(key)
            while len(self._attempts) > self.KEY_LIMIT:
                self._attempts.popitem(last=False)

    def succeed(self, username: str, address: str, device_id: str | None = None) -> None:
        """Forget the attempts of a caller that signed in; of the shared counts only this one."""
        (own, _), *shared = self._keys(username, address, device_id)
        with self._lock:
            self._attempts.pop(own, None)
            for key, _ in shared:
                attempts = self._attempts.get(key)
                if attempts:
                    attempts.pop()

    def _keys(
        self, username: str, address: str, device_id: str | None
    ) -> list[tuple[tuple[str, str], int]]:
        if device_id is not None:
            return [(("device", f"{username} {device_id}"), self.NAME_LIMIT)]
        address = network_of(address)
        return [
            (("name at address", f"{username} {address}"), self.NAME_LIMIT),
            (("address", address), self.ADDRESS_LIMIT),
        ]


def network_of(address: str) -> str:
    """What counts as one address: of IPv6 the network of 64 bits, in which one computer may choose freely."""
    try:
        parsed = ipaddress.ip_address(address)
    except ValueError:
        return address
    if isinstance(parsed, ipaddress.IPv4Address):
        return address
    if parsed.ipv4_mapped is not None:
        return str(parsed.ipv4_mapped)
    return str(ipaddress.ip_network((parsed, 64), strict=False))
