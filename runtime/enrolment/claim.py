"""The HTTP calls of a machine that is being set up: its token against its credentials, its self-test."""

import http.client
import json
import urllib.error
import urllib.request
from datetime import datetime
from email.utils import parsedate_to_datetime
from typing import Any, Final

from pydantic import AwareDatetime, BaseModel, ConfigDict, ValidationError

from machine.errors import DownrangeError
from machine.policy_approval import SiteTrust

TIMEOUT_S: Final = 20.0
ANSWER_LIMIT_BYTES: Final = 1024 * 1024


class EnrolmentError(DownrangeError):
    """The server refuses, or cannot be reached."""

    code = "enrolment"


class Credentials(BaseModel):
    """What the server hands over, once."""

    model_config = ConfigDict(frozen=True)
    machine_id: str
    site: str
    password: str
    connect: tuple[str, ...]
    root_ca_pem: str | None
    server_utc: AwareDatetime
    trust: SiteTrust


def claim(server_url: str, token: str) -> Credentials:
    """Fetch the credentials that a token opens; it works once.

    Raises:
        EnrolmentError: refused, unreachable or unreadable.
    """
    answer = _call("POST", server_url, "enrolments/claim", {"token": token}, {})
    try:
        return Credentials.model_validate_json(answer)
    except ValidationError as error:
        raise EnrolmentError(f"the answer of {server_url} cannot be read: {error}") from error


def report_self_test(
    server_url: str, machine_id: str, password: str, items: list[dict[str, Any]]
) -> None:
    """Send what the self-test found.

    Raises:
        EnrolmentError: refused or unreachable.
    """
    headers = {"Authorization": f"Bearer {password}"}
    _call("PUT", server_url, f"machines/{machine_id}/self-test", {"items": items}, headers)


def server_time(server_url: str) -> datetime:
    """The server's wall clock, to a second; from the `Date` of any answer.

    Raises:
        EnrolmentError: unreachable, or no date.
    """
    request = urllib.request.Request(f"{server_url.rstrip('/')}/api/v1/health")
    try:
        with urllib.request.urlopen(request, timeout=TIMEOUT_S) as answer:
            return parsedate_to_datetime(answer.headers["Date"])
    except (OSError, http.client.HTTPException, TypeError, ValueError) as error:
        raise EnrolmentError(f"{server_url} cannot be reached: {error}") from error


def _call(
    method: str, server_url: str, path: str, body: dict[str, Any], headers: dict[str, str]
) -> bytes:
    request = urllib.request.Request(
        f"{server_url.rstrip('/')}/api/v1/{path}",
        data=json.dumps(body).encode(),
        method=method,
        headers={
            "Content-Type": "application/json",
            "X-Requested-With": "downrange-machine",
            **headers,
        },
    )
    try:
        with urllib.request.urlopen(request, timeout=TIMEOUT_S) as answer:
            return answer.read(ANSWER_LIMIT_BYTES)
    except urllib.error.HTTPError as error:
        with error:
            text = error.read(2000)
        raise EnrolmentError(_message(error.code, text)) from error
    except (OSError, http.client.HTTPException, ValueError) as error:
        raise EnrolmentError(f"{server_url} cannot be reached: {error}") from error


def _message(status: int, text: bytes) -> str:
    try:
        return str(json.loads(text)["error"]["message"])
    except (ValueError, KeyError, TypeError):
        return f"HTTP {status}; is this a Downrange server?"
