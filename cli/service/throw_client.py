"""A client of the HTTP interface that makes one throw: lease, plan, arm, fire, hold, wait for the impact.

It uses the same interface as the console and never talks to a machine directly.
"""

import json
import os
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Self

import httpx
import tyro
from websockets.exceptions import WebSocketException
from websockets.sync.client import connect
from websockets.sync.connection import Connection

from machine.conventions import DEFAULT_PACE_RATIO
from machine.errors import DownrangeError, UsageError
from server.accounts.access_control import WRITE_HEADER_VALUE
from server.accounts.accounts import COOKIE, FIRST_LOGIN_FILE

HOLD_PERIOD_S = 0.05
REPLY_LIMIT_S = 5.0
RENEW_PERIOD_S = 5.0
POLL_PERIOD_S = 0.1
PREVIEW_TIMEOUT_S = 30.0
DOWNLOAD_TIMEOUT_S = 180.0
"""The server collects a dossier before it sends the first byte."""
IMPACT_GRACE_S = 3.0
"""A survey may reach the server a little after the end of the throw."""


class ServerError(DownrangeError):
    """The server refused, or cannot be reached."""

    code = "server"


@dataclass(frozen=True, slots=True)
class ThrowReport:
    """What became of a throw; errors in frame `throw`, m."""

    throw_id: str
    state: str
    """Outcome of the throw: landed, aborted, stopped, ..."""
    predicted: dict[str, float | None]
    impact: dict[str, float | None]
    seconds: float
    detail: str = field(default="")


@dataclass(frozen=True)
class ServerLogin:
    """Which server, and by which account."""

    server: str = "http://127.0.0.1:8000"
    """Address of the server."""
    user: str | None = None
    """Account name; DOWNRANGE_USER if not given, else `operator` to throw and `admin` for policies."""
    password_file: Path | None = None
    """File with the password alone, or with lines `name password`."""

    def open(self, usual_user: str) -> "ThrowClient":
        """Sign in.

        Args:
            usual_user: account of the first login that this verb takes where none is named.

        Raises:
            UsageError: there is no password for the account.
        """
        name = self.user or os.environ.get("DOWNRANGE_USER") or usual_user
        first_login = Path(os.environ.get("DOWNRANGE_DATA_DIR", "data")) / FIRST_LOGIN_FILE
        file = self.password_file or Path(os.environ.get("DOWNRANGE_PASSWORD_FILE", first_login))
        return ThrowClient(self.server, name, login_from_file(file, name))


Login = Annotated[ServerLogin, tyro.conf.arg(name="")]
"""Its options stand beside the verb's own."""
USUAL_LOGIN = ServerLogin()


