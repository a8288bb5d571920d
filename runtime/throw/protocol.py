"""State, inputs and outputs of the throw protocol: the types of states.py.

No behaviour beyond lookups lives here. Times are the machine's monotonic clock.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

from machine.conventions import Mode, Motion
from machine.messages import (
    CheckResult,
    CommandReply,
    EventKind,
    RejectReason,
    ThrowPlan,
    ThrowState,
)
from machine.policy_card import PolicyCard
from machine.site.zones import ZoneSet

NONCE_VALID_S = 10.0
"""How long an armed machine waits for its fire."""
HEARTBEAT_SILENCE_S = 0.30
"""Silence that lets go before the commit point."""
FIRST_HEARTBEAT_S = 1.0
"""The machine stands still until the first heartbeat of a throw, for so long."""
ALIGN_TIMEOUT_S = 40.0
"""Twice the longest turn (180 degrees: 9 s) and the longest decay of swing seen (10 s)."""
RELEASE_TIMEOUT_S = 8.0
"""Policies release within 7 s or have failed (training facts)."""
HOLD_AFTER_ABORT_S = 1.5
"""The slowest joint (slew: 0.95 rad/s at 0.8 rad/s2 and its lag) stands by then."""
COMMIT_TIMEOUT_S = 2.0
"""The control step ends a throw 0.6 s after its release; it not having done so is a fault."""
SETTLE_TIMEOUT_S = 45.0
REPLY_MEMORY_COUNT = 256
"""Command ids and throw ids whose answers are kept."""

WAITING = frozenset({ThrowState.DISARMED, ThrowState.ARMED})
ABORTABLE = frozenset({ThrowState.ALIGNING, ThrowState.THROWING})
"""Of a throw that was fired: aborted to a hold. ARMED is not among them: it is only disarmed."""
RUNNING = ABORTABLE | {ThrowState.COMMITTED, ThrowState.SETTLING}
LATCHED = frozenset({ThrowState.STOPPED, ThrowState.FAULT})


@dataclass(frozen=True, slots=True)
class Facts:
    """What is true at this moment; `motion` and below are of the last control step."""

    model_sha256: str
    cards: dict[Mode, PolicyCard]
    """Policies on board."""
    checks: tuple[CheckResult, ...]
    payload_held: bool
    local_enable: bool
    emergency_stop: bool
    fresh_nonce: str
    """A secret that has never been given out; used if this message arms."""
    stalled_ns: int = -1
    """Machine's time when the control loop last stood still; -1 = it never did."""
    calibration_sha256: str = ""
    """Of valve tables and registrations on board."""
    zones_sha256: str | None = ""
    """Exclusion zones on board; empty = none, None = they cannot be read."""
    zone_conflict: Callable[[ThrowPlan], str] = lambda _: ""
    """Why a plan conflicts with the zones on board, for people; empty = it does not."""
    motion: Motion = Motion.HOLD
    aligned: bool = False
    release_commanded: bool = False
    throw_done: bool = False
    load_gone: bool = False
    settled: bool = False
    abort_reason: str = ""
    """Why a throw may not go on, for people; empty = it may."""
    abort_is_policys_own: bool = False
    """Whether what the policy did is that reason."""
    fault_reason: str = ""
    """Why the machine may not move at all; empty = it may."""


@dataclass(frozen=True, slots=True)
class Tick:
    """Time passes: sent at every control tick."""


@dataclass(frozen=True, slots=True)
class LinkLost:
    """The server cannot be reached: no router, or the link process or the supervisor has ended.

    A server that falls silent behind a router sends no heartbeats: that is noticed by their silence.
    """

    cause: str = "the link to the server is down"


