"""Shadows of policy versions over recorded throws: one at a time, in a process of its own; each is kept."""

import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from sqlalchemy import select
from sqlalchemy.orm import undefer

from evaluation.shadow.results import ShadowFigures, ShadowReport, shadow_figures
from machine.errors import DownrangeError
from machine.spec import MachineSpec
from runtime.records.throw_log import ThrowLog
from server.accounts.accounts import Session
from server.child_process import ChildFailedError, ChildKilledError, Send, run_child
from server.clock import first_id_at, new_id, utc_now
from server.errors import ApiError, ConflictError, NotFoundError, TooManyRequestsError
from server.plans.policy_store import PolicyStore, StoredPolicy
from server.schemas.validation import ShadowRequest, ShadowRunSummary, ShadowRunView
from server.store.database import Database
from server.store.models import Policy, Throw
from server.store.validation_tables import PolicyShadow
from server.throws.throw_logs import LogStore

LIMIT_S: Final = 240.0
"""For one shadow; 12 throws take some 10 s of processor time."""
LIST_COUNT: Final = 50
"""Newest shadows of a version that are listed."""


@dataclass(frozen=True, slots=True)
class ShadowJob:
    """One shadow, as it travels to its process."""

    candidate: Path
    """Folder of the version."""
    flown: Mapping[str, Path]
    """Folders of versions that flew, by sha256."""
    logs: Sequence[ThrowLog]
    spec: MachineSpec