def login_from_file(path: Path, username: str) -> str:
    """The password of an account, from a file with it alone or with lines `name password`.

    Raises:
        UsageError: the file is missing or does not name the account.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise UsageError(
            f"password file {path} cannot be read ({error.strerror}); name one with --password-file"
        ) from error
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    for line in lines:
        if line.split()[0] == username and len(line.split()) == 2:
            return line.split()[1]
    if len(lines) == 1:
        return lines[0]
    raise UsageError(f"{path} holds no password for '{username}'; name another --user")


class ThrowClient:
    """A signed-in session; use as a context manager."""

    def __init__(self, server: str, username: str, password: str) -> None:
        self._server = server.rstrip("/")
        if not self._server.startswith(("http://", "https://")):
            raise UsageError(f"--server {server!r} is no address; as in http://127.0.0.1:8000")
        self._http = httpx.Client(
            base_url=f"{self._server}/api/v1",
            headers={"Origin": self._server, "X-Requested-With": WRITE_HEADER_VALUE},
            timeout=15.0,
        )
        self._login = {"username": username, "password": password}

    def __enter__(self) -> Self:
        try:
            self.call("POST", "/auth/login", self._login)
        except BaseException:
            self._http.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        try:
            self._http.post("/auth/logout")
        except httpx.HTTPError:
            pass  # the throw is reported; the session runs out by itself
        finally:
            self._http.close()

    def call(self, method: str, path: str, body: dict[str, Any] | None = None) -> Any:
        """Ask the server for something; the answer's JSON.

        Raises:
            ServerError: it refuses, or cannot be reached.
        """
        return self._send(method, path, json=body)

    def upload(self, path: str, files: dict[str, bytes], fields: dict[str, str]) -> Any:
        """Send files as a form; the answer's JSON.

        Args:
            path: of the interface.
            files: contents by file name.
            fields: further fields of the form.

        Raises:
            ServerError: it refuses, or cannot be reached.
        """
        parts = [("files", (name, content)) for name, content in files.items()]
        return self._send("POST", path, files=parts, data=fields)

    def download(self, path: str, query: dict[str, str], file: Path) -> int:
        """Write an answer to a file, which appears only when it is whole; returns its size in bytes.

        Args:
            path: of the interface.
            query: of the address.
            file: to be written.

        Raises:
            ServerError: it refuses, cannot be reached, or the answer breaks off.
            UsageError: the file cannot be written.
        """
        part = file.with_name(f"{file.name}.part")
        try:
            with (
                self._http.stream("GET", path, params=query, timeout=DOWNLOAD_TIMEOUT_S) as reply,
                part.open("wb") as out,
            ):
                if not reply.is_success:
                    reply.read()
                    raise _refusal(reply)
                for chunk in reply.iter_bytes():
                    out.write(chunk)
                size_bytes = out.tell()
            part.replace(file)
        except httpx.HTTPError as error:
            raise ServerError(f"{self._server} cannot be reached ({error})") from error
        except OSError as error:
            raise UsageError(f"{file} cannot be written: {error.strerror}") from error
        finally:
            part.unlink(missing_ok=True)
        return size_bytes

    def _send(self, method: str, path: str, **content: Any) -> Any:
        try:
            reply = self._http.request(method, path, **content)
        except httpx.HTTPError as error:
            raise ServerError(
                f"{self._server} cannot be reached ({error}); start it with `make demo` or "
                "`downrange server`, or name another --server"
            ) from error
        if reply.is_success:
            return reply.json() if reply.content else None
        raise _refusal(reply)

    def throw(
        self,
        machine_id: str,
        mode: str,
        target_m: tuple[float, float, float],
        timeout_s: float,
        pace_ratio: float = DEFAULT_PACE_RATIO,
    ) -> ThrowReport:
        """Make one throw at a point in frame `machine`, 0 careful .. 1 fast.

        Raises:
            ServerError: refused at any step, with the server's reason.
        """
        began_s = time.monotonic()
        self.call("POST", f"/machines/{machine_id}/lease")
        try:
            with Renewal(self.call, machine_id):
                plan = self._plan(machine_id, mode, target_m, pace_ratio)
                row = self._fire_and_hold(machine_id, plan["plan_id"], timeout_s)
        finally:
            self.call("DELETE", f"/machines/{machine_id}/lease")
        prediction = plan["prediction"]
        return ThrowReport(
            throw_id=row["throw_id"],
            state=row["outcome"] or row["phase"],
            predicted={
                "downrange_error_m": prediction["downrange_error_m"],
                "crossrange_error_m": prediction["crossrange_error_m"],
            },
            impact={
                "downrange_error_m": row["measured_downrange_error_m"],
                "crossrange_error_m": row["measured_crossrange_error_m"],
            },
            seconds=time.monotonic() - began_s,
            detail=row["detail"],
        )

    def _plan(
        self,
        machine_id: str,
        mode: str,
        target_m: tuple[float, float, float],
        pace_ratio: float,
    ) -> dict[str, Any]:
        machine = self.call("GET", f"/machines/{machine_id}")
        if machine["state"] is not None and not machine["state"]["payload_held"]:
            self.call("POST", f"/machines/{machine_id}/load")
            self._wait_for_load(machine_id)
        plan = self.call(
            "POST",
            f"/machines/{machine_id}/plans",
            {
                "mode": mode,
                "target": dict(zip(("x_m", "y_m", "z_m"), target_m, strict=True)),
                "pace_ratio": pace_ratio,
            },
        )
        end_s = time.monotonic() + PREVIEW_TIMEOUT_S
        while plan["state"] == "previewing" and time.monotonic() < end_s:
            time.sleep(POLL_PERIOD_S)
            plan = self.call("GET", f"/plans/{plan['plan_id']}")
        if plan["state"] != "ready":
            reasons = " ".join(item["detail"] for item in plan["refusals"])
            raise ServerError(
                reasons or f"no preview within {PREVIEW_TIMEOUT_S:.0f} s (state {plan['state']})"
            )
        return plan

    def _wait_for_load(self, machine_id: str) -> None:
        end_s = time.monotonic() + 10.0
        while time.monotonic() < end_s:
            state = self.call("GET", f"/machines/{machine_id}")["state"]
            if state is not None and state["payload_held"]:
                return
            time.sleep(POLL_PERIOD_S)
        raise ServerError(f"{machine_id} took up no load within 10 s; put one into its gripper")

    def _fire_and_hold(self, machine_id: str, plan_id: str, timeout_s: float) -> dict[str, Any]:
        cookie = self._http.cookies.get(COOKIE)
        address = f"ws{self._server.removeprefix('http')}/api/v1/machines/{machine_id}/hold"
        try:
            with connect(
                address,
                additional_headers={"Cookie": f"{COOKIE}={cookie}", "Origin": self._server},
                proxy=None,
            ) as socket:
                self.call("POST", f"/plans/{plan_id}/arm", {})
                fired = self.call("POST", f"/plans/{plan_id}/fire")
                with Holding(socket, fired["throw_id"]):
                    return self._wait_for_end(fired["throw_id"], timeout_s)
        except (OSError, WebSocketException) as error:
            raise ServerError(f"the hold connection failed: {error}") from error

    def _wait_for_end(self, throw_id: str, timeout_s: float) -> dict[str, Any]:
        end_s = time.monotonic() + timeout_s
        row: dict[str, Any] = {}
        while time.monotonic() < end_s:
            row = self.call("GET", f"/throws/{throw_id}")["row"]
            if row["phase"] == "ended":
                if row["outcome"] != "landed" or row["measured_downrange_error_m"] is not None:
                    return row
                end_s = min(end_s, time.monotonic() + IMPACT_GRACE_S)
            time.sleep(POLL_PERIOD_S)
        if row.get("phase") == "ended":
            return row
        raise ServerError(
            f"throw {throw_id} did not end within {timeout_s:.0f} s (phase {row.get('phase')}); "
            "it was let go; look at the machine"
        )


def _refusal(reply: httpx.Response) -> ServerError:
    try:
        error_body = reply.json()["error"]
        return ServerError(f"{error_body['message']} [{error_body['code']}]")
    except (ValueError, KeyError, TypeError):
        return ServerError(f"HTTP {reply.status_code}; is this a Downrange server?")


class Renewal:
    """Renews the lease while the block runs."""

    def __init__(self, call: Any, machine_id: str) -> None:
        self.call = call
        self._path = f"/machines/{machine_id}/lease"
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._done.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._done.wait(RENEW_PERIOD_S):
            try:
                self.call("POST", self._path)
            except ServerError:
                return  # the next step of the throw is refused and says why


class Holding:
    """Sends the hold 20 times a second while the block runs, then lets go."""

    def __init__(self, socket: Connection, throw_id: str) -> None:
        self._socket = socket
        self._throw_id = throw_id
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._done.set()
        self._thread.join()

    def _say(self, *, is_holding: bool, seen_ns: int | None) -> int | None:
        said = {
            "throw_id": self._throw_id,
            "holding": is_holding,
            "machine_t_mono_ns": seen_ns,
        }
        self._socket.send(json.dumps(said))
        return json.loads(self._socket.recv(REPLY_LIMIT_S))["machine_t_mono_ns"]

    def _run(self) -> None:
        try:
            seen_ns = self._say(is_holding=True, seen_ns=None)
            while not self._done.is_set():
                seen_ns = self._say(is_holding=True, seen_ns=seen_ns)
                self._done.wait(HOLD_PERIOD_S)
            self._say(is_holding=False, seen_ns=seen_ns)
        except (WebSocketException, TimeoutError):
            return  # without messages the machine lets go by itself
