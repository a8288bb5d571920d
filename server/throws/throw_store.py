"""Throws in the database: their rows, how their phase moves forward, and the ones whose answer was lost.

A throw whose answer was lost blocks its machine until events, or a machine that has nothing left to tell,
say what became of it.
"""

import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from sqlalchemy import func, select, update
from sqlalchemy.orm import Session as DatabaseSession

from machine.conventions import Mode
from machine.messages import MachineState, RejectReason, ThrowPlan, ThrowState
from server.accounts.accounts import Session
from server.accounts.audit_chain import SERVER, AuditChain, Entry
from server.clock import utc_now
from server.errors import ConflictError, NotFoundError
from server.event_hub import EventHub
from server.machines.machine_registry import KnownMachine, MachineRegistry
from server.plans.landing_errors import errors_of
from server.plans.policy_store import PolicyStore
from server.schemas.console import TargetView
from server.schemas.events import ThrowUpdatedEvent
from server.schemas.history import Outcome, ThrowPhase, ThrowRow
from server.store.database import Database
from server.store.models import Throw
from server.throws.impacts import target_of

PHASE_ORDER = tuple(ThrowPhase)
"""Phases only move forward in this order."""
RECONCILE_AFTER_S = 2.0
"""Fresh states must have said for this long that nothing of the throw exists."""
_IDLE_STATES = frozenset({ThrowState.DISARMED, ThrowState.STOPPED, ThrowState.FAULT})


@dataclass(slots=True)
class UnknownThrow:
    """A fired throw whose answer was lost."""

    throw_id: str
    since_s: float
    idle_since_s: float | None = None


