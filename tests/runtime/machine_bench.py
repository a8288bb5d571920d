"""A machine under control in the test's own process: no sockets, no sleep, any number of ticks at once."""

import uuid
from pathlib import Path
from typing import Any

from machine.calibration import nominal_calibration
from machine.conventions import CONTROL_PERIOD_NS, Mode
from machine.messages import (
    ArmRequest,
    CommandReply,
    FireRequest,
    LeaseNotice,
    LoadRequest,
    OperatorHeartbeat,
    Target,
    ThrowPlan,
)
from machine.spec import load_spec
from runtime.control.policy import PolicyRunner, find_policy
from runtime.process.machine_control import MachineControl, MachineSetup, TickReport
from runtime.throw.protocol import ThrowEvent
from tests.runtime.fake_driver import FakeDriver

SPEC = load_spec()


def make(kind: type[Any], **fields: Any) -> Any:
    return kind(command_id=uuid.uuid4().hex, machine_id="m001", issuer="operator", **fields)


class Bench:
    def __init__(self, policies: Path, driver: Any = None, *, is_known: bool = True) -> None:
        self.driver = FakeDriver() if driver is None else driver
        self.runners = {mode: PolicyRunner(find_policy(policies, mode), SPEC) for mode in Mode}
        fixed = MachineSetup("m001", "boot", SPEC, nominal_calibration(SPEC), self.runners, "test")
        self.control = MachineControl(self.driver, fixed)
        if is_known:
            self.control.remember(0, (), None)
        self.reports: list[TickReport] = []
        self._start_ns = self.driver.now_ns()
        self._period = 0
        self._sequence = 0

    def tick(self, *messages: Any, skipped: int = 0) -> TickReport:
        self._period += 1 + skipped
        due_ns = self._start_ns + self._period * CONTROL_PERIOD_NS
        numbered = [(number, message) for number, message in enumerate(messages, 1)]
        report = self.control.tick(due_ns, numbered, skipped)
        self.reports.append(report)
        return report

    def ticks(self, count: int) -> None:
        for _ in range(count):
            self.tick()

    def ask(self, message: Any) -> CommandReply:
        ((_, reply),) = self.tick(message).replies
        return reply

    @property
    def events(self) -> list[ThrowEvent]:
        return [event for report in self.reports for event in report.events]

    @property
    def kinds(self) -> list[str]:
        return [event.kind.value for event in self.events]

    def plan(self, mode: Mode = Mode.PLANAR) -> ThrowPlan:
        return ThrowPlan(
            plan_id="plan",
            machine_id="m001",
            mode=mode,
            target=Target(x_m=8.0, y_m=SPEC.geometry.arm_plane_offset_m, z_m=0.5),
            policy_sha256=self.runners[mode].card.policy_sha256,
            model_sha256=SPEC.sha256,
            twin_profile_version=3,
            predicted_impact_m=(8.0, 0.0, 0.5),
            allowed_radius_m=20.0,
        )

    def seen(self) -> dict[str, int]:
        """The machine's present time, as a sender echoes it."""
        return {"seen_t_mono_ns": self.driver.now_ns()}

    def arm(self, mode: Mode = Mode.PLANAR) -> str:
        self.ticks(5)
        assert self.ask(make(LeaseNotice, epoch_count=1)).accepted
        assert self.ask(make(LoadRequest, epoch_count=1, **self.seen())).accepted
        self.ticks(12)
        reply = self.ask(make(ArmRequest, epoch_count=1, plan=self.plan(mode), **self.seen()))
        assert reply.accepted, reply.detail
        return reply.nonce

    def fire_command(self, nonce: str, throw_id: str = "t1", mode: Mode = Mode.PLANAR) -> Any:
        return make(
            FireRequest,
            epoch_count=1,
            throw_id=throw_id,
            nonce=nonce,
            plan_hash=self.plan(mode).plan_hash,
            seen_t_mono_ns=self.driver.now_ns(),
        )

    def beat(self, throw_id: str = "t1", **changes: Any) -> OperatorHeartbeat:
        self._sequence += 1
        fields = {
            "machine_id": "m001",
            "throw_id": throw_id,
            "epoch_count": 1,
            "sequence_count": self._sequence,
            "is_holding": True,
            "seen_t_mono_ns": self.driver.now_ns(),
        }
        return OperatorHeartbeat.model_validate(fields | changes)

    def hold_until(self, kind: str, throw_id: str = "t1", limit: int = 6000) -> None:
        """Heartbeats at 20 Hz until an event comes."""
        for number in range(limit):
            report = self.tick(self.beat(throw_id)) if number % 5 == 0 else self.tick()
            if any(event.kind.value == kind for event in report.events):
                return
        raise AssertionError(f"no {kind} within {limit} ticks; came: {self.kinds}")
