"""Bulk jobs: begun, changed and ended by people; throws at proposals are recorded as their loads.

The server only proposes: every load is aimed and held by a person in Operate. A change names the version of
the job that it was made for.
"""

import logging
import threading
from typing import Final

from pydantic import JsonValue
from sqlalchemy import select

from bulk.job_file import material_of
from machine.errors import UsageError
from machine.messages import Target
from machine.site.thrown_material import ThrownMaterial
from machine.spec import MachineSpec
from server.accounts.accounts import Session
from server.accounts.audit_chain import SERVER, AuditChain
from server.clock import new_id, utc_now
from server.errors import ApiError, ConflictError, InfeasibleError, NotFoundError
from server.event_hub import EventHub
from server.jobs.job_book import JobBook, job_entry
from server.jobs.job_ground import Ground, SurveyReader
from server.jobs.job_planning import PlanLoads, plan_in_child
from server.jobs.job_plans import JobPlans
from server.jobs.job_reports import job_surface, thrown_job_html
from server.jobs.job_store import (
    FIRST_VERSION,
    JobRecord,
    job_page,
    job_view,
    open_job_id,
    progress_of,
    proposals_of,
    read_record,
    survey_row,
)
from server.jobs.job_views import (
    JobChange,
    JobEndRequest,
    JobLoadRequest,
    JobMoveRequest,
    JobPage,
    JobProposal,
    JobRequest,
    JobSkipRequest,
    JobStatus,
    JobSurface,
    JobSurveyRequest,
    JobView,
    PlanningState,
)
from server.jobs.laid_material import laid_material
from server.jobs.throw_loads import (
    ThrowLanding,
    aimed_at,
    counted_ids,
    follow,
    footprints_of,
    landed_throws,
    landing_of,
    new_load,
    offers,
    thrown_material,
)
from server.machines.machine_registry import MachineRegistry
from server.plans.policy_store import PolicyStore
from server.plans.site_store import SiteStore
from server.plans.zone_store import ZoneStore
from server.schemas.history import Outcome
from server.store.database import Database
from server.store.job_tables import JobLoad, JobRow
from server.store.models import Throw
from server.viewer.shapes import LaidMaterial

logger = logging.getLogger(__name__)

MAX_LOAD_COUNT: Final = 500
CLOSE_S: Final = 5.0


