"""What each command does to the throw protocol, and every reason to refuse it; pure.

A command id is answered once and remembered; so is the throw id of a fire. Every refusal says the numbers
and the remedy.
"""

from dataclasses import replace

from machine.errors import RefusedError
from machine.messages import (
    AbortRequest,
    ArmRequest,
    Command,
    CommandReply,
    DisarmRequest,
    EventKind,
    FireRequest,
    LeaseNotice,
    LoadRequest,
    RejectReason,
    StopClearRequest,
    StopRequest,
    ThrowPlan,
    ThrowState,
    ZonesRequest,
)
from machine.policy_card import PolicyCard
from machine.reach import check_target
from machine.site.thrown_material import load_kg
from runtime.throw.freshness import why_stale
from runtime.throw.protocol import (
    ABORTABLE,
    LATCHED,
    NONCE_VALID_S,
    RUNNING,
    Actions,
    CommandRefusal,
    Facts,
    ThrowEvent,
    ThrowMachine,
    find_reply,
    keep_reply,
)
from runtime.throw.transitions import UNLATCHED, abort, disarm, latch

Answer = tuple[ThrowMachine, CommandRefusal | None, tuple[ThrowEvent, ...]]
"""The machine after a command, why it was refused (None = it was not), and events."""


def handle_command(
    machine: ThrowMachine, command: Command, facts: Facts, now_ns: int
) -> tuple[ThrowMachine, Actions]:
    """Execute or refuse one command and answer it; a repeated id gets its first answer."""
    known = _first_answer(machine, command)
    if known is not None:
        return machine, Actions(reply=_repeat(machine, command, known))
    machine, refusal, events = _execute(machine, command, facts, now_ns)
    reply = _reply(machine, command, refusal)
    if refusal is not None:
        data = {"command": command.kind, "issuer": command.issuer, "reason": refusal.reason.value}
        events = (
            *events,
            ThrowEvent(EventKind.COMMAND_REFUSED, data={**data, "detail": refusal.detail}),
        )
    is_stale = refusal is not None and why_stale(command, now_ns, facts.stalled_ns) != ""
    if command.machine_id == machine.machine_id and not is_stale:
        machine = replace(machine, replies=keep_reply(machine.replies, command.command_id, reply))
        if isinstance(command, FireRequest) and command.epoch_count == machine.epoch_count:
            kept = keep_reply(machine.throw_replies, command.throw_id, reply)
            machine = replace(machine, throw_replies=kept)
    load = isinstance(command, LoadRequest) and refusal is None and not facts.payload_held
    zones = command.zone_set if isinstance(command, ZonesRequest) and refusal is None else None
    return machine, Actions(reply=reply, events=events, load=load, zones=zones)


def _first_answer(machine: ThrowMachine, command: Command) -> CommandReply | None:
    """What a repeated command, or another fire of a known throw under the same lease, was answered."""
    if command.machine_id != machine.machine_id:
        return None
    known = find_reply(machine.replies, command.command_id)
    if known is not None or not isinstance(command, FireRequest):
        return known
    if command.epoch_count != machine.epoch_count:
        return None
    return find_reply(machine.throw_replies, command.throw_id)


def _repeat(machine: ThrowMachine, command: Command, known: CommandReply) -> CommandReply:
    """The first answer; that to a STOP with what is true now, because it may have been cleared since."""
    changes: dict[str, object] = {"command_id": command.command_id, "is_repeat": True}
    if isinstance(command, StopRequest) and known.accepted:
        changes |= {"state": machine.state, "latch_id": machine.latch_id}
        if machine.state is not ThrowState.STOPPED:
            changes["detail"] = (
                "This STOP was executed and has been cleared since. Press STOP again to stop."
            )
    return known.model_copy(update=changes)


