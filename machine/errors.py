"""Errors that cross packages: one tree, each with a stable code; texts have numbers and remedy.

DownrangeError
├── UsageError       wrong arguments or settings
├── PolicyError      a policy file that cannot be used
├── PlantError       a driver or plant that broke its contract
├── LogError         a throw log that cannot be read
└── RefusedError     a throw that was refused (RejectReason)
"""

from machine.messages import RejectReason


class DownrangeError(Exception):
    """Base of all deliberate errors; ``code`` is stable, ``str`` is a text for users."""

    code = "error"


class UsageError(DownrangeError):
    """Arguments or settings that cannot work."""

    code = "usage"


class PolicyError(DownrangeError):
    """A policy file that is missing, truncated, of the wrong shape or for another machine."""

    code = "policy"


class PlantError(DownrangeError):
    """A driver or plant that broke its contract."""

    code = "plant"


class LogError(DownrangeError):
    """A throw log that cannot be read."""

    code = "log"


class RefusedError(DownrangeError):
    """A throw that was refused."""

    code = "refused"

    def __init__(self, reason: RejectReason, detail: str) -> None:
        super().__init__(detail)
        self.reason = reason
        self.detail = detail
