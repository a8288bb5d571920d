"""Stored plans; those whose preview runs are in memory too. A plan is frozen when it is armed.

The hash of a plan binds what the operator saw to what the machine runs: once its preview is complete, any
version that was shown may be frozen, no other.
"""

import threading
from collections import OrderedDict
from dataclasses import dataclass, field
from typing import Any

from sqlalchemy import update
from sqlalchemy.orm import Session as DatabaseSession
from sqlalchemy.orm import undefer

from machine.conventions import ACTIVE_COUNT
from machine.messages import MachineState, RejectReason, ThrowPlan
from server.clock import utc_now
from server.errors import NotFoundError, from_reason
from server.plans.plan_views import canonical, is_expired, plan_view, throw_plan, unpack_frames
from server.schemas.plans import PlanFrames, PlanState, PlanView
from server.store.database import Database
from server.store.models import Plan

MOVED_LIMIT_RAD_M = 0.05
"""A machine that moved farther than this since the preview needs a new one."""
MIN_ROLLOUT_COUNT = 50
"""Fewest scattered throws that tell the spread: with 5 % of bad throws allowed, 50 show 3 of them."""
_KEPT_COUNT = 256


@dataclass(slots=True)
class Running:
    """A plan in memory, while its preview runs and for a while after."""

    row: Plan
    first: threading.Event = field(default_factory=threading.Event)
    """Set when there are first numbers, or the end."""
    lock: threading.Lock = field(default_factory=threading.Lock)
    seen: dict[str, ThrowPlan] = field(default_factory=dict[str, ThrowPlan])
    """Hash -> every version that the operator was shown."""
    is_done: bool = False


class PlanStore:
    """All plans."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._lock = threading.Lock()
        self._running: OrderedDict[str, Running] = OrderedDict()

    def start(self) -> None:
        """Previews that a restart cut off will not come."""
        with self._database.write() as session:
            session.execute(
                update(Plan)
                .where(Plan.state == PlanState.PREVIEWING.value)
                .values(state=PlanState.FAILED.value)
            )

    def add(self, row: Plan) -> Running:
        """Store a new plan."""
        with self._database.write() as database:
            database.add(row)
        running = Running(row)
        with self._lock:
            self._running[row.plan_id] = running
            while len(self._running) > _KEPT_COUNT:
                self._running.popitem(last=False)
        return running

    def save(self, row: Plan) -> None:
        """Store what the preview says; what was armed meanwhile stays as it was armed."""
        with self._database.write() as database:
            database.execute(
                update(Plan)
                .where(Plan.plan_id == row.plan_id)
                .values(
                    state=row.state,
                    is_complete=row.is_complete,
                    refusals=row.refusals,
                    prediction=row.prediction,
                    frames=row.frames,
                )
            )

    def row(self, plan_id: str) -> Plan:
        """A plan's row.

        Raises:
            NotFoundError: there is none.
        """
        with self._lock:
            running = self._running.get(plan_id)
        if running is not None:
            return running.row
        with self._database.read() as database:
            row = database.get(Plan, plan_id)
        if row is None:
            raise NotFoundError("no_plan", f"There is no plan '{plan_id[:40]}'.")
        return row

    def view(self, plan_id: str) -> PlanView:
        """A plan for the console."""
        with self._lock:
            running = self._running.get(plan_id)
        if running is None:
            return plan_view(self.row(plan_id))
        with running.lock:
            return plan_view(running.row)

    def frames(self, plan_id: str) -> PlanFrames:
        """The predicted motion of a plan.

        Raises:
            NotFoundError: no such plan, or no motion (yet).
        """
        with self._database.read() as database:
            row = database.get(Plan, plan_id, options=[undefer(Plan.frames)])
        if row is None:
            raise NotFoundError("no_plan", f"There is no plan '{plan_id[:40]}'.")
        if row.frames is None:
            raise NotFoundError("no_frames", "This plan has no predicted motion (yet).")
        return unpack_frames(row.frames)

    def freeze(self, plan_id: str, shown_hash: str | None, state: MachineState) -> ThrowPlan:
        """The message to arm with; store it by `store_frozen` in the transaction of the intent.

        Raises:
            ApiError: refused, incomplete, expired or fired plan, another hash than any shown, or a moved
                machine.
        """
        row = self.row(plan_id)
        self._check_usable(row, state)
        with self._lock:
            running = self._running.get(plan_id)
        if running is None:
            message = throw_plan(row)
        else:
            with running.lock:
                message = throw_plan(row)
                if shown_hash is not None and row.plan_json is None:
                    message = running.seen.get(shown_hash)
        if message is None or (shown_hash is not None and message.plan_hash != shown_hash):
            raise from_reason(
                RejectReason.PLAN_MISMATCH,
                "The plan is not the one that was shown. Look at it again before arming."
                if shown_hash is not None
                else "The plan has no prediction yet. Wait for its numbers.",
            )
        return message

    def store_frozen(self, database: DatabaseSession, message: ThrowPlan) -> None:
        """Keep what is armed as it is armed."""
        text = canonical(message)
        values = {"plan_json": text, "plan_hash": message.plan_hash, "armed_utc": utc_now()}
        self._update(database, message.plan_id, values)

    def note_fired(self, database: DatabaseSession, plan_id: str) -> None:
        """A plan is thrown once."""
        self._update(database, plan_id, {"fired_utc": utc_now()})

    def _update(self, database: DatabaseSession, plan_id: str, values: dict[str, Any]) -> None:
        database.execute(update(Plan).where(Plan.plan_id == plan_id).values(**values))
        with self._lock:
            running = self._running.get(plan_id)
        if running is not None:
            for name, value in values.items():
                setattr(running.row, name, value)

    @staticmethod
    def _check_usable(row: Plan, state: MachineState) -> None:
        if row.refusals:
            first = row.refusals[0]
            raise from_reason(RejectReason(first["reason"]), first["detail"])
        if row.state == PlanState.FAILED.value:
            raise from_reason(
                RejectReason.PREVIEW_FAILED, "The preview of this plan failed. Preview again."
            )
        if not row.is_complete:
            raise from_reason(
                RejectReason.PREVIEW_INCOMPLETE,
                "The preview of this plan is not complete: the spread of its landings has not been "
                "checked yet. Wait for it, or preview again.",
            )
        if is_expired(row):
            raise from_reason(
                RejectReason.PLAN_EXPIRED,
                f"The plan is {(utc_now() - row.created_utc).total_seconds():.0f} s old, at most "
                f"{(row.expires_utc - row.created_utc).total_seconds():.0f} s allowed. Preview again.",
            )
        if row.fired_utc is not None:
            raise from_reason(
                RejectReason.PLAN_USED, "The plan was thrown already. Preview the next throw."
            )
        ellipse = (row.prediction or {}).get("ellipse")
        scattered = 0 if ellipse is None else ellipse["rollout_count"]
        if scattered < MIN_ROLLOUT_COUNT:
            raise from_reason(
                RejectReason.PREVIEW_INCOMPLETE,
                f"The spread of this plan's landings was checked with {scattered} throws, at least "
                f"{MIN_ROLLOUT_COUNT} are needed. Preview with more.",
            )
        start, now = row.start_rad_m, state.joint_position_rad_m
        moved = max(abs(float(start[i]) - now[i]) for i in range(ACTIVE_COUNT))
        if moved > MOVED_LIMIT_RAD_M:
            raise from_reason(
                RejectReason.MACHINE_MOVED,
                f"The machine moved by {moved:.3f} (rad or m) since the preview, at most "
                f"{MOVED_LIMIT_RAD_M} allowed. Preview again.",
            )