class Jobs:
    """All jobs; thread-safe."""

    def __init__(
        self,
        database: Database,
        audit: AuditChain,
        registry: MachineRegistry,
        policies: PolicyStore,
        sites: SiteStore,
        zones: ZoneStore,
        hub: EventHub,
        spec: MachineSpec,
        plan: PlanLoads = plan_in_child,
    ) -> None:
        self._database = database
        self._audit = audit
        self._registry = registry
        self._sites = sites
        self._surveys = SurveyReader()
        self.plans = JobPlans(database, registry, policies, sites, zones, spec, plan)
        self._book = JobBook(database, audit, hub, spec, self.plans.submit)
        self.plans.on_planned.append(self._book.take_plan)
        self._news = threading.Condition()
        self._with_throws: set[str] = set()
        self._with_changes: set[str] = set()
        self._is_closing = False
        self._thread = threading.Thread(target=self._work, name="jobs", daemon=True)
        self.on_change = self._book.on_change
        """Called with the machine's id after a job of it has changed."""

    def start(self) -> None:
        """Begin to plan, with every open job."""
        self.plans.start()
        self._thread.start()

    def close(self) -> None:
        """Stop; the next start goes on."""
        with self._news:
            self._is_closing = True
            self._news.notify_all()
        if self._thread.is_alive():
            self._thread.join(CLOSE_S)
            self.plans.close()
        self._surveys.close()

    def note_throw(self, machine_id: str) -> None:
        """A throw of a machine has news."""
        with self._news:
            self._with_throws.add(machine_id)
            self._news.notify_all()

    def note_surroundings(self, machine_id: str) -> None:
        """Site or zones of a machine have changed."""
        with self._news:
            self._with_changes.add(machine_id)
            self._news.notify_all()

    # Reading --------------------------------------------------------------------------------------

    def page(
        self, machine_id: str | None, status: JobStatus | None, cursor: str | None, limit: int
    ) -> JobPage:
        """Jobs, newest first."""
        return job_page(self._database, machine_id, status, cursor, limit)

    def view(self, job_id: str) -> JobView:
        """One job.

        Raises:
            NotFoundError: there is none.
        """
        record = self._book.read(job_id)
        return job_view(record, material_of(record.file))

    def surface(self, job_id: str) -> JobSurface:
        """The ground of a job.

        Raises:
            NotFoundError: there is none.
        """
        record = self._book.read(job_id)
        return job_surface(record, self._book.ground(record), self._book.surface(record).field)

    def report(self, job_id: str) -> str:
        """The HTML page of a job so far.

        Raises:
            NotFoundError: there is none.
        """
        record = self._book.read(job_id)
        try:
            policies = self.plans.policies(record.row.machine_id, record.file)
            policy_id = " and ".join(one.card.policy_id for one in policies)
        except ApiError:
            policy_id = "none"
        return thrown_job_html(
            record, self._book.ground(record), self._book.surface(record), policy_id
        )

    def surface_at(self, machine_id: str, x_m: float, y_m: float) -> float | None:
        """Height of the surface of a machine's open job at a point; None without one, and on walls."""
        record = self._book.open_record(machine_id)
        return None if record is None else self._book.surface(record).field.surface_m(x_m, y_m)

    def thrown_material(self, machine_id: str, target: Target) -> ThrownMaterial | None:
        """What a machine's open job wants thrown at a target; None where it proposes no load there."""
        record = self._book.open_record(machine_id)
        return None if record is None else thrown_material(record, target)

    def material(self, machine_id: str) -> LaidMaterial | None:
        """What lies on the ground of a machine's open job, and its next loads; None without one."""
        record = self._book.open_record(machine_id)
        if record is None:
            return None
        ground, field = self._book.ground(record), self._book.surface(record).field
        footprints = ground.footprints(field, proposals_of(record))
        return laid_material(field, footprints, ground.job.file.objects)

    # People ---------------------------------------------------------------------------------------

    def create(self, body: JobRequest, session: Session) -> JobView:
        """Begin a job.

        Raises:
            ApiError: no such machine, one of it is open, or it cannot be done, with the reason.
        """
        machine_id = body.machine_id
        self._registry.get(machine_id)
        objects = self._sites.objects(machine_id)
        file = body.file.model_copy(update={"objects": objects})
        surveyed = self._read_survey(body.survey, file.cell_m)
        try:
            ground = self._book.grounds.make(file, surveyed)
            self.plans.require_reachable(machine_id, file, ground)
        except UsageError as error:
            raise _refused(error) from error
        now = utc_now()
        row = JobRow(
            job_id=new_id(),
            machine_id=machine_id,
            name=file.name,
            file=file.model_dump(mode="json"),
            version_count=FIRST_VERSION,
            created_by=session.username,
            created_utc=now,
            ended_by=None,
            ended_utc=None,
            end_reason="",
            progress=progress_of(ground.surfaces(None, ())[0].progress).model_dump(),
            plan_state=PlanningState.PLANNING.value,
            plan_error="",
            landing_by=None,
            proposals=[],
            offered=[],
            passed_m=[],
        )
        with self._book.lock:
            with self._database.write() as database:
                other = open_job_id(database, machine_id)
                if other is not None:
                    name = read_record(database, other).row.name
                    raise ConflictError(
                        "job_open", f"Job {name} of {machine_id} is open; end it first."
                    )
                database.add(row)
                database.flush()
                if surveyed is not None:
                    database.add(
                        survey_row(row.job_id, FIRST_VERSION, surveyed, session.username, now)
                    )
                detail: dict[str, JsonValue] = {"name": row.name, "goal": file.work.kind}
                self._audit.append(database, job_entry(session.actor, "job.create", row, detail))
            self._book.grounds.keep(row.job_id, ground)
            self._book.submit(self._book.read(row.job_id))
        return self.view(row.job_id)

    def _read_survey(self, content: bytes | None, cell_m: float) -> Ground | None:
        """Grid and heights of a survey that came with a new job; None without one.

        Raises:
            InfeasibleError: it cannot be used, with the reason; its detail names the survey.
        """
        if content is None:
            return None
        try:
            return self._surveys.read(content, cell_m)
        except UsageError as error:
            raise _refused(error, "survey") from error

    def skip(self, job_id: str, body: JobSkipRequest, session: Session) -> JobView:
        """Pass a proposal over until the next load.

        Raises:
            ApiError: no such job or proposal, or the job has changed.
        """
        with self._book.lock:
            record = self._book.for_change(job_id, body)
            passed = _proposal(record, body.proposal_count)
            record.row.passed_m = [*record.row.passed_m, [passed.x_m, passed.y_m]]
            detail: dict[str, JsonValue] = {"x_m": passed.x_m, "y_m": passed.y_m}
            self._book.commit(record, session.actor, "job.skip", detail)
        return self.view(job_id)

    def move(self, job_id: str, body: JobMoveRequest, session: Session) -> JobView:
        """Move a proposal.

        Raises:
            ApiError: no such job or proposal, the job has changed, or no load can be thrown there.
        """
        with self._book.lock:
            record = self._book.for_change(job_id, body)
            before = _proposal(record, body.proposal_count)
            ground = self._book.ground(record)
            wanted = before.model_copy(update={"x_m": body.x_m, "y_m": body.y_m})
            try:
                present = self._book.surface(record).field
                moved = self.plans.moved(record, ground, present, wanted)
            except UsageError as error:
                raise _refused(error) from error
            row, dumped = record.row, moved.model_dump(mode="json")
            row.proposals = [
                dumped if item["proposal_count"] == body.proposal_count else item
                for item in row.proposals
            ]
            row.offered = offers([moved], row.offered)
            detail: dict[str, JsonValue] = {"x_m": body.x_m, "y_m": body.y_m}
            self._book.commit(record, session.actor, "job.move", detail, is_planned=True)
        return self.view(job_id)

    def add_load(self, job_id: str, body: JobLoadRequest, session: Session) -> JobView:
        """Record a throw, or a load by hand.

        Raises:
            ApiError: no such job or throw, the job has changed, the throw has not landed or counts already,
                or the place lies beside the ground.
        """
        with self._book.lock:
            record = self._book.for_change(job_id, body)
            if len(record.loads) >= MAX_LOAD_COUNT:
                raise ConflictError("job_full", f"A job has at most {MAX_LOAD_COUNT} loads.")
            volume_m3, throw = body.volume_m3, None
            if body.throw_id is not None:
                throw, landing = self._landed_throw(record, body.throw_id)
                aimed = aimed_at(throw, record.row.offered)
                volume_m3 = volume_m3 or landing.volume_m3
                if volume_m3 is None and aimed is not None:
                    volume_m3 = aimed.volume_m3
            else:
                landing = ThrowLanding(body.x_m or 0.0, body.y_m or 0.0, "entered")
                grid = self._book.ground(record).job.field.grid
                if not grid.holds(landing.x_m, landing.y_m):
                    raise InfeasibleError(
                        "job_refused",
                        f"x {landing.x_m:.2f} m, y {landing.y_m:.2f} m lies beside the ground of the job: "
                        f"x {grid.x_m[0]:.1f} to {grid.x_m[-1]:.1f} m, y {grid.y_m[0]:.1f} to "
                        f"{grid.y_m[-1]:.1f} m.",
                    )
            volume_m3 = volume_m3 or record.file.grab_m3
            load = new_load(record, throw, landing, volume_m3, session.actor)
            self._book.commit_loads(record, session.actor, "job.load", [load])
        return self.view(job_id)

    def undo(self, job_id: str, body: JobChange, session: Session) -> JobView:
        """Withdraw the last load; it stays in the history.

        Raises:
            ApiError: no such job, the job has changed, or there is no load since the last survey.
        """
        with self._book.lock:
            record = self._book.for_change(job_id, body)
            last, survey = record.counted[-1:], record.last_survey
            if not last:
                raise ConflictError("nothing_to_undo", "The job has no load to withdraw.")
            if survey is not None and survey.version_count > last[0].version_count:
                raise ConflictError(
                    "before_survey",
                    f"Load {last[0].load_count} lies before the last survey, which shows it; survey again.",
                )
            last[0].is_withdrawn = True
            self._book.commit_loads(record, session.actor, "job.undo", last)
        return self.view(job_id)

    def survey(self, job_id: str, body: JobSurveyRequest, session: Session) -> JobView:
        """Put a surveyed surface in place of the computed one.

        Raises:
            ApiError: no such job, the job has changed, or the survey cannot be used, with the reason.
        """
        try:
            cell_m = self._book.read(job_id).file.cell_m
            surveyed = self._surveys.read(body.survey or b"", cell_m)
            with self._book.lock:
                record = self._book.for_change(job_id, body)
                ground = self._book.ground(record)
                present = self._book.surface(record).field
                heights = ground.resampled(present, surveyed)
                row = survey_row(
                    job_id,
                    record.row.version_count + 1,
                    (present.grid, heights),
                    session.username,
                    utc_now(),
                )
                record.surveys.append(row)
                record.row.passed_m = []
                self._book.commit(record, session.actor, "job.survey", {}, survey=row)
        except UsageError as error:
            raise _refused(error) from error
        return self.view(job_id)

    def end(self, job_id: str, body: JobEndRequest, session: Session) -> JobView:
        """End a job.

        Raises:
            ApiError: no such job, or the job has changed.
        """
        with self._book.lock:
            record = self._book.for_change(job_id, body)
            self.plans.cancel(job_id)
            row = record.row
            row.ended_by, row.ended_utc = session.username, utc_now()
            row.end_reason = body.reason.replace("\x00", "")
            row.proposals, row.plan_state = [], PlanningState.NOTHING_LEFT.value
            detail: dict[str, JsonValue] = {"reason": row.end_reason}
            self._book.commit(record, session.actor, "job.end", detail, is_planned=True)
        return self.view(job_id)

    # Throws and plans -----------------------------------------------------------------------------

    def take_throws(self, machine_id: str) -> None:
        """Record landed throws at proposals of the open job, and follow corrected impacts."""
        with self._book.lock:
            with self._database.read() as database:
                job_id = open_job_id(database, machine_id)
                if job_id is None:
                    return
                record = read_record(database, job_id)
                throws = {one.throw_id: one for one in landed_throws(database, record.row)}
                counted = counted_ids(database, throws.values())
                lies = footprints_of(database, throws)
            changed: list[JobLoad] = []
            for load in record.counted:
                throw = throws.get(load.throw_id or "")
                if throw is not None and follow(load, landing_of(throw, lies)):
                    changed.append(load)
            for throw_id, throw in throws.items():
                aimed = aimed_at(throw, record.row.offered)
                is_room = len(record.loads) < MAX_LOAD_COUNT
                if throw_id not in counted and aimed is not None and is_room:
                    landing = landing_of(throw, lies)
                    volume_m3 = landing.volume_m3 or aimed.volume_m3
                    changed.append(new_load(record, throw, landing, volume_m3, SERVER))
            if changed:
                self._book.commit_loads(record, SERVER, "job.load", changed)

    def _work(self) -> None:
        try:
            self._book.plan_again()
        except Exception:
            logger.exception("jobs could not be planned")
        while True:
            with self._news:
                self._news.wait_for(
                    lambda: self._is_closing or self._with_throws or self._with_changes
                )
                if self._is_closing:
                    return
                with_throws, self._with_throws = self._with_throws, set()
                with_changes, self._with_changes = self._with_changes, set()
            try:
                for machine_id in sorted(with_throws):
                    self.take_throws(machine_id)
                for machine_id in sorted(with_changes):
                    self._book.plan_again(machine_id)
            except Exception:
                logger.exception("jobs could not be brought up to date")

    # Parts -----------------------------------------------------------------------------------------

    def _landed_throw(self, record: JobRecord, throw_id: str) -> tuple[Throw, ThrowLanding]:
        with self._database.read() as database:
            throw = database.get(Throw, throw_id)
            query = select(JobLoad.job_id).where(
                JobLoad.throw_id == throw_id, JobLoad.is_withdrawn.is_(False)
            )
            counted = database.scalars(query).first()
            lies = footprints_of(database, [throw_id])
        if throw is None or throw.machine_id != record.row.machine_id:
            raise NotFoundError(
                "no_throw", f"{record.row.machine_id} has no throw '{throw_id[:40]}'."
            )
        if throw.outcome != Outcome.LANDED.value:
            raise ConflictError("throw_not_landed", "The throw has not landed (yet).")
        if counted is not None:
            raise ConflictError("throw_counted", "The throw is a load already.")
        return throw, landing_of(throw, lies)


def _proposal(record: JobRecord, number: int) -> JobProposal:
    for proposal in proposals_of(record):
        if proposal.proposal_count == number:
            return proposal
    raise ConflictError("no_proposal", f"There is no proposal {number} now.")


def _refused(error: UsageError, field: str | None = None) -> InfeasibleError:
    text = str(error)
    sentence = f"{text[:1].upper()}{text[1:]}."
    detail: JsonValue = {"problems": [{"field": field, "problem": sentence}]} if field else None
    return InfeasibleError("job_refused", sentence, detail)