def _reply(machine: ThrowMachine, command: Command, refusal: CommandRefusal | None) -> CommandReply:
    armed = isinstance(command, ArmRequest) and refusal is None
    return CommandReply(
        command_id=command.command_id,
        machine_id=machine.machine_id,
        accepted=refusal is None,
        state=machine.state,
        epoch_count=machine.epoch_count,
        reason=None if refusal is None else refusal.reason,
        detail="" if refusal is None else refusal.detail,
        nonce=machine.nonce if armed else None,
        nonce_valid_s=NONCE_VALID_S if armed else None,
        throw_id=command.throw_id if isinstance(command, FireRequest) else None,
        latch_id=machine.latch_id,
    )


def _execute(machine: ThrowMachine, command: Command, facts: Facts, now_ns: int) -> Answer:
    if command.machine_id != machine.machine_id:
        detail = f"This is {machine.machine_id}, the command is for {command.machine_id}."
        return machine, CommandRefusal(RejectReason.WRONG_MACHINE, detail), ()
    if isinstance(command, StopRequest):
        return _stop(machine, command, now_ns)
    if isinstance(command, ZonesRequest):
        return _zones(machine, command, facts, now_ns)
    if command.epoch_count < machine.epoch_count:
        return machine, _stale(machine, command.epoch_count), ()
    if isinstance(command, LeaseNotice):
        return _lease(machine, command, now_ns)
    if command.epoch_count > machine.epoch_count or command.epoch_count == 0:
        refusal = CommandRefusal(
            RejectReason.NO_LEASE,
            f"Epoch {command.epoch_count} is unknown here (highest {machine.epoch_count}). "
            "Take the lease first.",
        )
        return _conflict(machine, refusal, now_ns)
    if stale := why_stale(command, now_ns, facts.stalled_ns):
        return machine, CommandRefusal(RejectReason.COMMAND_STALE, stale), ()
    if isinstance(command, ArmRequest):
        return _arm(machine, command, facts, now_ns)
    if isinstance(command, FireRequest):
        return _fire(machine, command, facts, now_ns)
    if isinstance(command, AbortRequest):
        return _abort(machine, command, now_ns)
    if isinstance(command, DisarmRequest):
        return _disarm(machine, command, now_ns)
    if isinstance(command, StopClearRequest):
        return _clear(machine, command, facts, now_ns)
    return _load(machine)


def _conflict(machine: ThrowMachine, refusal: CommandRefusal, now_ns: int) -> Answer:
    """Two controllers at once: refuse, and bring what is armed or running to hold."""
    reason = f"a second controller sent a command: {refusal.detail}"
    if machine.state is ThrowState.ARMED:
        machine, events = disarm(machine, reason, now_ns)
        return machine, refusal, events
    if machine.state in ABORTABLE:
        machine, events = abort(machine, reason, now_ns)
        return machine, refusal, events
    return machine, refusal, ()


def _stale(machine: ThrowMachine, epoch_count: int) -> CommandRefusal:
    return CommandRefusal(
        RejectReason.STALE_EPOCH,
        f"Epoch {epoch_count} has been replaced by {machine.epoch_count}. Take the lease again.",
    )


def _stop(machine: ThrowMachine, command: StopRequest, now_ns: int) -> Answer:
    machine, events = latch(machine, ThrowState.STOPPED, f"STOP by {command.issuer}", now_ns)
    return machine, None, events


def _lease(machine: ThrowMachine, command: LeaseNotice, now_ns: int) -> Answer:
    if command.epoch_count == machine.epoch_count:
        if machine.lease_issuer in ("", command.issuer):
            return replace(machine, lease_issuer=command.issuer), None, ()
        refusal = CommandRefusal(
            RejectReason.LEASE_HELD,
            f"Epoch {command.epoch_count} belongs to {machine.lease_issuer}, not to "
            f"{command.issuer}. Take the lease over with a new epoch.",
        )
        return _conflict(machine, refusal, now_ns)
    events: tuple[ThrowEvent, ...] = ()
    reason = f"the lease went to {command.issuer} (epoch {command.epoch_count})"
    if machine.state is ThrowState.ARMED:
        machine, events = disarm(machine, reason, now_ns)
    elif machine.state in ABORTABLE:
        machine, events = abort(machine, reason, now_ns)
    after = replace(machine, epoch_count=command.epoch_count, lease_issuer=command.issuer)
    return after, None, events


