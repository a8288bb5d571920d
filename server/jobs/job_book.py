"""Jobs as they are read and stored: their ground, their versions, and the plans that follow a change."""

import threading
from collections.abc import Callable, Sequence

from pydantic import JsonValue

from bulk.height_field import HeightField
from machine.spec import MachineSpec
from server.accounts.audit_chain import Actor, AuditChain, Entry
from server.event_hub import EventHub
from server.jobs.job_ground import JobGround, JobGrounds, JobState
from server.jobs.job_store import (
    JobRecord,
    Planned,
    open_job_id,
    open_job_ids,
    progress_of,
    read_record,
)
from server.jobs.job_views import JobChange, PlanningState
from server.jobs.throw_loads import offers
from server.schemas.events import JobUpdatedEvent
from server.store.database import Database
from server.store.job_tables import JobLoad, JobRow, JobSurvey

Submit = Callable[[JobRecord, JobGround, HeightField], None]
"""Plans the next loads of a job on its present surface."""


class JobBook:
    """All jobs in the database.

    Surfaces are computed outside of transactions: who changes a job holds `lock` from reading to `commit`.
    """

    def __init__(
        self, database: Database, audit: AuditChain, hub: EventHub, spec: MachineSpec, plan: Submit
    ) -> None:
        self.database = database
        self.audit = audit
        self.grounds = JobGrounds(spec)
        self.lock = threading.RLock()
        self._hub = hub
        self._plan = plan
        self.on_change: list[Callable[[str], None]] = []
        """Called with the machine's id after a job of it has changed."""

    def read(self, job_id: str) -> JobRecord:
        """A job.

        Raises:
            NotFoundError: there is none.
        """
        with self.database.read() as database:
            return read_record(database, job_id)

    def open_record(self, machine_id: str) -> JobRecord | None:
        """The open job of a machine."""
        with self.database.read() as database:
            job_id = open_job_id(database, machine_id)
            return None if job_id is None else read_record(database, job_id)

    def for_change(self, job_id: str, body: JobChange) -> JobRecord:
        """A job that is changed; under `lock`.

        Raises:
            NotFoundError: there is none.
            ConflictError: it has changed, or has ended.
        """
        record = self.read(job_id)
        record.require_version(body.version_count)
        return record

    def ground(self, record: JobRecord) -> JobGround:
        """The ground of a job."""
        found = self.grounds.find(record.row.job_id)
        if found is None:
            found = self.grounds.make(record.file, record.ground)
            self.grounds.keep(record.row.job_id, found)
        return found

    def surface(self, record: JobRecord) -> JobState:
        """The present surface of a job."""
        return self.ground(record).surfaces(record.surveyed, record.steps)[0]

    def commit_loads(
        self, record: JobRecord, actor: Actor, action: str, loads: list[JobLoad]
    ) -> None:
        """Store a job with changed loads, and plan anew; under `lock`."""
        record.row.passed_m = []
        numbers = list[JsonValue](load.load_count for load in loads)
        throws = list[JsonValue](load.throw_id for load in loads)
        detail: dict[str, JsonValue] = {"load_counts": numbers, "throw_ids": throws}
        self.commit(record, actor, action, detail, loads=loads)

    def commit(
        self,
        record: JobRecord,
        actor: Actor,
        action: str,
        detail: dict[str, JsonValue],
        *,
        loads: Sequence[JobLoad] = (),
        survey: JobSurvey | None = None,
        is_planned: bool = False,
    ) -> None:
        """Store a changed job as its next version, and tell it; under `lock`.

        Args:
            record: changed.
            actor: who changed it.
            action: for the audit.
            detail: likewise.
            loads: new or changed ones among its loads.
            survey: the new one among its surveys.
            is_planned: what is planned holds; else it is planned anew.
        """
        row = record.row
        row.version_count += 1
        surface, after = self.ground(record).surfaces(record.surveyed, record.steps)
        changed = {load.load_count: load for load in loads}
        for load in record.loads:
            before, state = (load.filled_ratio, load.spill_ratio), after.get(load.load_count)
            if load.is_withdrawn:
                load.filled_ratio = load.spill_ratio = None
            elif state is not None:
                load.filled_ratio, load.spill_ratio = state.filled_ratio, state.spill_ratio
            if before != (load.filled_ratio, load.spill_ratio):
                changed[load.load_count] = load
        row.progress = progress_of(surface.progress).model_dump()
        if not is_planned:
            row.plan_state, row.plan_error = PlanningState.PLANNING.value, ""
            row.proposals = []
        with self.database.write() as database:
            database.merge(row)
            for load in changed.values():
                database.merge(load)
            if survey is not None:
                database.add(survey)
            self.audit.append(database, job_entry(actor, action, row, detail))
        if is_planned:
            self._tell(row)
        else:
            self.submit(record)

    def submit(self, record: JobRecord) -> None:
        """Plan a stored job, and tell it."""
        self._plan(record, self.ground(record), self.surface(record).field)
        self._tell(record.row)

    def _tell(self, row: JobRow) -> None:
        self._hub.publish(
            JobUpdatedEvent(
                job_id=row.job_id, machine_id=row.machine_id, version_count=row.version_count
            )
        )
        for listener in self.on_change:
            listener(row.machine_id)

    def plan_again(self, machine_id: str | None = None) -> None:
        """Plan open jobs anew: of a machine, or all."""
        with self.lock:
            with self.database.read() as database:
                records = [read_record(database, job_id) for job_id in open_job_ids(database)]
            for record in records:
                if machine_id in (None, record.row.machine_id):
                    record.row.plan_state, record.row.proposals = PlanningState.PLANNING.value, []
                    with self.database.write() as database:
                        database.merge(record.row)
                    self.submit(record)

    def take_plan(self, job_id: str, version_count: int, planned: Planned) -> None:
        """Store what a plan gave, if the job has not changed since."""
        with self.lock:
            record = self.read(job_id)
            row = record.row
            if row.ended_utc is not None or row.version_count != version_count:
                return
            proposals = [item.model_dump(mode="json") for item in planned.proposals]
            row.plan_state, row.plan_error = planned.state.value, planned.error
            row.landing_by = planned.landing_by or row.landing_by
            row.proposals = proposals
            row.offered = offers(planned.proposals, row.offered)
            with self.database.write() as database:
                database.merge(row)
        self._tell(row)


def job_entry(actor: Actor, action: str, row: JobRow, detail: dict[str, JsonValue]) -> Entry:
    """A change of a job for the audit."""
    content: dict[str, JsonValue] = {
        "job_id": row.job_id,
        "version_count": row.version_count,
        **detail,
    }
    return Entry(actor, action, "fact", machine_id=row.machine_id, detail=content)
