"""Shadows of policy versions over a machine's recorded throws: one at a time, in a process of its own."""

import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from sqlalchemy import select

from evaluation.shadow.results import ShadowReport
from machine.errors import DownrangeError
from machine.spec import MachineSpec
from runtime.records.throw_log import ThrowLog
from server.child_process import ChildFailedError, ChildKilledError, Send, run_child
from server.errors import ApiError, ConflictError, NotFoundError, TooManyRequestsError
from server.plans.policy_store import PolicyStore, StoredPolicy
from server.schemas.validation import ShadowRequest
from server.store.database import Database
from server.store.models import Throw
from server.throws.throw_logs import LogStore

LIMIT_S: Final = 240.0
"""For one shadow; 12 throws take some 10 s of processor time."""


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
    """Runs versions over recorded throws; nothing is kept, for the same throws give the same answer."""

    def __init__(
        self, database: Database, policies: PolicyStore, logs: LogStore, spec: MachineSpec
    ) -> None:
        self._database = database
        self._policies = policies
        self._logs = logs
        self._spec = spec
        self._one = threading.Lock()

    def run(self, policy_sha256: str, request: ShadowRequest) -> ShadowReport:
        """Run a version over a machine's newest throws of its mode; blocks for some seconds.

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
            return self._run(candidate, request)
        finally:
            self._one.release()

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
        wanted = (
            select(Throw.throw_id)
            .where(
                Throw.machine_id == request.machine_id,
                Throw.mode == candidate.card.mode.value,
                Throw.has_log.is_(True),
            )
            .order_by(Throw.throw_id.desc())
            .limit(request.throws_count)
        )
        with self._database.read() as session:
            throw_ids = list(session.scalars(wanted))
        found: list[ThrowLog] = []
        for throw_id in reversed(throw_ids):
            try:
                found.append(self._logs.read(throw_id))
            except ApiError:
                continue
        if not found:
            raise ConflictError(
                "no_throws",
                f"{request.machine_id} has no {candidate.card.mode.value} throw with a log that can be read.",
            )
        return found


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
