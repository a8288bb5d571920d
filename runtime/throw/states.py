"""The throw protocol on the machine: lease epoch, arm, fire, hold, commit, settle, STOP; pure and scalar.

`update` takes one message (or the passing of time) and the facts of the moment, and returns the new state
and what to answer and emit. It alone asks for a motion; the safety gate permits it or closes the valves. It
sends nothing, waits for nothing, and never acts on a stale epoch, a used nonce, or a throw id it has seen.

Commit point: the gripper opens. Before it, letting go of the button, silence, a lost server, an abort or a
broken check bring the machine to hold; after it the machine completes the throw, unless STOP, the emergency
stop or a fault latches.
"""

from dataclasses import replace

from machine.conventions import Motion
from machine.messages import Command, EventKind, OperatorHeartbeat, ThrowState
from runtime.throw.command_rules import handle_command
from runtime.throw.freshness import why_stale
from runtime.throw.protocol import (
    ABORTABLE,
    ALIGN_TIMEOUT_S,
    COMMIT_TIMEOUT_S,
    FIRST_HEARTBEAT_S,
    HEARTBEAT_SILENCE_S,
    HOLD_AFTER_ABORT_S,
    NONCE_VALID_S,
    RELEASE_TIMEOUT_S,
    RUNNING,
    SETTLE_TIMEOUT_S,
    Actions,
    Facts,
    LinkLost,
    ThrowEvent,
    ThrowMachine,
    Tick,
)
from runtime.throw.transitions import abort, disarm, end_throw, latch

Message = Command | OperatorHeartbeat | Tick | LinkLost


def update(
    machine: ThrowMachine, message: Message, facts: Facts, now_ns: int
) -> tuple[ThrowMachine, Actions]:
    """One message; returns the machine after it, and its actions.

    Args:
        machine: state so far.
        message: a command, a heartbeat, that time passes, or that the server cannot be reached.
        facts: what is true now.
        now_ns: machine's monotonic clock; never goes back.
    """
    # What the machine itself says comes first: no message can overtake it.
    machine, events = _passing_time(machine, facts, now_ns)
    actions = Actions()
    if isinstance(message, OperatorHeartbeat):
        machine, more = _heartbeat(machine, message, facts, now_ns)
    elif isinstance(message, LinkLost):
        machine, more = _let_go(machine, message.cause, now_ns)
    elif isinstance(message, Tick):
        more = ()
    else:
        machine, actions = handle_command(machine, message, facts, now_ns)
        more = actions.events
    return machine, replace(actions, events=(*events, *more))


def _heartbeat(
    machine: ThrowMachine, beat: OperatorHeartbeat, facts: Facts, now_ns: int
) -> tuple[ThrowMachine, tuple[ThrowEvent, ...]]:
    """A heartbeat counts only for the running throw, the current epoch, and once."""
    if (
        machine.state not in ABORTABLE
        or beat.machine_id != machine.machine_id
        or beat.throw_id != machine.throw_id
        or beat.epoch_count != machine.epoch_count
        or beat.sequence_count <= machine.heartbeat_sequence_count
    ):
        return machine, ()
    if not beat.is_holding:
        machine = replace(machine, heartbeat_sequence_count=beat.sequence_count)
        return _let_go(machine, "the operator let go", now_ns)
    if beat.seen_t_mono_ns is None or why_stale(beat, now_ns, facts.stalled_ns):
        return machine, ()
    # It counts from when it can have been sent at the earliest: time on its way is silence.
    seen_ns = max(machine.heartbeat_ns, beat.seen_t_mono_ns)
    after = replace(
        machine, heartbeat_sequence_count=beat.sequence_count, heartbeat_ns=max(seen_ns, 1)
    )
    return after, ()


def _let_go(
    machine: ThrowMachine, reason: str, now_ns: int
) -> tuple[ThrowMachine, tuple[ThrowEvent, ...]]:
    if machine.state is ThrowState.ARMED:
        return disarm(machine, reason, now_ns)
    if machine.state in ABORTABLE:
        return abort(machine, reason, now_ns)
    return machine, ()


def _passing_time(
    machine: ThrowMachine, facts: Facts, now_ns: int
) -> tuple[ThrowMachine, tuple[ThrowEvent, ...]]:
    if facts.emergency_stop and not machine.latched_by_switch:
        reason = "the emergency stop is pressed"
        return latch(machine, ThrowState.STOPPED, reason, now_ns, by_switch=True)
    if machine.state in RUNNING:
        if facts.fault_reason:
            return latch(machine, ThrowState.FAULT, facts.fault_reason, now_ns)
        return _running(machine, facts, now_ns)
    if machine.state is ThrowState.ARMED:
        return _armed(machine, facts, now_ns)
    return machine, ()


def _armed(
    machine: ThrowMachine, facts: Facts, now_ns: int
) -> tuple[ThrowMachine, tuple[ThrowEvent, ...]]:
    """An armed machine only waits; whatever speaks against the throw disarms it."""
    if _past(machine.since_ns, NONCE_VALID_S, now_ns):
        machine = replace(machine, expired_nonce=machine.nonce)
        return disarm(machine, f"not fired within {NONCE_VALID_S:.0f} s", now_ns)
    for check in facts.checks:
        if check.severity == "error" and not check.passed:
            return disarm(machine, check.text, now_ns)
    return machine, ()


