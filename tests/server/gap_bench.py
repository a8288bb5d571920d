"""Throws with logs in a server's database, and diagnoses of them."""

import hashlib
import secrets
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
from sqlalchemy import delete

from machine.conventions import Mode
from machine.messages import Target, ThrowPlan
from machine.spec import load_spec
from server.accounts.accounts import Session
from server.child_process import ChildFailedError
from server.clock import new_id, utc_now
from server.composition import Parts
from server.gap.gap_service import GapService
from server.gap.gap_worker import (
    Diagnose,
    GapAnswer,
    GapJob,
    GapProcess,
    Progress,
    send_answer,
)
from server.schemas.console import Role
from server.store.models import Throw
from tests.server.server_bench import wait_for

RUNS = "/machines/m001/gap-runs"


def add_throws(
    parts: Parts,
    count: int,
    *,
    machine_id: str = "m001",
    mode: Mode = Mode.SPATIAL,
    logs: list[Path] | None = None,
    has_log: bool = True,
    outcome: str = "landed",
) -> list[str]:
    """Rows of throws and, by default, their logs; without files the logs hold nothing."""
    session = Session(new_id(), "ada", Role.OPERATOR, utc_now())
    throw_ids: list[str] = []
    for number in range(count):
        plan = ThrowPlan(
            plan_id=new_id(),
            machine_id=machine_id,
            mode=mode,
            target=Target(x_m=9.0, y_m=0.0),
            policy_sha256="a" * 64,
            model_sha256=load_spec().sha256,
            twin_profile_version=0,
            predicted_impact_m=(9.0, 0.0, 0.0),
        )
        throw_id = new_id()
        row = parts.throws.new_row(throw_id, plan, session, 1)
        row.outcome, row.phase = outcome, "ended"
        with parts.database.write() as database:
            database.add(row)
        if has_log:
            content = b"no log at all" + throw_id.encode()
            if logs is not None:
                content = logs[number].read_bytes()
            keep_log(parts, machine_id, throw_id, content)
        throw_ids.append(throw_id)
    return throw_ids


def forget_throws(parts: Parts) -> None:
    """Begin with none: how many throws there are, and which are the newest, is then one file's alone."""
    with parts.database.write() as database:
        database.execute(delete(Throw))


def keep_log(parts: Parts, machine_id: str, throw_id: str, content: bytes) -> None:
    folder = parts.settings.data_dir / "throws"
    folder.mkdir(parents=True, exist_ok=True)
    scratch = folder / f".{secrets.token_hex(8)}.part"
    scratch.write_bytes(content)
    digest = hashlib.sha256(content).hexdigest()
    parts.logs.keep(scratch, machine_id, throw_id, digest, len(content))


class GapThread(GapProcess):
    """The same answers without a process, which takes seconds to start."""

    def run(self, job: GapJob, progress: Progress, is_cancelled: Callable[[], bool]) -> GapAnswer:
        found: list[tuple[str, Any]] = []

        def take(message: tuple[str, Any]) -> None:
            if message[0] == "progress":
                progress(*message[1])
            else:
                found.append(message)

        send_answer(job, self._diagnose, take)
        ((kind, content),) = found
        if kind == "failed":
            raise ChildFailedError(content)
        return content


@contextmanager
def diagnosing(
    parts: Parts, diagnose: Diagnose, runner: type[GapProcess] = GapThread
) -> Generator[GapService]:
    """The server's runs use another diagnosis; what is open is cancelled at the end."""
    desk = parts.gap
    before, desk._process = desk._process, runner(diagnose)
    try:
        yield desk
    finally:
        for run in desk.queue.open_jobs():
            run.cancelled.set()
        wait_for(lambda: not desk.queue.open_jobs())
        desk._process = before


def start(client: httpx.Client, **body: Any) -> dict[str, Any]:
    """Ask for a diagnosis; its row."""
    reply = client.post(RUNS, json=body or {"newest_count": 6})
    assert reply.status_code == 202, reply.text
    return reply.json()


def ended(client: httpx.Client, run: dict[str, Any], timeout_s: float = 150.0) -> dict[str, Any]:
    """Wait until a run has ended; the whole of it."""
    path = f"{RUNS}/{run['gap_run_id']}"
    wait_for(lambda: client.get(path).json()["row"]["ended_utc"], timeout_s)
    return client.get(path).json()
