"""Device cookies: a browser in which a person has signed in proves it later by a signed value.

The value grants nothing; it only gives the browser a login limit of its own (server/limits/logins.py).
"""

import hashlib
import hmac
import re
import secrets
import threading
from pathlib import Path

from server.secret_files import write_secret

DEVICE_COOKIE = "downrange_device"
_VALUE = re.compile(r"([A-Za-z0-9_-]{22})\.([0-9a-f]{64})")


class KnownDevices:
    """Signs and checks device cookies with a key from a private file."""

    def __init__(self, key_path: Path) -> None:
        self._key_path = key_path
        self._lock = threading.Lock()
        self._key: bytes | None = None

    def issue(self, username: str, device_id: str | None = None) -> str:
        """The value of the cookie for a person who has signed in, for a new or the same device."""
        found = secrets.token_urlsafe(16) if device_id is None else device_id
        return f"{found}.{self._sign(username, found)}"

    def device_of(self, value: str | None, username: str) -> str | None:
        """The device's id; None if this person has not signed in there."""
        match = _VALUE.fullmatch(value or "")
        if match is None or not hmac.compare_digest(self._sign(username, match[1]), match[2]):
            return None
        return match[1]

    def _sign(self, username: str, device_id: str) -> str:
        message = f"{username}\n{device_id}".encode()
        return hmac.new(self._load_key(), message, hashlib.sha256).hexdigest()

    def _load_key(self) -> bytes:
        with self._lock:
            if self._key is None:
                if not self._key_path.exists():
                    write_secret(self._key_path, secrets.token_hex(32) + "\n")
                self._key = bytes.fromhex(self._key_path.read_text(encoding="utf-8").strip())
            return self._key