def _zones(machine: ThrowMachine, command: ZonesRequest, facts: Facts, now_ns: int) -> Answer:
    """Take another set of exclusion zones; a throw goes on with the set it was armed with."""
    if stale := why_stale(command, now_ns, facts.stalled_ns):
        return machine, CommandRefusal(RejectReason.COMMAND_STALE, stale), ()
    if machine.state in RUNNING:
        detail = f"The machine is {machine.state.value}. It takes exclusion zones when the throw has ended."
        return machine, CommandRefusal(RejectReason.BUSY, detail), ()
    if machine.state is ThrowState.ARMED and command.zone_set.sha256 != facts.zones_sha256:
        machine, events = disarm(machine, "the exclusion zones were changed", now_ns)
        return machine, None, events
    return machine, None, ()


def _latched(machine: ThrowMachine) -> CommandRefusal | None:
    if machine.state is ThrowState.STOPPED:
        detail = f"Stopped ({machine.latched_reason}). Clear the stop first."
        return CommandRefusal(RejectReason.STOP_LATCHED, detail)
    if machine.state is ThrowState.FAULT:
        detail = f"Fault: {machine.latched_reason}. Remove the cause, then clear it."
        return CommandRefusal(RejectReason.FAULT, detail)
    return None


def _not_ready(facts: Facts) -> CommandRefusal | None:
    """Payload and arming checks, the same for arm and fire."""
    if not facts.payload_held:
        return CommandRefusal(
            RejectReason.NO_PAYLOAD, "No load in the gripper. Load the machine first."
        )
    for check in facts.checks:
        if check.severity == "error" and not check.passed:
            return CommandRefusal(RejectReason.CHECK_FAILED, f"{check.text} {check.remedy}".strip())
    return None


def _arm(machine: ThrowMachine, command: ArmRequest, facts: Facts, now_ns: int) -> Answer:
    if machine.state is ThrowState.ARMED and command.issuer != machine.armed_issuer:
        refusal = CommandRefusal(
            RejectReason.LEASE_HELD,
            f"Armed by {machine.armed_issuer}, not by {command.issuer}. Only one may command.",
        )
        return _conflict(machine, refusal, now_ns)
    refusal = _latched(machine)
    if refusal is None and machine.state is not ThrowState.DISARMED:
        detail = f"The machine is {machine.state.value}. Disarm it or wait until it is disarmed."
        refusal = CommandRefusal(RejectReason.NOT_DISARMED, detail)
    refusal = refusal or _plan_refusal(machine, command, facts) or _not_ready(facts)
    if refusal is not None:
        return machine, refusal, ()
    after = machine.enter(
        ThrowState.ARMED,
        now_ns,
        plan=command.plan,
        nonce=facts.fresh_nonce,
        armed_issuer=command.issuer,
    )
    data = {"issuer": command.issuer, "plan_hash": command.plan.plan_hash}
    return after, None, (ThrowEvent(EventKind.ARMED, plan_id=command.plan.plan_id, data=data),)


def _plan_refusal(
    machine: ThrowMachine, command: ArmRequest, facts: Facts
) -> CommandRefusal | None:
    """Whether this plan is for this machine, this model and a policy that is on board."""
    plan = command.plan
    if plan.machine_id != machine.machine_id:
        detail = f"The plan is for {plan.machine_id}, this is {machine.machine_id}. Plan again."
        return CommandRefusal(RejectReason.WRONG_MACHINE, detail)
    if plan.model_sha256 != facts.model_sha256:
        return CommandRefusal(
            RejectReason.MODEL_MISMATCH,
            f"The plan is for model {plan.model_sha256[:12]}, this machine is "
            f"{facts.model_sha256[:12]}. Update server or machine.",
        )
    card = facts.cards.get(plan.mode)
    if card is None:
        detail = f"No {plan.mode.value} policy on board. Deploy one."
        return CommandRefusal(RejectReason.POLICY_UNUSABLE, detail)
    if plan.policy_sha256 != card.policy_sha256:
        return CommandRefusal(
            RejectReason.POLICY_MISMATCH,
            f"The plan is for policy {plan.policy_sha256[:12]}, on board is "
            f"{card.policy_sha256[:12]} ({card.policy_id}). Preview again with the policy on board.",
        )
    try:
        check_target(card, plan.target, load_kg(plan.material))
    except RefusedError as error:
        return CommandRefusal(error.reason, error.detail)
    return _aim_refusal(plan, card, facts) or _zone_refusal(plan, facts)


