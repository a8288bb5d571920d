"""Diagnoses of machines against their twins: queued, run one at a time, cancelled.

A thread gives one run after the other to a separate process. A run that a restart cut off is marked as
interrupted and not repeated.
"""

import logging
import threading
from collections import deque
from dataclasses import dataclass, field
from pathlib import Path

from sqlalchemy import select

from diagnosis.loading.kept_reference import LEAST_REFERENCE_COUNT, advice, words_of_days
from machine.errors import DownrangeError
from server.accounts.accounts import Session
from server.accounts.audit_chain import SERVER, Actor, AuditChain, Entry
from server.clock import new_id, utc_now
from server.errors import ApiError, ConflictError, TooManyRequestsError
from server.event_hub import EventHub
from server.gap.gap_store import GapStore, gap_row
from server.gap.gap_worker import GapAnswer, GapFailedError, GapJob, GapKilledError, GapProcess
from server.gap.throw_choice import ChosenThrows, choose_throws
from server.machines.machine_registry import MachineRegistry
from server.machines.twin_files import TwinFiles, content_sha256
from server.schemas.events import GapUpdatedEvent
from server.schemas.gap import (
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

logger = logging.getLogger(__name__)

QUEUE_COUNT = 8
"""Runs that may wait."""
DETAIL_LENGTH = 2000


@dataclass(slots=True)
class OpenRun:
    """A run that waits or is under way."""

    gap_run_id: str
    machine_id: str
    throws: ChosenThrows
    cancelled: threading.Event = field(default_factory=threading.Event)
    progress_ratio: float = 0.0
    step: str = "waiting"


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
        self._change = threading.Condition()
        self._queue: deque[str] = deque()
        self._open: dict[str, OpenRun] = {}
        self._is_closed = False
        self._thread = threading.Thread(target=self._work, name="gap runs", daemon=True)

    def start(self) -> None:
        """Mark what a restart cut off, and begin to work."""
        self.store.interrupt_all()
        self._thread.start()

    def close(self) -> None:
        """Kill what runs; it is marked as interrupted."""
        with self._change:
            self._is_closed = True
            self._change.notify_all()
        if self._thread.is_alive():
            self._thread.join(timeout=10.0)
            self.store.interrupt_all()

    # Asked ----------------------------------------------------------------------------------------------

    def create(self, machine_id: str, request: GapRunRequest, session: Session) -> GapRunRow:
        """Queue a diagnosis.

        Raises:
            ApiError: no such machine, throws that cannot be used, or too many waiting.
        """
        self._registry.get(machine_id)
        kept = self._twins.reference(machine_id)
        throws = choose_throws(self._database, machine_id, request, kept)
        profile = self._twins.profile(machine_id)
        with self._change:
            if len(self._queue) >= QUEUE_COUNT:
                raise TooManyRequestsError(
                    "gap_queue_full", f"{QUEUE_COUNT} diagnoses are waiting. Cancel one or wait."
                )
            row = self._add(machine_id, throws, profile, session)
            self._open[row.gap_run_id] = OpenRun(row.gap_run_id, machine_id, throws)
            self._queue.append(row.gap_run_id)
            self._change.notify_all()
        return self._publish(row)

    def _add(
        self, machine_id: str, throws: ChosenThrows, profile: TwinProfile, session: Session
    ) -> GapRun:
        row = GapRun(
            gap_run_id=new_id(),
            machine_id=machine_id,
            created_by=session.username,
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
            self._audit.append(database, self._entry(session.actor, "gap.run", row))
        return row

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

    def cancel(self, machine_id: str, gap_run_id: str, session: Session) -> GapRunRow:
        """Stop a run that waits or is under way.

        Raises:
            ApiError: there is none, or it has ended.
        """
        row = self.store.row(gap_run_id, machine_id)
        with self._change:
            run = self._open.get(gap_run_id)
            if run is None or run.cancelled.is_set():
                raise ConflictError("gap_run_ended", f"This diagnosis has ended: {row.state}.")
            run.cancelled.set()
            is_waiting = gap_run_id in self._queue
            if is_waiting:
                self._queue.remove(gap_run_id)
                del self._open[gap_run_id]
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
        with self._change:
            run = self._open.get(row.gap_run_id)
            if run is None or row.ended_utc is not None:
                return row
            return row.model_copy(update={"progress_ratio": run.progress_ratio, "step": run.step})

    def _publish(self, row: GapRun) -> GapRunRow:
        view = self._with_progress(gap_row(row))
        self._hub.publish(GapUpdatedEvent(run=view))
        return view

    # Work -----------------------------------------------------------------------------------------------

    def _work(self) -> None:
        while True:
            with self._change:
                self._change.wait_for(lambda: self._is_closed or self._queue)
                if self._is_closed:
                    return
                run = self._open[self._queue.popleft()]
            try:
                self._run(run)
            except Exception:
                logger.exception("diagnosis %s could not be kept", run.gap_run_id)
            finally:
                with self._change:
                    self._open.pop(run.gap_run_id, None)
            if not self._is_closed:
                self.publish(run.gap_run_id)

    def _run(self, run: OpenRun) -> None:
        profile = self._twins.profile(run.machine_id)
        row = self.store.change(
            run.gap_run_id,
            state=GapState.RUNNING.value,
            started_utc=utc_now(),
            profile_version_count=profile.version_count,
            profile_sha256=content_sha256(profile),
        )
        run.step = "starting"
        self._publish(row)

        def tell(share: float, text: str) -> None:
            run.progress_ratio, run.step = min(max(share, 0.0), 1.0), text[:120]
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
                ),
                tell,
                lambda: run.cancelled.is_set() or self._is_closed,
            )
        except GapKilledError:
            if run.cancelled.is_set():
                self._end(run, GapState.CANCELLED, "")
        except (GapFailedError, ApiError, DownrangeError, OSError) as error:
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
                detail={"gap_run_id": run.gap_run_id, "verdict": answer.verdict},
            )
        )

    def _end(self, run: OpenRun, state: GapState, detail: str, **values: object) -> None:
        self.store.change(
            run.gap_run_id, state=state.value, detail=detail, ended_utc=utc_now(), **values
        )
