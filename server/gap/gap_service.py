"""Diagnoses of machines against their twins, one at a time in a process of its own.

A run that a restart cut off is marked as interrupted and not repeated.
"""

from dataclasses import dataclass
from pathlib import Path

from sqlalchemy import select

from diagnosis.loading.kept_reference import LEAST_REFERENCE_COUNT, advice, words_of_days
from machine.errors import DownrangeError
from server.accounts.accounts import Session
from server.accounts.audit_chain import SERVER, Actor, AuditChain, Entry
from server.child_process import ChildFailedError, ChildKilledError
from server.clock import new_id, utc_now
from server.errors import ApiError, ConflictError
from server.event_hub import EventHub
from server.gap.commissioning_view import commissioning_report, commissioning_view
from server.gap.gap_store import GapStore, gap_row
from server.gap.gap_worker import GapAnswer, GapJob, GapProcess
from server.gap.throw_choice import ChosenThrows, choose_throws
from server.job_queue import Job, JobQueue
from server.machines.machine_registry import MachineRegistry
from server.machines.twin_files import TwinFiles, content_sha256
from server.schemas.events import GapUpdatedEvent
from server.schemas.gap import (
    CommissioningView,
    GapRunPage,
    GapRunRequest,
    GapRunRow,
    GapRunView,
    GapState,
    KeptReferenceView,
)
from server.store.database import Database
from server.store.models import GapRun, Throw
from server.throws.throw_logs import LogStore
from sim_twin.twin.profile import TwinProfile

DETAIL_LENGTH = 2000


@dataclass(slots=True, kw_only=True)
class OpenRun(Job):
    """A run that waits or is under way."""

    machine_id: str
    throws: ChosenThrows
    usual_s: tuple[float, float] | None
    """Times of earlier ones like it."""


