"""The moves that several parts of the throw protocol make: disarm, abort, latch, end a throw; pure."""

from typing import Any, Final

from machine.messages import EventKind, ThrowEnd, ThrowState
from runtime.throw.protocol import RUNNING, Latch, ThrowEvent, ThrowMachine

UNLATCHED: Final[dict[str, Any]] = {
    "latched_reason": "",
    "latch_id": "",
    "latched_by_switch": False,
}
"""Changes of a `ThrowMachine` whose latch is cleared."""


def disarm(
    machine: ThrowMachine, reason: str, now_ns: int
) -> tuple[ThrowMachine, tuple[ThrowEvent, ...]]:
    """Give the armed plan back."""
    event = ThrowEvent(
        EventKind.DISARMED,
        plan_id=None if machine.plan is None else machine.plan.plan_id,
        data={"reason": reason},
    )
    return machine.rest(now_ns), (event,)


def abort(
    machine: ThrowMachine, reason: str, now_ns: int, *, is_policys_own: bool = False
) -> tuple[ThrowMachine, tuple[ThrowEvent, ...]]:
    """Bring a throw before its commit point to hold; it ends when the machine stands."""
    event = _event(machine, EventKind.ABORTED, {"reason": reason})
    after = machine.enter(
        ThrowState.SETTLING, now_ns, end_reason=reason, end_is_policys_own=is_policys_own
    )
    return after, (event,)


def latch(
    machine: ThrowMachine,
    state: ThrowState,
    reason: str,
    now_ns: int,
    *,
    by_switch: bool = False,
) -> tuple[ThrowMachine, tuple[ThrowEvent, ...]]:
    """STOPPED or FAULT from any state: valves closed until somebody clears it; a throw ends by it.

    Each latch has an id of its own, also where the machine was stopped already: a clear on its way for an
    earlier one does not undo it.
    """
    stopped = state is ThrowState.STOPPED
    kind = EventKind.STOP_LATCHED if stopped else EventKind.FAULT
    latch_count = machine.latch_count + 1
    latch_id = f"{machine.boot_id}.{latch_count}"
    events = [_event(machine, kind, {"reason": reason, "latch_id": latch_id})]
    if machine.state in RUNNING:
        end = ThrowEnd(outcome="stopped" if stopped else "fault", detail=reason)
        events.append(_event(machine, EventKind.THROW_ENDED, _end_data(machine, end)))
    elif machine.state is ThrowState.ARMED:
        events.append(_event(machine, EventKind.DISARMED, {"reason": reason}))
    after = machine.rest(now_ns).enter(
        state,
        now_ns,
        latched_reason=reason,
        latch_id=latch_id,
        latch_count=latch_count,
        latched_by_switch=by_switch,
    )
    return after, tuple(events)


def take_latch(machine: ThrowMachine, known: Latch | None, now_ns: int) -> ThrowMachine:
    """The machine as an earlier process left it: with its latch, or disarmed."""
    if known is None:
        return machine.rest(now_ns).enter(ThrowState.DISARMED, now_ns, **UNLATCHED)
    return machine.rest(now_ns).enter(
        known.state,
        now_ns,
        latched_reason=known.reason,
        latch_id=known.latch_id,
        latched_by_switch=False,
    )


def end_throw(machine: ThrowMachine, now_ns: int) -> tuple[ThrowMachine, tuple[ThrowEvent, ...]]:
    """The machine has come to rest after a throw or an abort."""
    if machine.end_fault:
        return latch(machine, ThrowState.FAULT, machine.end_fault, now_ns)
    if machine.end_reason:
        end = ThrowEnd(
            outcome="aborted",
            detail=machine.end_reason,
            is_policys_own=machine.end_is_policys_own,
        )
    else:
        end = ThrowEnd(outcome="landed")
    event = _event(machine, EventKind.THROW_ENDED, _end_data(machine, end))
    return machine.rest(now_ns), (event,)


def _event(machine: ThrowMachine, kind: EventKind, data: dict[str, object]) -> ThrowEvent:
    plan_id = None if machine.plan is None else machine.plan.plan_id
    return ThrowEvent(kind, machine.throw_id, plan_id, data)


def _end_data(machine: ThrowMachine, end: ThrowEnd) -> dict[str, object]:
    """ThrowEnd with the time from the policy's start to the release command, where there was one."""
    if machine.released_ns:
        seconds = (machine.released_ns - machine.started_ns) * 1e-9
        end = end.model_copy(update={"throw_duration_s": seconds})
    return end.model_dump(mode="json")