def _running(
    machine: ThrowMachine, facts: Facts, now_ns: int
) -> tuple[ThrowMachine, tuple[ThrowEvent, ...]]:
    if machine.state is ThrowState.COMMITTED:
        return _committed(machine, facts, now_ns)
    if machine.state is ThrowState.SETTLING:
        return _settling(machine, facts, now_ns)
    # The facts are those of the last control step. A release that its gate did not let through cannot be
    # among them: a refused one is not reported, a fault was latched above, and an enable switch that is off
    # aborted the throw before that step. From here on the throw is completed.
    if machine.state is ThrowState.THROWING and (
        facts.motion is Motion.THROW and facts.release_commanded
    ):
        event = ThrowEvent(EventKind.RELEASE_COMMANDED, machine.throw_id, _plan_id(machine))
        return machine.enter(ThrowState.COMMITTED, now_ns, released_ns=now_ns), (event,)
    reason, is_policys_own = _why_abort(machine, facts, now_ns)
    if reason:
        return abort(machine, reason, now_ns, is_policys_own=is_policys_own)
    if machine.state is ThrowState.ALIGNING and facts.motion is Motion.ALIGN and facts.aligned:
        event = ThrowEvent(EventKind.THROW_STARTED, machine.throw_id, _plan_id(machine))
        return machine.enter(ThrowState.THROWING, now_ns, started_ns=now_ns), (event,)
    return machine, ()


def _why_abort(machine: ThrowMachine, facts: Facts, now_ns: int) -> tuple[str, bool]:
    """Why a throw before its commit point may not go on (empty = it may), and whether the policy is why."""
    aligning = machine.state is ThrowState.ALIGNING
    if not facts.local_enable:
        return "the enable switch at the machine is off", False
    if facts.abort_reason:
        return facts.abort_reason, facts.abort_is_policys_own
    if not facts.payload_held:
        return "the load left the gripper before the release", False
    silence = _silence(machine, now_ns)
    if silence:
        return silence, False
    if aligning and _past(machine.since_ns, ALIGN_TIMEOUT_S, now_ns):
        return f"not aligned and calm within {ALIGN_TIMEOUT_S:.0f} s", False
    if not aligning and _past(machine.since_ns, RELEASE_TIMEOUT_S, now_ns):
        return f"the policy did not release within {RELEASE_TIMEOUT_S:.0f} s", True
    return "", False


def _silence(machine: ThrowMachine, now_ns: int) -> str:
    """Which heartbeat is missing; empty = none."""
    if machine.heartbeat_ns == 0:
        late = _past(machine.since_ns, FIRST_HEARTBEAT_S, now_ns)
        return f"no heartbeat within {FIRST_HEARTBEAT_S:.1f} s of the fire" if late else ""
    if not _past(machine.heartbeat_ns, HEARTBEAT_SILENCE_S, now_ns):
        return ""
    silent_s = (now_ns - machine.heartbeat_ns) * 1e-9
    return (
        f"no heartbeat for {silent_s:.2f} s, {HEARTBEAT_SILENCE_S:.2f} s are allowed; "
        "hold the button until the load is gone"
    )


def _committed(
    machine: ThrowMachine, facts: Facts, now_ns: int
) -> tuple[ThrowMachine, tuple[ThrowEvent, ...]]:
    if facts.motion is Motion.THROW and facts.throw_done:
        fault = (
            ""
            if facts.load_gone
            else "the gripper was commanded to open, but its switch still sees a load"
        )
    elif _past(machine.since_ns, COMMIT_TIMEOUT_S, now_ns):
        fault = f"the control step did not end the throw within {COMMIT_TIMEOUT_S:.0f} s"
    else:
        return machine, ()
    return machine.enter(ThrowState.SETTLING, now_ns, end_fault=fault), ()


def _settling(
    machine: ThrowMachine, facts: Facts, now_ns: int
) -> tuple[ThrowMachine, tuple[ThrowEvent, ...]]:
    if machine.end_reason:
        done = _past(machine.since_ns, HOLD_AFTER_ABORT_S, now_ns)
    else:
        # Without the gripper's swing nothing can be damped: the machine holds.
        settled = facts.motion is Motion.SETTLE and (facts.settled or bool(facts.abort_reason))
        late = _past(machine.since_ns, SETTLE_TIMEOUT_S, now_ns)
        done = settled or not facts.local_enable or late
    return end_throw(machine, now_ns) if done else (machine, ())


def _past(since_ns: int, allowed_s: float, now_ns: int) -> bool:
    """Whether more than the allowed time has passed; in whole nanoseconds, so that the edge is exact."""
    return now_ns - since_ns > round(allowed_s * 1e9)


def _plan_id(machine: ThrowMachine) -> str | None:
    return None if machine.plan is None else machine.plan.plan_id