class GapService:
    """All diagnoses."""

    def __init__(
        self,
        database: Database,
        audit: AuditChain,
        registry: MachineRegistry,
        logs: LogStore,
        twins: TwinFiles,
        hub: EventHub,
        process: GapProcess | None = None,
    ) -> None:
        self.store = GapStore(database)
        self._database = database
        self._audit = audit
        self._registry = registry
        self._logs = logs
        self._twins = twins
        self._hub = hub
        self._process = GapProcess() if process is None else process
        self.queue = JobQueue[OpenRun](
            "diagnoses", "gap_queue_full", self._run, lambda run: self.publish(run.job_id)
        )

    def start(self) -> None:
        """Mark what a restart cut off, and begin to work."""
        self.store.interrupt_all()
        self.queue.start()

    def close(self) -> None:
        """Kill what runs; it is marked as interrupted."""
        if self.queue.close():
            self.store.interrupt_all()

    # Asked ----------------------------------------------------------------------------------------------

    def create(self, machine_id: str, request: GapRunRequest, actor: Actor) -> GapRunRow:
        """Queue a diagnosis.

        Raises:
            ApiError: no such machine, throws that cannot be used, or too many waiting.
        """
        self._registry.get(machine_id)
        kept = self._twins.reference(machine_id)
        throws = choose_throws(self._database, machine_id, request, kept)
        profile = self._twins.profile(machine_id)
        run = self.queue.add(lambda: self._add(machine_id, throws, profile, actor))
        return self.publish(run.job_id)

    def _add(
        self, machine_id: str, throws: ChosenThrows, profile: TwinProfile, actor: Actor
    ) -> OpenRun:
        row = GapRun(
            gap_run_id=new_id(),
            machine_id=machine_id,
            created_by=actor.name,
            created_utc=utc_now(),
            started_utc=None,
            ended_utc=None,
            state=GapState.QUEUED.value,
            detail="",
            throw_ids=list(throws.throw_ids),
            reference_throw_ids=list(throws.reference_throw_ids),
            profile_version_count=profile.version_count,
            profile_sha256=content_sha256(profile),
            verdict=None,
            sentence="",
            effect_count=0,
            result=None,
            report=None,
            applied_version_count=None,
        )
        with self._database.write() as database:
            database.add(row)
            database.flush()
            self._audit.append(database, self._entry(actor, "gap.run", row))
        usual_s = self.store.usual_s(has_reference=bool(throws.reference_throw_ids))
        return OpenRun(job_id=row.gap_run_id, machine_id=machine_id, throws=throws, usual_s=usual_s)

    @staticmethod
    def _entry(actor: Actor, action: str, row: GapRun) -> Entry:
        return Entry(
            actor,
            action,
            "fact",
            machine_id=row.machine_id,
            detail={
                "gap_run_id": row.gap_run_id,
                "throw_count": len(row.throw_ids),
                "reference_throw_count": len(row.reference_throw_ids),
            },
        )

    def kept_reference(self, machine_id: str) -> KeptReferenceView:
        """Reference throws that are kept for a machine.

        Raises:
            ApiError: no such machine.
        """
        self._registry.get(machine_id)
        days = self._twins.reference(machine_id).days()
        count = sum(days.values())
        words = ". ".join(filter(None, [words_of_days(days), advice(days)]))
        return KeptReferenceView(
            day_throw_count=days,
            throw_count=count,
            is_used=count >= LEAST_REFERENCE_COUNT,
            words=f"{words[0].upper()}{words[1:]}.",
        )

    def commissioning(self, machine_id: str) -> CommissioningView:
        """The last commissioning of a machine.

        Raises:
            ApiError: no such machine.
        """
        self._registry.get(machine_id)
        return commissioning_view(self._twins, machine_id)

    def commissioning_report(self, machine_id: str) -> bytes:
        """Its report.

        Raises:
            ApiError: no such machine, or no report.
        """
        self._registry.get(machine_id)
        return commissioning_report(self._twins, machine_id)

    def cancel(self, machine_id: str, gap_run_id: str, session: Session) -> GapRunRow:
        """Stop a run that waits or is under way.

        Raises:
            ApiError: there is none, or it has ended.
        """
        row = self.store.row(gap_run_id, machine_id)
        run = self.queue.find(gap_run_id)
        is_waiting = None if run is None else self.queue.cancel(run)
        if is_waiting is None:
            raise ConflictError("gap_run_ended", f"This diagnosis has ended: {row.state}.")
        self._audit.record(self._entry(session.actor, "gap.cancel", row))
        if is_waiting:
            row = self.store.change(gap_run_id, state=GapState.CANCELLED.value, ended_utc=utc_now())
        return self._publish(row)

    def page(self, machine_id: str, cursor: str | None, limit: int) -> GapRunPage:
        """Runs of a machine, newest first, with the progress of the open ones."""
        self._registry.get(machine_id)
        page = self.store.page(machine_id, cursor, limit)
        return page.model_copy(update={"rows": tuple(self._with_progress(r) for r in page.rows)})

    def view(self, machine_id: str, gap_run_id: str) -> GapRunView:
        """One run."""
        view = self.store.view(gap_run_id, machine_id)
        return view.model_copy(update={"row": self._with_progress(view.row)})

    def publish(self, gap_run_id: str) -> GapRunRow:
        """Send a run's present row to the browsers."""
        return self._publish(self.store.row(gap_run_id))

    def _with_progress(self, row: GapRunRow) -> GapRunRow:
        run = self.queue.find(row.gap_run_id)
        if run is None or row.ended_utc is not None:
            return row
        now = {"progress_ratio": run.progress_ratio, "step": run.step, "usual_s": run.usual_s}
        return row.model_copy(update=now)

    def _publish(self, row: GapRun) -> GapRunRow:
        view = self._with_progress(gap_row(row))
        self._hub.publish(GapUpdatedEvent(run=view))
        return view

    # Work -----------------------------------------------------------------------------------------------

    def _run(self, run: OpenRun) -> None:
        profile = self._twins.profile(run.machine_id)
        row = self.store.change(
            run.job_id,
            state=GapState.RUNNING.value,
            started_utc=utc_now(),
            profile_version_count=profile.version_count,
            profile_sha256=content_sha256(profile),
        )
        run.step = "starting"
        self._publish(row)

        def tell(share: float, text: str) -> None:
            run.report(share, text)
            self._publish(row)

        try:
            paths = self._paths(run.throws.throw_ids)
            kept = run.throws.kept_logs
            healthy = tuple(
                kept.get(throw_id) or self._logs.path(throw_id)
                for throw_id in run.throws.reference_throw_ids
            )
            title = f"{run.machine_id}, {len(paths)} throws, twin profile {profile.version_count}"
            answer = self._process.run(
                GapJob(
                    title,
                    paths,
                    profile,
                    healthy,
                    self._names(run.throws),
                    dict(run.throws.reference_days),
                    run.throws.material_m,
                    self._twins.folder,
                ),
                tell,
                lambda: self.queue.must_end(run),
            )
        except ChildKilledError:
            if run.cancelled.is_set():
                self._end(run, GapState.CANCELLED, "")
        except (ChildFailedError, ApiError, DownrangeError, OSError) as error:
            self._end(run, GapState.FAILED, str(error)[:DETAIL_LENGTH])
        else:
            self._keep(run, answer)

    def _paths(self, throw_ids: tuple[str, ...]) -> tuple[Path, ...]:
        return tuple(self._logs.path(throw_id) for throw_id in throw_ids)

    def _names(self, throws: ChosenThrows) -> dict[str, str]:
        """When each log's throw was, by the log's file name."""
        ids = (*throws.throw_ids, *throws.reference_throw_ids)
        with self._database.read() as session:
            rows = session.execute(
                select(Throw.throw_id, Throw.created_utc).where(Throw.throw_id.in_(ids))
            ).all()
        return {
            self._logs.path(throw_id).name: f"throw of {created_utc:%Y-%m-%d %H:%M:%S} UTC"
            for throw_id, created_utc in rows
        }

    def _keep(self, run: OpenRun, answer: GapAnswer) -> None:
        self._end(
            run,
            GapState.DONE,
            "",
            verdict=answer.verdict,
            sentence=answer.sentence,
            effect_count=answer.effect_count,
            result=dict(answer.result),
            report=answer.report,
        )
        self._audit.record(
            Entry(
                SERVER,
                "gap.done",
                "fact",
                machine_id=run.machine_id,
                detail={"gap_run_id": run.job_id, "verdict": answer.verdict},
            )
        )

    def _end(self, run: OpenRun, state: GapState, detail: str, **values: object) -> None:
        self.store.change(
            run.job_id, state=state.value, detail=detail, ended_utc=utc_now(), **values
        )