class ThrowStore:
    """All throws."""

    def __init__(
        self,
        database: Database,
        audit: AuditChain,
        registry: MachineRegistry,
        policies: PolicyStore,
        hub: EventHub,
    ) -> None:
        self._database = database
        self._audit = audit
        self._policies = policies
        self._hub = hub
        self._lock = threading.Lock()
        self._unknown: dict[str, UnknownThrow] = {}
        self.on_change: list[Callable[[str], None]] = []
        """Called with the machine's id after one of its throws has changed."""
        registry.on_state.append(self._reconcile)

    def start(self) -> None:
        """After a restart, throws that were being fired have an unknown outcome too."""
        with self._database.write() as database:
            database.execute(
                update(Throw)
                .where(Throw.phase == ThrowPhase.REQUESTED.value)
                .values(phase=ThrowPhase.UNKNOWN.value)
            )
            rows = database.execute(
                select(Throw.machine_id, Throw.throw_id).where(
                    Throw.phase == ThrowPhase.UNKNOWN.value
                )
            ).all()
        now_s = time.monotonic()
        for machine_id, throw_id in rows:
            self._unknown[machine_id] = UnknownThrow(throw_id, now_s)

    # Unknown outcomes ---------------------------------------------------------------------------------

    def unknown_of(self, machine_id: str) -> str | None:
        """The throw that blocks a machine."""
        with self._lock:
            found = self._unknown.get(machine_id)
        return None if found is None else found.throw_id

    def require_known(self, machine_id: str) -> None:
        """Refuse while it is not known what became of the last throw.

        Raises:
            ConflictError: with the throw's id.
        """
        throw_id = self.unknown_of(machine_id)
        if throw_id is not None:
            raise ConflictError(
                RejectReason.UNKNOWN_OUTCOME.value,
                f"It is not known what became of throw {throw_id} of {machine_id}; it stays blocked "
                "until the machine reports. Check the machine and its link.",
                {"throw_id": throw_id},
            )

    def mark_unknown(self, machine_id: str, throw_id: str) -> None:
        """The answer to a fire was lost."""
        with self._lock:
            self._unknown[machine_id] = UnknownThrow(throw_id, time.monotonic())
        self.move(throw_id, ThrowPhase.UNKNOWN)
        with self._database.read() as database:
            row = database.get(Throw, throw_id)
        if row is not None and row.phase != ThrowPhase.UNKNOWN.value:
            self.resolve(throw_id)  # its events overtook the lost answer
            return
        self._hub.alert(
            "unknown_outcome",
            f"{machine_id} did not confirm throw {throw_id}; it is blocked until it reports.",
            severity="error",
            machine_id=machine_id,
        )

    def resolve(self, throw_id: str) -> None:
        """Something certain is known about a throw."""
        with self._lock:
            for machine_id, unknown in list(self._unknown.items()):
                if unknown.throw_id == throw_id:
                    del self._unknown[machine_id]

    def _reconcile(self, known: KnownMachine, state: MachineState) -> None:
        with self._lock:
            unknown = self._unknown.get(known.machine_id)
            if unknown is None:
                return
            # Not armed: the nonce is dead, a late fire will be refused. Nothing in the outbox: had the
            # machine accepted, its event would have reached us first.
            is_idle = (
                state.state in _IDLE_STATES
                and state.throw_id != unknown.throw_id
                and state.outbox_count == 0
            )
            now_s = time.monotonic()
            if not is_idle:
                unknown.idle_since_s = None
                return
            if unknown.idle_since_s is None:
                unknown.idle_since_s = now_s
            if now_s - unknown.idle_since_s < RECONCILE_AFTER_S:
                return
            del self._unknown[known.machine_id]
        self.end(unknown.throw_id, Outcome.NOT_EXECUTED, "the machine never accepted it")
        self._audit.record(
            Entry(
                SERVER,
                "throw.reconciled",
                "fact",
                machine_id=known.machine_id,
                throw_id=unknown.throw_id,
                detail={"outcome": Outcome.NOT_EXECUTED},
            )
        )

    # Rows ---------------------------------------------------------------------------------------------

    def new_row(self, throw_id: str, plan: ThrowPlan, session: Session, epoch_count: int) -> Throw:
        """The row of a throw that is about to be fired."""
        ellipse = plan.predicted_ellipse
        downrange_m, crossrange_m = errors_of(
            plan.target, plan.predicted_impact_m[0], plan.predicted_impact_m[1]
        )
        return Throw(
            throw_id=throw_id,
            machine_id=plan.machine_id,
            plan_id=plan.plan_id,
            session_id=session.session_id,
            created_utc=utc_now(),
            operator=session.username,
            epoch_count=epoch_count,
            mode=plan.mode.value,
            target_x_m=plan.target.x_m,
            target_y_m=plan.target.y_m,
            target_z_m=plan.target.z_m,
            range_m=math.hypot(plan.target.x_m, plan.target.y_m),
            pace_ratio=plan.pace_ratio,
            policy_id=self._policies.name_of(plan.policy_sha256),
            policy_sha256=plan.policy_sha256,
            phase=ThrowPhase.REQUESTED.value,
            outcome=None,
            detail="",
            predicted_downrange_error_m=downrange_m,
            predicted_crossrange_error_m=crossrange_m,
            predicted_sd_downrange_m=None if ellipse is None else ellipse.sd_downrange_m,
            predicted_sd_crossrange_m=None if ellipse is None else ellipse.sd_crossrange_m,
            has_log=False,
        )

    def get(self, database: DatabaseSession, throw_id: str) -> Throw:
        """A throw's row.

        Raises:
            NotFoundError: there is none.
        """
        row = database.get(Throw, throw_id)
        if row is None:
            raise NotFoundError("no_throw", f"There is no throw '{throw_id[:40]}'.")
        return row

    @staticmethod
    def note_accepted(database: DatabaseSession, throw_id: str) -> None:
        """The machine accepted; its own events may already have said more."""
        row = database.get(Throw, throw_id, with_for_update=True)
        if row is not None:
            move_row(row, ThrowPhase.ACCEPTED)

    def move(self, throw_id: str, phase: ThrowPhase) -> None:
        """Move a throw forward and tell the browsers."""
        with self._database.write() as database:
            row = database.get(Throw, throw_id, with_for_update=True)
            if row is None or not move_row(row, phase):
                return
        self.publish(throw_id)

    def end(self, throw_id: str, outcome: Outcome, detail: str) -> None:
        """End a throw that the machine will not report on."""
        with self._database.write() as database:
            row = database.get(Throw, throw_id, with_for_update=True)
            if row is None or row.phase == ThrowPhase.ENDED.value:
                return
            row.phase, row.outcome, row.detail = ThrowPhase.ENDED.value, outcome.value, detail
        self.publish(throw_id)

    def publish(self, throw_id: str) -> None:
        """Send a throw's present row to the browsers."""
        with self._database.read() as database:
            row = database.get(Throw, throw_id)
        if row is not None:
            self._hub.publish(ThrowUpdatedEvent(throw=throw_row(row)))
            for listener in self.on_change:
                listener(row.machine_id)

    def count(self) -> int:
        """Throws in all."""
        with self._database.read() as database:
            return database.scalar(select(func.count()).select_from(Throw)) or 0


def move_row(row: Throw, phase: ThrowPhase) -> bool:
    """Set a later phase; events may come in any order and more than once, phases go forward only."""
    if PHASE_ORDER.index(ThrowPhase(row.phase)) >= PHASE_ORDER.index(phase):
        return False
    row.phase = phase.value
    return True


def throw_row(row: Throw) -> ThrowRow:
    """A throw for the console."""
    return ThrowRow(
        throw_id=row.throw_id,
        machine_id=row.machine_id,
        plan_id=row.plan_id,
        created_utc=row.created_utc,
        operator=row.operator,
        mode=Mode(row.mode),
        target=TargetView.of(target_of(row)),
        pace_ratio=row.pace_ratio,
        policy_id=row.policy_id,
        policy_sha256=row.policy_sha256,
        phase=ThrowPhase(row.phase),
        outcome=None if row.outcome is None else Outcome(row.outcome),
        detail=row.detail,
        predicted_downrange_error_m=row.predicted_downrange_error_m,
        predicted_crossrange_error_m=row.predicted_crossrange_error_m,
        predicted_sd_downrange_m=row.predicted_sd_downrange_m,
        predicted_sd_crossrange_m=row.predicted_sd_crossrange_m,
        measured_downrange_error_m=row.measured_downrange_error_m,
        measured_crossrange_error_m=row.measured_crossrange_error_m,
        impact_source=row.impact_source,
        release_speed_m_per_s=row.release_speed_m_per_s,
        throw_duration_s=row.throw_duration_s,
        has_log=row.has_log,
    )
