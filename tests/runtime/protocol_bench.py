"""Messages, facts and a driver of the throw protocol for its tests."""

from dataclasses import replace
from typing import Any

from machine.conventions import Mode, Motion
from machine.messages import (
    AbortRequest,
    ArmRequest,
    DisarmRequest,
    FireRequest,
    LeaseNotice,
    LoadRequest,
    OperatorHeartbeat,
    StopClearRequest,
    StopRequest,
    Target,
    ThrowPlan,
    ThrowState,
    ZonesRequest,
)
from machine.policy_card import PolicyCard
from machine.site.zones import ZoneSet
from runtime.throw.protocol import Actions, Facts, ThrowMachine, Tick
from runtime.throw.states import update

MODEL = "a" * 64
POLICY = "b" * 64
SECOND_NS = 1_000_000_000


def card(mode: Mode = Mode.PLANAR, sha256: str = POLICY) -> PolicyCard:
    return PolicyCard.model_construct(
        policy_id=f"test-{mode.value}",
        mode=mode,
        policy_sha256=sha256,
        model_sha256=MODEL,
        target_range_min_m=5.5,
        target_range_max_m=10.9,
        target_height_min_m=0.0,
        target_height_max_m=0.0,
    )


def plan(**changes: Any) -> ThrowPlan:
    values: dict[str, Any] = {
        "plan_id": "plan-1",
        "machine_id": "m001",
        "mode": Mode.PLANAR,
        "target": Target(x_m=8.5, y_m=0.0),
        "policy_sha256": POLICY,
        "model_sha256": MODEL,
        "twin_profile_version": 1,
        "predicted_impact_m": (8.5, 0.0, 0.0),
    }
    return ThrowPlan(**{**values, **changes})


FACTS = Facts(
    model_sha256=MODEL,
    cards={Mode.PLANAR: card()},
    checks=(),
    payload_held=True,
    local_enable=True,
    emergency_stop=False,
    fresh_nonce="nonce-1",
)


class Bench:
    """One machine with a clock; every call is one message, its actions are kept."""

    def __init__(self, epoch: int = 3, **state: Any) -> None:
        self.machine = ThrowMachine("m001", epoch_count=epoch, lease_issuer="anna", **state)
        self.facts = FACTS
        self.now_ns = 100 * SECOND_NS
        self.epoch = epoch
        self.numbers = 0
        self.beats = 0
        self.actions = Actions()

    def send(self, message: Any, **facts: Any) -> Actions:
        given = replace(self.facts, **facts)
        self.machine, self.actions = update(self.machine, message, given, self.now_ns)
        return self.actions

    def wait(self, seconds: float) -> None:
        self.now_ns += round(seconds * SECOND_NS)

    def head(self, **changes: Any) -> dict[str, Any]:
        self.numbers += 1
        values = {
            "command_id": f"c{self.numbers}",
            "machine_id": "m001",
            "issuer": "anna",
            "epoch_count": self.epoch,
            "seen_t_mono_ns": self.now_ns,
        }
        return {**values, **changes}

    def tick(self, **facts: Any) -> Actions:
        return self.send(Tick(), **facts)

    def lease(self, **changes: Any) -> Actions:
        return self.send(LeaseNotice(**self.head(**changes)))

    def arm(
        self,
        with_plan: ThrowPlan | None = None,
        facts: dict[str, Any] | None = None,
        **changes: Any,
    ) -> Actions:
        message = ArmRequest(plan=with_plan or plan(), **self.head(**changes))
        return self.send(message, **(facts or {}))

    def fire(self, facts: dict[str, Any] | None = None, **changes: Any) -> Actions:
        values = {"throw_id": "t1", "nonce": self.machine.nonce, "plan_hash": plan().plan_hash}
        return self.send(FireRequest(**self.head(**{**values, **changes})), **(facts or {}))

    def beat(self, **changes: Any) -> Actions:
        self.beats += 1
        values = {
            "machine_id": "m001",
            "throw_id": "t1",
            "epoch_count": self.epoch,
            "sequence_count": self.beats,
            "is_holding": True,
            "seen_t_mono_ns": self.now_ns,
        }
        return self.send(OperatorHeartbeat(**{**values, **changes}))

    def abort(self, **changes: Any) -> Actions:
        return self.send(AbortRequest(**self.head(**changes)))

    def disarm(self, **changes: Any) -> Actions:
        return self.send(DisarmRequest(**self.head(**changes)))

    def load(self, facts: dict[str, Any] | None = None, **changes: Any) -> Actions:
        return self.send(LoadRequest(**self.head(**changes)), **(facts or {}))

    def zones(self, zone_set: ZoneSet, **changes: Any) -> Actions:
        values = self.head(**changes)
        values.pop("epoch_count")
        return self.send(ZonesRequest(zone_set=zone_set, **values))

    def stop(self, **changes: Any) -> Actions:
        values = self.head(**changes)
        values.pop("epoch_count")
        values.pop("seen_t_mono_ns")
        return self.send(StopRequest(**values))

    def clear(self, facts: dict[str, Any] | None = None, **changes: Any) -> Actions:
        values = {"latch_id": self.machine.latch_id, "sighted_by": "olga", "reason": "all clear"}
        return self.send(StopClearRequest(**self.head(**{**values, **changes})), **(facts or {}))

    def go_to(self, state: ThrowState) -> None:
        """Into a state by the ordinary way."""
        way = [
            (ThrowState.DISARMED, lambda: None),
            (ThrowState.ARMED, self.arm),
            (ThrowState.ALIGNING, lambda: (self.fire(), self.beat())),
            (ThrowState.THROWING, lambda: self.tick(motion=Motion.ALIGN, aligned=True)),
            (ThrowState.COMMITTED, lambda: self.tick(motion=Motion.THROW, release_commanded=True)),
            (
                ThrowState.SETTLING,
                lambda: self.tick(motion=Motion.THROW, throw_done=True, load_gone=True),
            ),
        ]
        if state is ThrowState.STOPPED:
            self.stop(issuer="eve")
        elif state is ThrowState.FAULT:
            self.go_to(ThrowState.ALIGNING)
            self.tick(fault_reason="a hose burst")
        else:
            for reached, step in way:
                step()
                if reached is state:
                    break
        assert self.machine.state is state

    @property
    def reply(self):
        return self.actions.reply

    @property
    def kinds(self) -> list[str]:
        return [event.kind.value for event in self.actions.events]

    @property
    def outcome(self):
        return self.machine.state, self.machine.motion
