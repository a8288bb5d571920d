"""The moves that several parts of the throw protocol make: disarm, abort, latch, end a throw; pure."""

from machine.messages import EventKind, ThrowEnd, ThrowState
from runtime.throw.protocol import RUNNING, ThrowEvent, ThrowMachine


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
    machine: ThrowMachine, reason: str, now_ns: int
) -> tuple[ThrowMachine, tuple[ThrowEvent, ...]]:
    """Bring a throw before its commit point to hold; it ends when the machine stands."""
    event = _event(machine, EventKind.ABORTED, {"reason": reason})
    return machine.enter(ThrowState.SETTLING, now_ns, end_reason=reason), (event,)


def latch(
    machine: ThrowMachine, state: ThrowState, reason: str, now_ns: int
) -> tuple[ThrowMachine, tuple[ThrowEvent, ...]]:
    """STOPPED or FAULT from any state: valves closed until somebody clears it; a throw ends by it."""
    stopped = state is ThrowState.STOPPED
    kind = EventKind.STOP_LATCHED if stopped else EventKind.FAULT
    events = [_event(machine, kind, {"reason": reason})]
    if machine.state in RUNNING:
        end = ThrowEnd(outcome="stopped" if stopped else "fault", detail=reason)
        events.append(_event(machine, EventKind.THROW_ENDED, _end_data(machine, end)))
    elif machine.state is ThrowState.ARMED:
        events.append(_event(machine, EventKind.DISARMED, {"reason": reason}))
    after = machine.rest(now_ns).enter(state, now_ns, latched_reason=reason)
    return after, tuple(events)


def end_throw(machine: ThrowMachine, now_ns: int) -> tuple[ThrowMachine, tuple[ThrowEvent, ...]]:
    """The machine has come to rest after a throw or an abort."""
    if machine.end_fault:
        return latch(machine, ThrowState.FAULT, machine.end_fault, now_ns)
    if machine.end_reason:
        end = ThrowEnd(outcome="aborted", detail=machine.end_reason)
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