class ShadowRuns:
    """Runs versions over recorded throws, and lists what was run."""

    def __init__(
        self, database: Database, policies: PolicyStore, logs: LogStore, spec: MachineSpec
    ) -> None:
        self._database = database
        self._policies = policies
        self._logs = logs
        self._spec = spec
        self._one = threading.Lock()

    def run(self, policy_sha256: str, request: ShadowRequest, session: Session) -> ShadowRunView:
        """Run a version over the newest throws of its mode; blocks for some seconds.

        Raises:
            NotFoundError: no files of such a version.
            ConflictError: no throw can be used, or it took too long.
            TooManyRequestsError: another shadow runs.
        """
        candidate = self._policies.find(policy_sha256)
        if candidate is None:
            raise NotFoundError(
                "no_policy", f"There are no files of policy {policy_sha256[:12]} here."
            )
        if not self._one.acquire(blocking=False):
            raise TooManyRequestsError(
                "shadow_busy", "Another shadow is under way. Try again in half a minute."
            )
        try:
            report = self._run(candidate, request)
        finally:
            self._one.release()
        row = PolicyShadow(
            shadow_id=new_id(),
            policy_sha256=policy_sha256,
            machine_id=request.machine_id,
            since_utc=request.since_utc,
            until_utc=request.until_utc,
            created_by=session.username,
            created_utc=utc_now(),
            figures=shadow_figures(report).model_dump(mode="json"),
            report=report.model_dump(mode="json"),
        )
        with self._database.write() as writing:
            writing.add(row)
        return self.view(row.shadow_id)

    def newest(self, policy_sha256: str) -> list[ShadowRunSummary]:
        """The newest shadows of a version, newest first."""
        wanted = (
            select(PolicyShadow, Policy.policy_id)
            .join(Policy, Policy.policy_sha256 == PolicyShadow.policy_sha256)
            .where(PolicyShadow.policy_sha256 == policy_sha256)
            .order_by(PolicyShadow.shadow_id.desc())
            .limit(LIST_COUNT)
        )
        with self._database.read() as reading:
            return [_summary(row, name) for row, name in reading.execute(wanted)]

    def view(self, shadow_id: str) -> ShadowRunView:
        """A shadow with its throws.

        Raises:
            NotFoundError: there is none of this id.
        """
        wanted = (
            select(PolicyShadow, Policy.policy_id)
            .join(Policy, Policy.policy_sha256 == PolicyShadow.policy_sha256)
            .where(PolicyShadow.shadow_id == shadow_id)
            .options(undefer(PolicyShadow.report))
        )
        with self._database.read() as reading:
            found = reading.execute(wanted).first()
        if found is None:
            raise NotFoundError("no_shadow", f"There is no shadow '{shadow_id[:40]}'.")
        row, policy_id = found
        summary = _summary(row, policy_id)
        return ShadowRunView(**dict(summary), report=ShadowReport.model_validate(row.report))

    def _run(self, candidate: StoredPolicy, request: ShadowRequest) -> ShadowReport:
        logs = self._read(candidate, request)
        flew = {str(log.metadata.get("policy_sha256")) for log in logs}
        stored = [found for sha256 in sorted(flew) if (found := self._policies.find(sha256))]
        job = ShadowJob(
            candidate.folder,
            {one.card.policy_sha256: one.folder for one in stored},
            logs,
            self._spec,
        )
        end_s = time.monotonic() + LIMIT_S
        try:
            return run_child(
                send_shadow, (job,), "shadow", lambda *_: None, lambda: time.monotonic() > end_s
            )
        except ChildKilledError:
            raise ConflictError(
                "shadow_slow", f"It was not done within {LIMIT_S:.0f} s. Take fewer throws."
            ) from None
        except ChildFailedError as error:
            raise ConflictError("shadow_failed", f"It cannot be shadowed: {error}.") from error

    def _read(self, candidate: StoredPolicy, request: ShadowRequest) -> list[ThrowLog]:
        """Logs of the newest throws, oldest first; unreadable ones are left out."""
        wanted = select(Throw.throw_id).where(
            Throw.mode == candidate.card.mode.value, Throw.has_log.is_(True)
        )
        if request.machine_id is not None:
            wanted = wanted.where(Throw.machine_id == request.machine_id)
        if request.since_utc is not None:
            wanted = wanted.where(Throw.throw_id >= first_id_at(request.since_utc))
        if request.until_utc is not None:
            wanted = wanted.where(Throw.throw_id < first_id_at(request.until_utc))
        wanted = wanted.order_by(Throw.throw_id.desc()).limit(request.throws_count)
        with self._database.read() as session:
            throw_ids = list(session.scalars(wanted))
        found: list[ThrowLog] = []
        for throw_id in reversed(throw_ids):
            try:
                found.append(self._logs.read(throw_id))
            except ApiError:
                continue
        if not found:
            period = "" if request.since_utc is request.until_utc is None else " in this period"
            raise ConflictError(
                "no_throws",
                f"There is no {candidate.card.mode.value} throw of {request.machine_id or 'any machine'}"
                f"{period} with a log that can be read.",
            )
        return found


def _summary(row: PolicyShadow, policy_id: str) -> ShadowRunSummary:
    return ShadowRunSummary(
        shadow_id=row.shadow_id,
        policy_sha256=row.policy_sha256,
        policy_id=policy_id,
        machine_id=row.machine_id,
        since_utc=row.since_utc,
        until_utc=row.until_utc,
        created_by=row.created_by,
        created_utc=row.created_utc,
        figures=ShadowFigures.model_validate(row.figures),
    )


# In the process --------------------------------------------------------------------------------------


def send_shadow(job: ShadowJob, send: Send) -> None:
    """Shadow; sends ("done", ShadowReport) or ("failed", reason)."""
    # Imported here: the server's own process does not need the simulator.
    from evaluation.shadow.shadow import shadow
    from runtime.control.policy import PolicyRunner

    try:
        candidate = PolicyRunner(job.candidate, job.spec)
        flown: dict[str, PolicyRunner] = {}
        for sha256, folder in job.flown.items():
            flown[sha256] = PolicyRunner(folder, job.spec)
        send(("done", shadow(candidate, job.logs, job.spec, flown)))
    except DownrangeError as error:
        send(("failed", str(error)))
