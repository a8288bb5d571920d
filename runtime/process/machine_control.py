"""One machine under control: driver, throw protocol and control step, tick by tick; no sockets, no sleep.

The control process gives it messages and the beat; tests do the same in one process. It turns what happens
into replies, events and log rows, and keeps none of them.
"""

import secrets
from dataclasses import dataclass, field, replace
from typing import Any, Final, cast

import numpy as np
from numpy.typing import NDArray

from machine.calibration import ValveCalibration
from machine.conventions import ACTIVE_COUNT, DEFAULT_PACE_RATIO, Array, Mode
from machine.errors import DownrangeError
from machine.messages import (
    PROTOCOL_VERSION,
    CheckResult,
    CommandReply,
    EventKind,
    MachineState,
    ThrowPlan,
    ThrowState,
)
from machine.site.solids import Solids
from machine.site.zones import ZoneSet
from machine.spec import MachineSpec
from runtime.control import swing_control
from runtime.control.control_loop import (
    ControlInputs,
    ControlOutputs,
    ControlParams,
    ControlState,
    initial_state,
    step,
)
from runtime.control.imu_estimator import ImuEstimate
from runtime.control.policy import PolicyRunner
from runtime.control.policy_step import initial_throw
from runtime.driver import Driver, LandingDriver, MaterialDriver, SensorSample, ValveCommand
from runtime.guard.release_window import DEFAULT_RADIUS_M
from runtime.process.machine_zones import NO_ZONES, MachineZones
from runtime.process.policy_switch import LoadedPolicy
from runtime.throw.checks import CheckInputs, run_checks
from runtime.throw.facts import with_control
from runtime.throw.protocol import (
    RUNNING,
    WAITING,
    Actions,
    Facts,
    Latch,
    LinkLost,
    ThrowEvent,
    ThrowMachine,
    Tick,
    keep_reply,
)
from runtime.throw.states import Message, update
from runtime.throw.tracker import ThrowTracker
from runtime.throw.transitions import take_latch

CHECK_PERIOD_TICKS: Final = 10
"""Arming checks at 10 Hz, like the state message that carries them."""
STALL_LIMIT_COUNT: Final = 10
"""Periods missed at once (0.1 s blind) that end a throw before its commit point."""
_CLOSED: Final = ValveCommand(np.zeros((1, ACTIVE_COUNT)), np.zeros(1, dtype=np.bool_))


@dataclass(frozen=True, slots=True)
class MachineSetup:
    """What the machine is; constant from boot to boot, but for its policies."""

    machine_id: str
    boot_id: str
    spec: MachineSpec
    calibration: ValveCalibration
    policies: dict[Mode, PolicyRunner]
    software: str
    policy_refusals: dict[Mode, str] = field(default_factory=dict[Mode, str])
    """Why a mode has no policy."""


@dataclass(slots=True)
class HostStatus:
    """What others say about the machine's computer; shown, and looked at by the arming checks."""

    late_tick_ratio: float = 0.0
    outbox_count: int = 0
    recorder_dropped_count: int = 0


@dataclass(slots=True)
class TickReport:
    """What one tick gave."""

    replies: list[tuple[int, CommandReply]] = field(default_factory=list[tuple[int, CommandReply]])
    """(request number, answer)"""
    events: list[ThrowEvent] = field(default_factory=list[ThrowEvent])
    """In order; to be stored before the replies are sent."""
    log_begins: dict[str, Any] | None = None
    """Context of a log that starts with this tick's rows."""
    log_ends: dict[str, Any] | None = None
    """Result of the log that ends with this tick's rows."""
    rows: dict[str, NDArray[np.void]] = field(default_factory=dict[str, NDArray[np.void]])
    """(1,) rows by log channel; ``control`` always."""


