"""The twin: N machines in MuJoCo with velocity-response actuation and one machine's twin profile.

Implements `runtime.driver.SimulatedDriver`.
"""

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from mujoco import batch

from machine.calibration import ValveCalibration, nominal_calibration
from machine.conventions import (
    ACTIVE_COUNT,
    CONTROL_PERIOD_NS,
    CONTROL_PERIOD_S,
    JOINT_COUNT,
    Array,
    BoolArray,
    IntArray,
)
from machine.errors import PlantError, UsageError
from machine.kinematics import ToolState, grip_centre
from machine.site.solids import Solids
from machine.spec import MachineSpec, load_spec
from runtime.driver import SensorSample, ValveCommand
from sim_twin.effects.arrays import effect_arrays
from sim_twin.effects.effect import Effect
from sim_twin.rigid_body.model import model_variant, twin_model
from sim_twin.twin.noise import NOISE_TABLE_SIZE, noise_at, noise_sd
from sim_twin.twin.payload import Payload
from sim_twin.twin.profile import TwinProfile, nominal_profile
from sim_twin.twin.response import VelocityResponse
from sim_twin.twin.twin_effects import PrescribedMotion, Readings, TwinEffects

FRICTION_WIDTH_RAD_PER_S = 0.004
"""Width of the tanh that replaces the sign of a passive joint's speed; explicit steps of 10 ms are stable
from 0.0005 on. Dry friction above 0.4 rad/s2 has a larger width, for which one step stops the joint."""
START_NS = 1_000_000_000
THREADED_FROM_COUNT = 16
"""Batch size from which several threads are faster than one."""


