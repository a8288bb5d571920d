"""Errors of the HTTP interface: a status, a stable code, a sentence and facts for programs.

ApiError (machine.errors.DownrangeError)
├── NotFoundError       404
├── ForbiddenError      403
├── NotSignedInError    401
├── ConflictError       409  the machine's or the lease's state does not allow it
├── InfeasibleError     422  well formed, and cannot be done
├── UnavailableError    503  lost machine, preview workers or database away
└── UnknownOutcomeError 504  a command whose answer was lost; never repeated by us
"""

from pydantic import JsonValue

from machine.errors import DownrangeError, RefusedError
from machine.messages import RejectReason


class ApiError(DownrangeError):
    """An error that becomes an answer in the one error shape."""

    status_code = 400

    def __init__(self, code: str, message: str, detail: JsonValue = None) -> None:
        super().__init__(message)
        self.code = code
        self.message = message
        self.detail = detail


class NotFoundError(ApiError):
    """No such thing."""

    status_code = 404


class ForbiddenError(ApiError):
    """Signed in, but not allowed."""

    status_code = 403


class NotSignedInError(ApiError):
    """No valid session."""

    status_code = 401


class TooManyRequestsError(ApiError):
    """Too many attempts."""

    status_code = 429


class ConflictError(ApiError):
    """The present state does not allow it."""

    status_code = 409


class InfeasibleError(ApiError):
    """What is asked is well formed and cannot be done."""

    status_code = 422


class UnavailableError(ApiError):
    """A part that is needed is away."""

    status_code = 503


class UnknownOutcomeError(ApiError):
    """A command was sent and its answer was lost."""

    status_code = 504


_STATUS = {
    RejectReason.NO_LEASE: ForbiddenError,
    RejectReason.MACHINE_LOST: UnavailableError,
    RejectReason.UNKNOWN_OUTCOME: UnknownOutcomeError,
}


def from_reason(reason: RejectReason, message: str, detail: JsonValue = None) -> ApiError:
    """The error for a refusal by machine or server; its code is the reason."""
    return _STATUS.get(reason, ConflictError)(reason.value, message, detail)


def from_refusal(error: RefusedError) -> ApiError:
    """The error for a refusal raised by shared code."""
    return from_reason(error.reason, error.detail)