def _aim_refusal(plan: ThrowPlan, card: PolicyCard, facts: Facts) -> CommandRefusal | None:
    """Whether the plan's aim correction belongs to the policy and the calibration on board."""
    if plan.aim is None:
        return None
    given = (plan.aim.policy_sha256, plan.aim.calibration_sha256)
    if given != (card.policy_sha256, facts.calibration_sha256):
        return CommandRefusal(
            RejectReason.AIM_MISMATCH,
            f"Aim correction v{plan.aim.version_count} is of policy {given[0][:12]} and calibration "
            f"{given[1][:12]}; on board are {card.policy_sha256[:12]} and "
            f"{facts.calibration_sha256[:12]}. Preview again.",
        )
    try:
        check_target(card, plan.aim_target, load_kg(plan.material))
    except RefusedError as error:
        detail = f"With aim correction v{plan.aim.version_count}: {error.detail}"
        return CommandRefusal(error.reason, detail)
    return None


def _zone_refusal(plan: ThrowPlan, facts: Facts) -> CommandRefusal | None:
    """Whether the plan was made with this machine's exclusion zones, and keeps out of them."""
    if facts.zones_sha256 is None:
        detail = "The exclusion zones on this machine cannot be read. Its server sends them again."
        return CommandRefusal(RejectReason.ZONES_MISMATCH, detail)
    if (plan.zones_sha256 or "") != facts.zones_sha256:
        names = [(sha or "none")[:12] for sha in (plan.zones_sha256, facts.zones_sha256)]
        detail = (
            f"The plan was made with exclusion zones {names[0]}, this machine has {names[1]}. "
            "Preview again."
        )
        return CommandRefusal(RejectReason.ZONES_MISMATCH, detail)
    conflict = facts.zone_conflict(plan)
    return CommandRefusal(RejectReason.TARGET_IN_ZONE, conflict) if conflict else None


def _fire(machine: ThrowMachine, command: FireRequest, facts: Facts, now_ns: int) -> Answer:
    if machine.plan is not None and command.issuer != machine.armed_issuer:
        refusal = CommandRefusal(
            RejectReason.LEASE_HELD,
            f"Armed by {machine.armed_issuer}, fired by {command.issuer}. Only one may command.",
        )
        return _conflict(machine, refusal, now_ns)
    refusal = _fire_refusal(machine, command) or _not_ready(facts)
    if refusal is not None:
        return machine, refusal, ()
    # The nonce is used up whatever happens next.
    after = machine.enter(
        ThrowState.ALIGNING,
        now_ns,
        nonce="",
        throw_id=command.throw_id,
        heartbeat_ns=0,
        heartbeat_sequence_count=-1,
    )
    plan_id = None if after.plan is None else after.plan.plan_id
    data = {"issuer": command.issuer, "epoch_count": command.epoch_count}
    return after, None, (ThrowEvent(EventKind.THROW_ACCEPTED, command.throw_id, plan_id, data),)


