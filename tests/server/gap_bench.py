"""Throws with logs in a server's database."""

import hashlib
import secrets
from pathlib import Path

from machine.conventions import Mode
from machine.messages import Target, ThrowPlan
from machine.spec import load_spec
from server.accounts.auth import Session
from server.clock import new_id, utc_now
from server.schemas.console import Role
from server.services import Services


def add_throws(
    services: Services,
    count: int,
    *,
    machine_id: str = "m001",
    mode: Mode = Mode.SPATIAL,
    logs: list[Path] | None = None,
    has_log: bool = True,
    outcome: str = "landed",
) -> list[str]:
    """Rows of throws and, unless told otherwise, their logs; without files the logs hold nothing."""
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
        row = services.throws.new_row(throw_id, plan, session, 1)
        row.outcome, row.phase = outcome, "ended"
        with services.database.write() as database:
            database.add(row)
        if has_log:
            content = b"no log at all" + throw_id.encode()
            if logs is not None:
                content = logs[number].read_bytes()
            keep_log(services, machine_id, throw_id, content)
        throw_ids.append(throw_id)
    return throw_ids


def keep_log(services: Services, machine_id: str, throw_id: str, content: bytes) -> None:
    folder = services.settings.data_dir / "throws"
    folder.mkdir(parents=True, exist_ok=True)
    scratch = folder / f".{secrets.token_hex(8)}.part"
    scratch.write_bytes(content)
    digest = hashlib.sha256(content).hexdigest()
    services.logs.keep(scratch, machine_id, throw_id, digest, len(content))