class MachineControl:
    """Runs one machine; every call from one thread."""

    def __init__(self, driver: Driver, setup: MachineSetup) -> None:
        self.driver = driver
        self.setup = setup
        self.host = HostStatus()
        # Until `remember` says what earlier processes left, nobody knows whether it may move.
        self.throw = ThrowMachine(
            setup.machine_id,
            state=ThrowState.STOPPED,
            latched_reason="the machine starts; its records have not been read yet",
            latch_id=f"{setup.boot_id}.0",
            boot_id=setup.boot_id,
        )
        self._params: dict[Mode, ControlParams] = {
            mode: ControlParams(setup.spec, setup.calibration, mode, setup.policies.get(mode))
            for mode in Mode
        }
        self._mode = Mode.PLANAR
        self._now_ns = driver.now_ns()
        self._sample: SensorSample = driver.read()
        self._target_m: Array = np.full((1, 3), np.nan)
        self._aim_target_m = self._target_m
        self._pace_ratio = DEFAULT_PACE_RATIO
        self._allowed_radius_m = DEFAULT_RADIUS_M
        self._zones = MachineZones(setup.spec, None)
        self._state: ControlState = initial_state(
            self._params[self._mode], self._sample, np.zeros((1, 3)), self._now_ns
        )
        self._outputs: ControlOutputs | None = None
        self._checks: tuple[CheckResult, ...] = ()
        self._tick_count = 0
        self._fault_reason = ""
        self._stalled_ns = -1
        self._nonce = secrets.token_hex(16)
        self._tracker = ThrowTracker(setup.spec, self._sample)
        self._policy_events: list[ThrowEvent] = []

    def remember(
        self,
        epoch_count: int,
        throw_ids: tuple[str, ...],
        latch: Latch | None,
        zones: ZoneSet | None = NO_ZONES,
    ) -> None:
        """Take over what earlier processes left; without a call the machine stays STOPPED.

        Args:
            epoch_count: highest lease epoch.
            throw_ids: throws that must never run again.
            latch: the stop or fault that nobody has cleared; None where there is none.
            zones: exclusion zones; None where they cannot be read.
        """
        self._zones = MachineZones(self.setup.spec, zones)
        replies = self.throw.throw_replies
        for throw_id in throw_ids:
            reply = CommandReply(
                command_id="",
                machine_id=self.setup.machine_id,
                accepted=True,
                state=ThrowState.DISARMED,
                epoch_count=epoch_count,
                detail="Accepted before this machine's last restart.",
                throw_id=throw_id,
            )
            replies = keep_reply(replies, throw_id, reply)
        epoch = max(epoch_count, self.throw.epoch_count)
        machine = replace(self.throw, epoch_count=epoch, throw_replies=replies)
        if machine.latch_count == 0:
            # A stop that came in the meantime is newer than what the records say.
            machine = take_latch(machine, latch, self._now_ns)
        self.throw = machine

    def use_policy(self, loaded: LoadedPolicy) -> None:
        """Switch to a version, or report why not; only while no plan is armed. The next tick reports it."""
        offer, runner = loaded.offer, loaded.runner
        aboard = self.setup.policies.get(offer.mode)
        is_recheck = offer.policy_sha256 is None
        if is_recheck and (None if aboard is None else aboard.card) == (
            None if runner is None else runner.card
        ):
            return
        data: dict[str, Any] = {
            "mode": offer.mode.value,
            "policy_sha256": offer.policy_sha256,
            "slot": offer.policy_sha256,
            "deployment_count": offer.deployment_count,
            "is_rollback": offer.is_rollback,
        }
        policies = dict(self.setup.policies)
        if runner is None:
            data |= {"detail": loaded.refusal, "is_removed": is_recheck}
            self._policy_events.append(ThrowEvent(EventKind.POLICY_REFUSED, data=data))
            if is_recheck:
                del policies[offer.mode]
                self._set_policies(policies, {offer.mode: loaded.refusal})
            return
        self._set_policies({**policies, offer.mode: runner})
        data["policy_sha256"] = runner.card.policy_sha256
        self._policy_events.append(ThrowEvent(EventKind.POLICY_SWITCHED, data=data))

    def _set_policies(
        self, policies: dict[Mode, PolicyRunner], refused: dict[Mode, str] | None = None
    ) -> None:
        refusals = {**self.setup.policy_refusals, **(refused or {})}
        kept = {mode: text for mode, text in refusals.items() if mode not in policies}
        setup = self.setup = replace(self.setup, policies=policies, policy_refusals=kept)
        self._params = {
            mode: ControlParams(setup.spec, setup.calibration, mode, policies.get(mode))
            for mode in Mode
        }
        self._checks = self._run_checks()

    # One period -----------------------------------------------------------------------------------

    def tick(
        self, due_ns: int, messages: list[tuple[int, Message]], skipped_count: int = 0
    ) -> TickReport:
        """Sense, decide, step, write.

        Args:
            due_ns: driver time to bring a simulated machine to.
            messages: (request number, message); those that nobody waits for have number 0.
            skipped_count: periods missed just before.
        """
        report = TickReport(events=self._policy_events)
        self._policy_events = []
        if skipped_count >= STALL_LIMIT_COUNT:
            self._stalled_ns = self._now_ns
        self.driver.advance(due_ns)
        # In this order: a process that is held up in between sees an old sample, not one of the future.
        self._sample = self.driver.read()
        self._now_ns = now_ns = self.driver.now_ns()
        if skipped_count >= STALL_LIMIT_COUNT:
            # Nobody knows how old what came meanwhile is: also what is only armed is given back first.
            cause = f"the control loop stood still for {skipped_count * 10} ms"
            messages = [(0, LinkLost(cause)), *messages]
        facts = self._facts()
        self._fault_reason = ""
        for request, message in [*messages, (0, Tick())]:
            self._take(request, message, facts, now_ns, report)
            is_other_set = facts.zones_sha256 != self._zones.sha256
            if facts.fresh_nonce != self._nonce or is_other_set:
                facts = replace(facts, fresh_nonce=self._nonce, zones_sha256=self._zones.sha256)
        outputs = self._step(now_ns)
        self._tick_count += 1
        if outputs is not None:
            self._outputs = outputs
            self._watch(outputs, report)
        report.log_ends = self._tracker.finished(now_ns)
        return report

    def close(self) -> None:
        """Close the valves and let go of the driver."""
        self.driver.write(_CLOSED)
        self.driver.close()

    def _take(
        self, request: int, message: Message, facts: Facts, now_ns: int, report: TickReport
    ) -> None:
        before = self.throw
        self.throw, actions = update(before, message, facts, now_ns)
        self._follow(before, actions, request, report)

    def _follow(
        self, before: ThrowMachine, actions: Actions, request: int, report: TickReport
    ) -> None:
        if self.throw.nonce != before.nonce:
            self._nonce = secrets.token_hex(16)
        if self.throw.plan is not before.plan:
            self._take_plan()
        if actions.load:
            self.driver.load()
        if actions.zones is not None:
            self._zones = MachineZones(self.setup.spec, actions.zones)
            self._checks = self._run_checks()
        for event in actions.events:
            report.events.append(self._tracker.enrich(event, self._tick_count, self._now_ns))
            if event.kind is EventKind.THROW_ACCEPTED:
                report.log_begins = self.log_context()
        if actions.reply is not None:
            report.replies.append((request, actions.reply))

    def _take_plan(self) -> None:
        plan = self.throw.plan
        if plan is None:
            return
        target = plan.target
        self._target_m = np.array([[target.x_m, target.y_m, target.z_m]])
        aim = plan.aim_target
        self._aim_target_m = np.array([[aim.x_m, aim.y_m, aim.z_m]])
        self._pace_ratio = plan.pace_ratio
        self._allowed_radius_m = plan.allowed_radius_m or DEFAULT_RADIUS_M
        if isinstance(self.driver, LandingDriver):
            self.driver.set_solids(Solids.around(plan.site, target))
        if isinstance(self.driver, MaterialDriver):
            self.driver.set_material(plan.material)
        if plan.mode is not self._mode:
            self._mode = plan.mode
            self._state = replace(self._state, throw=initial_throw(plan.mode, 1))

    def _step(self, now_ns: int) -> ControlOutputs | None:
        motion = np.array([int(self.throw.motion)])
        inputs = ControlInputs(
            self._sample,
            motion,
            self._target_m,
            self._pace_ratio,
            self._allowed_radius_m,
            self._zones.prisms,
            self._aim_target_m,
        )
        try:
            self._state, outputs = step(self._params[self._mode], self._state, inputs, now_ns)
        except DownrangeError as error:
            # A policy that cannot run: the valves close now, the protocol latches it in the next tick.
            self.driver.write(_CLOSED)
            self._fault_reason = str(error)
            return None
        self.driver.write(outputs.command)
        return outputs

    def _watch(self, outputs: ControlOutputs, report: TickReport) -> None:
        row = outputs.row
        impact = self._tracker.watch(row[0], bool(outputs.load_gone[0]), self._sample)
        if impact is not None:
            report.events.append(impact)
        report.rows = self._tracker.rows(row, self._sample)
        if outputs.policy_row is not None and outputs.policy_row["t_mono_ns"][0] != 0:
            report.rows["policy"] = outputs.policy_row

    # What is true now -----------------------------------------------------------------------------

    def _facts(self) -> Facts:
        if self._tick_count % CHECK_PERIOD_TICKS == 0:
            self._checks = self._run_checks()
        sample, setup = self._sample, self.setup
        facts = Facts(
            model_sha256=setup.spec.sha256,
            cards={mode: runner.card for mode, runner in setup.policies.items()},
            calibration_sha256=setup.calibration.sha256,
            checks=self._checks,
            payload_held=bool(sample.payload_held[0]),
            local_enable=bool(sample.local_enable[0]),
            emergency_stop=bool(sample.emergency_stop[0]),
            fresh_nonce=self._nonce,
            stalled_ns=self._stalled_ns,
            zones_sha256=self._zones.sha256,
            zone_conflict=self._zone_conflict,
        )
        if self._outputs is not None:
            facts = with_control(facts, self._outputs, sample, setup.spec.limits.swing_rad)
        if not self._fault_reason:
            return facts
        return replace(facts, fault_reason=facts.fault_reason or self._fault_reason)

    def _zone_conflict(self, plan: ThrowPlan) -> str:
        pose = np.nan_to_num(self._estimate()[0])
        found = self._zones.conflict(plan, pose)
        if found or plan.aim is None:
            return found
        # The cabin turns to where the arm aims.
        aimed = plan.model_copy(update={"target": plan.aim_target})
        return self._zones.conflict(aimed, pose)

    def _run_checks(self) -> tuple[CheckResult, ...]:
        setup, sample, now_ns = self.setup, self._sample, self._now_ns
        position, velocity = self._estimate()
        imu = ImuEstimate(
            position[None, 1] + position[None, 2] + position[None, 4],
            position[None, 5],
            velocity[None, 1] + velocity[None, 2] + velocity[None, 4],
            velocity[None, 5],
            np.zeros(1),
        )
        imu_ns = int(sample.imu_t_mono_ns[0])
        return run_checks(
            CheckInputs(
                spec=setup.spec,
                cards={mode: runner.card for mode, runner in setup.policies.items()},
                calibration_machine_id=setup.calibration.machine_id,
                machine_id=setup.machine_id,
                local_enable=bool(sample.local_enable[0]),
                emergency_stop=bool(sample.emergency_stop[0]),
                payload_held=bool(sample.payload_held[0]),
                sensor_age_s=(now_ns - sample.t_mono_ns) * 1e-9,
                imu_age_s=(now_ns - imu_ns) * 1e-9 if imu_ns else float("inf"),
                joint_position_rad_m=position,
                joint_speed_rad_m_per_s=self._state.speed_rad_m_per_s[0],
                swing_amplitude_rad=float(swing_control.swing_amplitude_rad(setup.spec, imu)[0]),
                supply_pressure_pa=float(sample.supply_pressure_pa[0]),
                zone_count=self._zones.count,
                arm_zone=self._zones.arm_entry(position),
                late_tick_ratio=self.host.late_tick_ratio,
                outbox_count=self.host.outbox_count,
                recorder_dropped_count=self.host.recorder_dropped_count,
                policy_refusals=setup.policy_refusals,
            )
        )

    def _estimate(self) -> tuple[Array, Array]:
        """Joint positions and velocities (6,); before the first step plumb and at rest."""
        if self._outputs is not None:
            row = self._outputs.row[0]
            return row["joint_position_rad_m"], row["joint_velocity_rad_m_per_s"]
        active = self._sample.joint_position_rad_m[0]
        return np.array([*active, -(active[1] + active[2]), 0.0]), np.zeros(6)

    @property
    def is_waiting(self) -> bool:
        """No throw is running and no log is open."""
        return self.throw.state not in RUNNING and self._tracker.throw_id is None

    @property
    def log_throw_id(self) -> str | None:
        """The throw whose log is open."""
        return self._tracker.throw_id

    def log_context(self) -> dict[str, Any]:
        """What a log needs besides its rows, to be diagnosed alone."""
        plan, setup = self.throw.plan, self.setup
        context: dict[str, Any] = {
            "throw_id": self.throw.throw_id,
            "machine_id": setup.machine_id,
            "boot_id": setup.boot_id,
            "software": setup.software,
            "model_sha256": setup.spec.sha256,
            "calibration": setup.calibration.model_dump(mode="json"),
            "spec": setup.spec.model_dump(mode="json"),
        }
        if plan is not None:
            agreed = plan.model_dump(mode="json")
            named = ("mode", "target", "pace_ratio", "policy_sha256", "twin_profile_version")
            context |= {name: agreed[name] for name in named}
            context |= {"plan": agreed, "plan_hash": plan.plan_hash}
        return context

    def machine_state(self) -> MachineState:
        """The state message, as far as this process knows it."""
        throw, setup = self.throw, self.setup
        position = tuple(float(value) for value in np.nan_to_num(self._estimate()[0]))
        has_beat = throw.heartbeat_ns and throw.state not in WAITING
        return MachineState(
            machine_id=setup.machine_id,
            boot_id=setup.boot_id,
            t_mono_ns=self._now_ns,
            state=throw.state,
            mode=None if throw.plan is None else throw.plan.mode,
            epoch_count=throw.epoch_count,
            plan_id=None if throw.plan is None else throw.plan.plan_id,
            throw_id=throw.throw_id,
            joint_position_rad_m=cast("tuple[float, float, float, float, float, float]", position),
            payload_held=bool(self._sample.payload_held[0]),
            stop_latched=throw.state is ThrowState.STOPPED,
            latch_id=throw.latch_id,
            latched_reason=throw.latched_reason,
            protocol_version=PROTOCOL_VERSION,
            fault=throw.latched_reason if throw.state is ThrowState.FAULT else "",
            checks=self._checks,
            model_sha256=setup.spec.sha256,
            policy_sha256={
                mode.value: runner.card.policy_sha256 for mode, runner in setup.policies.items()
            },
            calibration_sha256=setup.calibration.sha256,
            zones_sha256=self._zones.sha256,
            heartbeat_age_s=(self._now_ns - throw.heartbeat_ns) * 1e-9 if has_beat else None,
            late_tick_ratio=self.host.late_tick_ratio,
            software=setup.software,
        )