class Twin:
    """N machines of one profile. The motion of machine i does not depend on N."""

    def __init__(
        self,
        *,
        count: int,
        profile: TwinProfile,
        calibration: ValveCalibration,
        seed: int = 0,
        thread_count: int = 2,
        effects: Sequence[Sequence[Effect]] | None = None,
        progress_ratio: Array | float = 1.0,
        sees_contacts: bool = True,
        first_row: int = 0,
    ) -> None:
        """Build the machines, loaded, in the model's zero pose; call `reset` to begin.

        Args:
            count: N.
            profile: profile of the machine.
            calibration: valve tables of the machine.
            seed: seed of the first random parameters; `reset` takes others.
            thread_count: threads of the physics.
            effects: one set per machine, in addition to the profile's.
            progress_ratio: (N,) position in a set of throws, for drifting effects; 1 is the end of the set.
            sees_contacts: detect collisions; required for `collided`.
            first_row: these are the machines from this one on of a larger twin, with its random numbers.

        Raises:
            UsageError: `count` is not positive, or the number of sets of effects differs from it.
        """
        if count < 1:
            raise UsageError(f"a twin needs at least 1 machine, not {count}")
        if effects is not None and len(effects) != count:
            raise UsageError(f"{count} machines but {len(effects)} sets of effects")
        self.count, self._first_row = count, first_row
        self.profile = profile
        self.spec: MachineSpec = load_spec()
        model, self._friction_moment = twin_model()
        threads = thread_count if count >= THREADED_FROM_COUNT else 1
        arrays = effect_arrays(count, profile.effects, effects, progress_ratio)
        sways = arrays is not None and arrays.has("chassis_compliance")
        if sways or not sees_contacts:
            model = model_variant(sees_contacts=sees_contacts, sees_momentum=sways)
        self._batch: Any = batch.Batch(model, count, threads)
        self._effects = None if arrays is None else TwinEffects(self.spec, arrays, self._batch)
        self._bind()
        self._response = VelocityResponse(self.spec, profile, calibration, count, arrays)
        self._payload = Payload(self.spec, profile, count, arrays)
        low, high = self.spec.position_range_rad_m
        self._low, self._high = low[None], high[None]
        self._now_ns = self._reset_ns = START_NS
        self._valve = np.zeros((count, ACTIVE_COUNT))
        self._collided = np.zeros(count, dtype=np.bool_)
        self._friction = np.zeros((2, count, 2))
        self._friction_width = np.full((count, 2), FRICTION_WIDTH_RAD_PER_S)
        self._prescribed: PrescribedMotion | None = None
        self._missed = np.zeros((count, ACTIVE_COUNT))
        self._noise_offset = np.zeros(count, dtype=np.int64)
        self._noise_sd = noise_sd(profile)[None]
        # Constant in all samples, and read-only.
        self._pressure = _constant(count, self.spec.hydraulics.supply_pressure_pa)
        self._survey_sd = _constant(count, profile.noise.survey_sd_m)
        self._enabled = np.ones(count, dtype=np.bool_)
        self._stopped = np.zeros(count, dtype=np.bool_)
        self._enabled.flags.writeable = self._stopped.flags.writeable = False
        self._frozen_rows: Any = None
        self._sample: SensorSample | None = None
        self.reset(np.zeros((count, JOINT_COUNT)), seed)

    @classmethod
    def for_plant(cls, *, count: int, unit_seed: int) -> "Twin":
        """The nominal twin, as ``--plant twin`` names it.

        Raises:
            UsageError: `unit_seed` is not 0; twins differ by their profiles.
        """
        if unit_seed != 0:
            raise UsageError(
                f"the twin has no unit {unit_seed}: it stands for one machine by its profile; "
                "leave --unit-seed at 0 and name the machine's --profile, or use --plant virtual"
            )
        spec = load_spec()
        return cls(
            count=count, profile=nominal_profile(spec), calibration=nominal_calibration(spec)
        )

    def _bind(self) -> None:
        self._position: Array = self._batch.bind("qpos")
        self._velocity: Array = self._batch.bind("qvel")
        self._control: Array = self._batch.bind("ctrl")
        self._applied: Array = self._batch.bind("qfrc_applied")
        self._sensors: Array = self._batch.bind("sensordata")
        self._imu = self._sensors[:, :6]
        self._contacts: Array = self._batch.bind("ncon")

    @property
    def joint_position_rad_m(self) -> Array:
        """True joint positions (N, 6), a copy."""
        return self._position.copy()

    @property
    def joint_velocity_rad_m_per_s(self) -> Array:
        """True joint velocities (N, 6), a copy."""
        return self._velocity.copy()

    @property
    def payload(self) -> Payload:
        """True state of the loads: release, flight, impact."""
        return self._payload

    def now_ns(self) -> int:
        """Simulated time."""
        return self._now_ns

    def reset(self, joint_position_rad_m: Array, seed: int) -> None:
        """Restart at rest in poses (N, 6), loaded, with random parameters from `seed`.

        The poses are as reported by the sensors; true poses differ with a biased sensor or a tilted base.

        Raises:
            PlantError: poses of the wrong shape or not finite.
        """
        pose = np.asarray(joint_position_rad_m, dtype=np.float64)
        if pose.shape != (self.count, JOINT_COUNT) or not np.isfinite(pose).all():
            raise PlantError(
                f"reset needs finite poses of shape ({self.count}, {JOINT_COUNT}), got {pose.shape}"
            )
        # The clock goes on, the noise restarts: a throw does not depend on earlier ones.
        self._reset_ns = self._now_ns
        rng = np.random.default_rng(seed)
        # Row by row, so that the numbers of machine i do not depend on N.
        first, end = self._first_row, self._first_row + self.count
        normal = rng.standard_normal((end, 3 * ACTIVE_COUNT + 5))[first:]
        self._noise_offset = np.random.default_rng((seed, 1)).integers(0, NOISE_TABLE_SIZE, end)[
            first:
        ]
        self._response.reset(normal[:, : 3 * ACTIVE_COUNT].reshape(self.count, 3, ACTIVE_COUNT))
        self._payload.reset(normal[:, 12:16])
        self._draw_friction(normal[:, 16:17])
        self._batch.reset(stage=int(mujoco.mjtStage.mjSTAGE_NONE))
        self._valve[:] = 0.0
        self._prescribed = None
        self._missed[:] = 0.0
        if self._effects is not None:
            pose = self._effects.true_pose(pose)
        self._place(pose, np.zeros_like(pose))

    def _draw_friction(self, normal: Array) -> None:
        p = self.profile
        viscous = np.asarray(p.viscous_friction_per_s)
        coulomb = np.asarray(p.coulomb_friction_rad_per_s2)
        if self._effects is not None and self._effects.body is not None:
            viscous, coulomb = self._effects.body.friction(viscous, coulomb)
        scale = np.clip(1.0 + normal * p.spread.friction_sd_ratio, 0.0, None)
        self._friction[0] = scale * viscous * self._friction_moment
        self._friction[1] = scale * coulomb * self._friction_moment
        self._friction_width[:] = np.maximum(
            scale * coulomb * CONTROL_PERIOD_S, FRICTION_WIDTH_RAD_PER_S
        )

    def start_moving(self, position_rad_m: Array, velocity_rad_m_per_s: Array) -> None:
        """Set true joint states (N, 6) after a reset, before the first tick."""
        self._place(position_rad_m, velocity_rad_m_per_s)

    def _place(self, position: Array, velocity: Array) -> None:
        self._position[:], self._velocity[:] = position, velocity
        if self._effects is not None:
            self._effects.begin(position, velocity)
        self._batch.forward()
        if self._effects is not None:
            self._effects.fill_sensors(
                self._imu, position[:, :ACTIVE_COUNT], velocity[:, :ACTIVE_COUNT]
            )
        self._collided = self._contacts > 0
        self._frozen_rows = None
        self._sample = None

    def freeze(self, frozen: BoolArray) -> None:
        """Stop simulating machines (N,) whose throw has ended; their sensors keep their last values."""
        self._frozen_rows = None if not frozen.any() else np.flatnonzero(~frozen).astype(np.int32)

    def prescribe(self, motion: PrescribedMotion | None) -> None:
        """Prescribe true joint states at the end of the next tick, independent of valve commands.

        The acceleration of a driven joint follows from the change of its velocity; its position is exactly
        the given one.
        """
        self._prescribed = motion

    def true_pose(self, reported_rad_m: Array, hangs: BoolArray | bool = True) -> Array:
        """True joint positions (N, 6) for positions reported at rest (sim_twin.twin.twin_effects)."""
        return (
            reported_rad_m
            if self._effects is None
            else self._effects.true_pose(reported_rad_m, hangs)
        )

    def sensor_latency_s(self) -> Array | None:
        """Latencies (N, 6) of the sensors of joint motion; None if all are zero."""
        return None if self._effects is None else self._effects.latency_s()

    def imu_axes(self) -> Array | None:
        """Rotations (N, 3, 3) from the IMU's axes to the gripper's; None if all are aligned."""
        return None if self._effects is None else self._effects.imu_axes()

    def advance(self, until_ns: int) -> None:
        """Step whole control ticks up to `until_ns`."""
        while self._now_ns + CONTROL_PERIOD_NS <= until_ns:
            self._tick()

    def _tick(self) -> None:
        q, v = self._position, self._velocity
        active = q[:, :ACTIVE_COUNT]
        reference = self._response.step(self._valve, active)
        room_low = (self._low - active) / CONTROL_PERIOD_S
        room_high = (self._high - active) / CONTROL_PERIOD_S
        # A cylinder at its end stop stands still for any valve command.
        reference = np.minimum(np.maximum(reference, room_low), room_high)
        given = self._prescribed
        if given is not None:
            # The small velocity change of a drive due to the load is taken from the last tick.
            wanted = given.velocity_rad_m_per_s[:, :ACTIVE_COUNT] + self._missed
            reference = np.where(given.mask[:, :ACTIVE_COUNT], wanted, reference)
        self._control[:] = reference - v[:, :ACTIVE_COUNT]
        self._push_free_joints(q, v)
        end_ns = self._now_ns + CONTROL_PERIOD_NS
        due = self._payload.due(end_ns)
        before = self._load_state(due, 0.0) if due.size else None
        self._batch.step(self._frozen_rows)
        self._now_ns = end_ns
        if np.count_nonzero(self._contacts):
            self._collided |= self._contacts > 0
        if given is not None:
            self._missed += given.velocity_rad_m_per_s[:, :ACTIVE_COUNT] - v[:, :ACTIVE_COUNT]
            self._missed[~given.mask[:, :ACTIVE_COUNT]] = 0.0
            np.copyto(q, given.position_rad_m, where=given.mask)
            np.copyto(v, given.velocity_rad_m_per_s, where=given.mask)
        if before is not None:
            after = self._load_state(due, CONTROL_PERIOD_S)
            self._payload.release(due, before, after, end_ns, CONTROL_PERIOD_S)
        self._payload.fly(end_ns, CONTROL_PERIOD_S)
        if self._effects is not None:
            self._effects.after_step(self._imu, q, v)
        self._sample = None

    def _push_free_joints(self, q: Array, v: Array) -> None:
        """Apply friction and hose moments for the next tick."""
        swing = v[:, ACTIVE_COUNT:]
        viscous, coulomb = self._friction
        self._applied[:, ACTIVE_COUNT:] = -(
            viscous * swing + coulomb * np.tanh(swing / self._friction_width)
        )
        if self._effects is not None:
            pull = self._effects.before_step(q, v, self._sensors)
            if pull is not None:
                self._applied[:, ACTIVE_COUNT:] += pull * self._friction_moment

    def _load_state(self, rows: IntArray, ahead_s: float) -> ToolState:
        """States of the held loads of `rows` at a time after the tick's begin; survey frame."""
        q, v = self._position[rows], self._velocity[rows]
        if self._effects is None:
            return grip_centre(self.spec, q, v)
        return self._effects.load_state(rows, q, v, ahead_s)

    def read(self) -> SensorSample:
        """Sensor values of the present tick; repeated reads give the same sample."""
        if self._sample is None:
            self._sample = self._measure()
        return self._sample

    def _measure(self) -> SensorSample:
        tick = (self._now_ns - self._reset_ns + START_NS) // CONTROL_PERIOD_NS
        noise = noise_at(self._noise_offset, tick) * self._noise_sd
        load, effects = self._payload, self._effects
        if effects is None:
            seen = Readings(
                self._position[:, :4], self._velocity[:, :4], self._imu[:, 0:3], self._imu[:, 3:6]
            )
        else:
            seen = effects.readings(self._imu, self._position, self._velocity)
        impact_t_ns, impact_m = load.survey()
        # MuJoCo's sensors describe the state in which the last step began.
        imu_t_ns = self._now_ns - CONTROL_PERIOD_NS
        return SensorSample(
            t_mono_ns=self._now_ns,
            joint_position_rad_m=seen.position_rad_m + noise[:, 0:4],
            joint_velocity_rad_m_per_s=seen.velocity_rad_m_per_s + noise[:, 4:8],
            imu_t_mono_ns=np.full(self.count, imu_t_ns),
            imu_gyro_rad_per_s=seen.gyro_rad_per_s + noise[:, 8:11],
            imu_accel_m_per_s2=seen.accel_m_per_s2 + noise[:, 11:14],
            payload_held=load.held.copy(),
            supply_pressure_pa=self._pressure,
            local_enable=self._enabled,
            emergency_stop=self._stopped,
            ball_t_mono_ns=load.flying * np.int64(self._now_ns),
            ball_position_m=load.position_m.copy(),
            impact_t_mono_ns=impact_t_ns,
            impact_position_m=impact_m,
            impact_sd_m=self._survey_sd,
        )

    def write(self, command: ValveCommand) -> None:
        """Set the valves from now on.

        Raises:
            PlantError: a command of the wrong shape, not finite, or beyond -1..1.
        """
        valve = command.valve_ratio
        within = np.abs(valve) <= 1.0 + 1e-9
        if valve.shape != self._valve.shape or np.count_nonzero(within) != within.size:
            raise PlantError(
                f"valve commands must be {self._valve.shape} within -1..1, got {valve.shape} "
                f"up to {np.max(np.abs(valve), initial=0.0):.3g}"
            )
        self._valve[:] = valve
        self._payload.command(command.gripper_open, self._now_ns)

    def load(self) -> None:
        """Put a load into every gripper."""
        self._payload.load()
        self._sample = None

    def collided(self) -> BoolArray:
        """(N,) whether the gripper has touched ground, arm or machine since the reset."""
        return self._collided.copy()

    def true_impact_m(self) -> Array:
        """True impact points (N, 3), NaN before the impact."""
        return self._payload.impact_m.copy()

    def predicted_impact(self) -> tuple[Array, Array]:
        """True impact points (N, 3) and flight times (N,) of released loads; NaN otherwise."""
        return self._payload.predicted_impact()

    def set_surface_height(self, height_m: Array) -> None:
        """Height (N,) of the surface on which the loads land, from the next release on."""
        self._payload.surface_height_m[:] = height_m

    def set_solids(self, solids: Solids) -> None:
        """Set the objects that loads land on, for all machines, frame `machine`."""
        self._payload.solids = solids

    def close(self) -> None:
        """Close the valves."""
        self._valve[:] = 0.0


def _constant(count: int, value: float) -> Array:
    """A read-only array (N,) with one value."""
    array = np.full(count, value)
    array.flags.writeable = False
    return array