@dataclass(frozen=True, slots=True)
class ThrowMachine:
    """State of the protocol on one machine."""

    machine_id: str
    state: ThrowState = ThrowState.DISARMED
    since_ns: int = 0
    """When `state` was entered."""
    epoch_count: int = 0
    """Highest lease epoch ever seen; kept over restarts by the caller."""
    lease_issuer: str = ""
    armed_issuer: str = ""
    plan: ThrowPlan | None = None
    nonce: str = ""
    """Empty = none, or used."""
    expired_nonce: str = ""
    """The last one that ran out, so that a late fire learns why."""
    throw_id: str | None = None
    heartbeat_ns: int = 0
    """Machine time that the sender of the newest holding heartbeat had seen; 0 = none for this throw."""
    heartbeat_sequence_count: int = -1
    end_reason: str = ""
    """Why a running throw was aborted; empty = it was not."""
    end_is_policys_own: bool = False
    """Whether what the policy did is that reason."""
    end_fault: str = ""
    """Fault to latch when the machine has come to rest."""
    latched_reason: str = ""
    """Why STOPPED or FAULT."""
    latch_id: str = ""
    """Names the present STOPPED or FAULT; empty = none. Never used again."""
    latch_count: int = 0
    """Latches of this boot so far."""
    latched_by_switch: bool = False
    """The present latch is that of the emergency stop's contact."""
    boot_id: str = ""
    """Makes latch ids differ between boots."""
    released_ns: int = 0
    started_ns: int = 0
    replies: tuple[tuple[str, CommandReply], ...] = ()
    """Answers by command id, oldest first."""
    throw_replies: tuple[tuple[str, CommandReply], ...] = ()
    """Answers to fire by throw id, oldest first."""

    @property
    def motion(self) -> Motion:
        """What the control step is to do: nothing else decides it."""
        if self.state in LATCHED:
            return Motion.STOP
        if self.state in WAITING or self.heartbeat_ns == 0 or self.end_reason:
            return Motion.HOLD
        if self.state is ThrowState.ALIGNING:
            return Motion.ALIGN
        return Motion.SETTLE if self.state is ThrowState.SETTLING else Motion.THROW

    def enter(self, state: ThrowState, now_ns: int, **changes: Any) -> "ThrowMachine":
        """The machine in another state, with what else changes."""
        return replace(self, state=state, since_ns=now_ns, **changes)

    def rest(self, now_ns: int) -> "ThrowMachine":
        """Disarmed: the plan, the nonce and the throw are gone."""
        return self.enter(
            ThrowState.DISARMED,
            now_ns,
            plan=None,
            nonce="",
            armed_issuer="",
            throw_id=None,
            heartbeat_ns=0,
            heartbeat_sequence_count=-1,
            end_reason="",
            end_is_policys_own=False,
            end_fault="",
            released_ns=0,
            started_ns=0,
        )


@dataclass(frozen=True, slots=True)
class Latch:
    """A STOPPED or FAULT that lasts until somebody clears it by its id."""

    latch_id: str
    state: ThrowState
    reason: str


@dataclass(frozen=True, slots=True)
class ThrowEvent:
    """A durable event to emit."""

    kind: EventKind
    throw_id: str | None = None
    plan_id: str | None = None
    data: dict[str, Any] = field(default_factory=dict[str, Any])


@dataclass(frozen=True, slots=True)
class Actions:
    """What follows from one message: answer it, emit these, take up a load, keep these zones."""

    reply: CommandReply | None = None
    events: tuple[ThrowEvent, ...] = ()
    load: bool = False
    zones: ZoneSet | None = None


@dataclass(frozen=True, slots=True)
class CommandRefusal:
    """Why not, with the numbers and the remedy."""

    reason: RejectReason
    detail: str


def find_reply(
    replies: tuple[tuple[str, CommandReply], ...], wanted_id: str
) -> CommandReply | None:
    """The stored answer of an id."""
    for known_id, reply in reversed(replies):
        if known_id == wanted_id:
            return reply
    return None


def keep_reply(
    replies: tuple[tuple[str, CommandReply], ...], new_id: str, reply: CommandReply
) -> tuple[tuple[str, CommandReply], ...]:
    """The answers with one more; the oldest beyond the memory are forgotten."""
    return (*replies, (new_id, reply))[-REPLY_MEMORY_COUNT:]