def _fire_refusal(machine: ThrowMachine, command: FireRequest) -> CommandRefusal | None:
    latched = _latched(machine)
    if latched is not None:
        return latched
    if machine.expired_nonce and command.nonce == machine.expired_nonce:
        detail = f"The nonce is older than the {NONCE_VALID_S:.0f} s allowed. Arm again."
        return CommandRefusal(RejectReason.NONCE_EXPIRED, detail)
    if machine.state is not ThrowState.ARMED or machine.plan is None:
        detail = f"The machine is {machine.state.value}. Arm it first."
        return CommandRefusal(RejectReason.NOT_ARMED, detail)
    if not machine.nonce or command.nonce != machine.nonce:
        detail = "The nonce is not the one this machine gave out. Arm again."
        return CommandRefusal(RejectReason.NONCE_UNKNOWN, detail)
    if command.plan_hash != machine.plan.plan_hash:
        return CommandRefusal(
            RejectReason.PLAN_MISMATCH,
            f"Fired plan {command.plan_hash[:12]}, armed is {machine.plan.plan_hash[:12]}. "
            "Arm the plan that is to be thrown.",
        )
    return None


def _abort(machine: ThrowMachine, command: AbortRequest, now_ns: int) -> Answer:
    reason = f"aborted by {command.issuer}"
    if machine.state is ThrowState.ARMED:
        machine, events = disarm(machine, reason, now_ns)
        return machine, None, events
    if machine.state in ABORTABLE:
        machine, events = abort(machine, reason, now_ns)
        return machine, None, events
    if machine.state is ThrowState.COMMITTED:
        detail = (
            "The release has been commanded; the machine completes the throw. STOP still works."
        )
        return machine, CommandRefusal(RejectReason.BUSY, detail), ()
    return machine, None, ()


def _disarm(machine: ThrowMachine, command: DisarmRequest, now_ns: int) -> Answer:
    if machine.state is ThrowState.ARMED:
        machine, events = disarm(machine, f"disarmed by {command.issuer}", now_ns)
        return machine, None, events
    if machine.state is ThrowState.DISARMED or machine.state in LATCHED:
        return machine, None, ()
    detail = f"The machine is {machine.state.value}. Abort the throw, or wait until it has ended."
    return machine, CommandRefusal(RejectReason.BUSY, detail), ()


def _clear(machine: ThrowMachine, command: StopClearRequest, facts: Facts, now_ns: int) -> Answer:
    if machine.state not in LATCHED:
        return machine, None, ()
    if facts.emergency_stop:
        detail = "The emergency stop at the machine is pressed. Release it, then clear."
        return machine, CommandRefusal(RejectReason.CHECK_FAILED, detail), ()
    if facts.fault_reason:
        detail = f"The cause is still there: {facts.fault_reason}. Remove it, then clear."
        return machine, CommandRefusal(RejectReason.FAULT, detail), ()
    refusal = _clear_refusal(machine, command)
    if refusal is not None:
        return machine, refusal, ()
    data = {
        "issuer": command.issuer,
        "was": machine.state.value,
        "latch_id": machine.latch_id,
        "sighted_by": command.sighted_by,
        "reason": command.reason,
    }
    after = replace(machine.rest(now_ns), **UNLATCHED)
    return after, None, (ThrowEvent(EventKind.STOP_CLEARED, data=data),)


def _clear_refusal(machine: ThrowMachine, command: StopClearRequest) -> CommandRefusal | None:
    """A clear names its latch, who sees the machine, and why it may move again."""
    if command.latch_id != machine.latch_id:
        named = f"the latch {command.latch_id}" if command.latch_id else "no latch"
        return CommandRefusal(
            RejectReason.STOP_LATCHED,
            f"The clear names {named}, latched is {machine.latch_id} ({machine.latched_reason}). "
            "Look at the machine again, then clear what is latched now.",
        )
    if not (command.sighted_by or "").strip() or not (command.reason or "").strip():
        return CommandRefusal(
            RejectReason.CHECK_FAILED,
            "A clear says who sees the machine and why it may move again. State both, then clear.",
        )
    return None


def _load(machine: ThrowMachine) -> Answer:
    refusal = _latched(machine)
    if refusal is None and machine.state is not ThrowState.DISARMED:
        detail = f"The machine is {machine.state.value}. Loading needs a disarmed machine."
        refusal = CommandRefusal(RejectReason.NOT_DISARMED, detail)
    return machine, refusal, ()
