"""The virtual machine: simulates a real machine behind the driver interface.

MuJoCo's rigid bodies driven by pressure-level hydraulics, with sensors, gripper, flight and survey. It
shares no actuation model with the twin or the training. Measurements: docs/virtual_machine.md.
"""

from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco.batch import Batch

from machine.conventions import ACTIVE_COUNT, JOINT_COUNT, Array, BoolArray, IntArray
from machine.errors import PlantError
from machine.site.solids import Solids
from machine.site.thrown_material import ThrownMaterial
from machine.spec import load_spec
from machine.starts import safe_pose
from runtime.driver import SensorSample, ValveCommand
from sim_twin.faults.body_faults import FaultyBody
from sim_twin.faults.fault import Fault
from sim_twin.faults.machine_faults import make_faults
from sim_twin.faults.sensing_faults import FaultySensing
from sim_twin.virtual.body import (
    ACCEL,
    GRIP_POSITION,
    GRIP_RATE,
    GRIP_VELOCITY,
    GYRO,
    build_body,
)
from sim_twin.virtual.grain_flight import GrainFlight
from sim_twin.virtual.hydraulics import Hydraulics
from sim_twin.virtual.sensors import BallTracker, GripperImu, ImpactSurveyor, JointSensors
from sim_twin.virtual.thrown_load import ThrownLoad
from sim_twin.virtual.truth import GripMotion, PlantTruth
from sim_twin.virtual.units import MachineUnit, ThrowConditions, draw_conditions, make_unit

STEP_NS = 2_000_000
SENSOR_PERIOD_NS = 10_000_000
JOINT_SENSOR_PHASE_NS = 6_000_000
"""Age of joint values at a tick on the 10 ms grid: 4 ms."""
TRACKER_PERIOD_NS = 20_000_000
WATCHDOG_NS = 100_000_000
START_NS = 1_000_000_000
SWING_STICK_RAD_PER_S = 0.005
"""Rate at which the Coulomb friction of the free joints is fully developed."""
THREADS = 2
MATERIAL_GYRATION_M = 0.3
"""Radius of gyration of bulk material in the gripper: of about half a cubic metre."""


@dataclass(frozen=True, slots=True)
class Condition:
    """Faults of N machines, and time step of the simulation."""

    effects: tuple[Fault, ...] = ()
    place_ratio: Array | None = None
    """(N,) position of each copy in its set of throws, for drifting effects: 0 first, 1 last."""
    unit: MachineUnit | None = None
    """Unit to use instead of the one drawn with the unit seed."""
    step_ns: int = STEP_NS
    """A divisor of 2 ms, the sampling period of the sensors."""
    integrator: mujoco.mjtIntegrator = mujoco.mjtIntegrator.mjINT_EULER


class VirtualMachine:
    """`count` copies of machine number `unit_seed`; implements ``runtime.driver.SimulatedDriver``.

    Attributes:
        count: copies.
        target_height_m: (N,) height of the surface on which loads touch down; set it before the throw.
        wind_m_per_s: (N, 3).
    """

    def __init__(
        self,
        *,
        count: int,
        unit_seed: int,
        tracker: bool = True,
        condition: Condition | None = None,
    ) -> None:
        """Build the machines.

        Args:
            count: copies.
            unit_seed: seed of the unit; 0 is the nominal one.
            tracker: whether a camera tracks the load.
            condition: faults and time step; none if omitted.

        Raises:
            PlantError: no copies, a negative seed, or an effect that does not exist.
        """
        if count < 1 or unit_seed < 0:
            raise PlantError(
                f"a virtual machine needs count >= 1 and unit_seed >= 0, not {count} and {unit_seed}"
            )
        spec = load_spec()
        self.count = count
        self.target_height_m = np.zeros(count)
        self.wind_m_per_s = np.zeros((count, 3))
        self._unit_seed = unit_seed
        today = Condition() if condition is None else condition
        self._step_ns, step_s = today.step_ns, today.step_ns * 1e-9
        place_ratio = np.zeros(count) if today.place_ratio is None else today.place_ratio
        unit = make_unit(spec, unit_seed) if today.unit is None else today.unit
        self._faults = faults = make_faults(today.effects, place_ratio, spec, unit, step_s)
        self._unit = unit = faults.unit
        self._body = build_body(spec, unit, step_s, today.integrator, faults.body)
        front = self._body.model.nq - JOINT_COUNT
        self._batch = batch = Batch(self._body.model, count, min(THREADS, (count + 15) // 16))
        # Joints of a compliant chassis come before those of the machine.
        self._whole_position: Array = batch.bind("qpos")
        self._whole_velocity: Array = batch.bind("qvel")
        self._whole_torque: Array = batch.bind("qfrc_applied")
        self._whole_load_torque: Array = batch.bind("qfrc_bias")
        self._position = self._whole_position[:, front:]
        self._velocity = self._whole_velocity[:, front:]
        self._torque = self._whole_torque[:, front:]
        self._load_torque = self._whole_load_torque[:, front:]
        self._true_sensors: Array = batch.bind("sensordata")
        self._contact_count: IntArray = batch.bind("ncon")
        self._site_rotation: Array = batch.bind("site_xmat")
        payload = self._body.model.body("payload")
        self._payload_body = int(payload.id)
        self._ball_gyration_m2 = float(payload.inertia[0] / payload.mass[0])
        self._material_kg = np.zeros(count)
        self._material: ThrownMaterial | None = None
        self._grip_site = int(self._body.model.site("grip_centre").id)
        self._hydraulics = Hydraulics(spec, unit, count, step_s)
        self._joint_sensors = JointSensors(unit, count, step_s, faults.sensing)
        self._imu = GripperImu(unit, count, faults.sensing)
        self._tracker = BallTracker(count) if tracker else None
        self._survey = ImpactSurveyor(count)
        self._load = ThrownLoad(spec, unit, count, faults.load)
        if faults.drive is not None:
            faults.drive.fit(self._hydraulics, self._load_torque[:, :ACTIVE_COUNT])
        self._enabled = np.ones(count, dtype=np.bool_)
        self._stopped = np.zeros(count, dtype=np.bool_)
        self._collided = np.zeros(count, dtype=np.bool_)
        self._valve = np.zeros((count, ACTIVE_COUNT))
        self._supplied = np.ones(count, dtype=np.bool_)
        self._alive_count = -1
        self._closed = np.zeros((count, ACTIVE_COUNT))
        self._now_ns = self._physics_ns = self._write_ns = START_NS
        self._derived_ns = START_NS
        self._imu_phase_ns = 0
        self._rng = np.random.default_rng()
        self.reset(np.tile(safe_pose(), (count, 1)), seed=0)

    def now_ns(self) -> int:
        """Driver's clock; starts at 1 s and moves only by ``advance``."""
        return self._now_ns

    def advance(self, until_ns: int) -> None:
        """Integrate to this time, in steps of 2 ms.

        Raises:
            PlantError: the time lies in the past, or the physics left the finite numbers.
        """
        if until_ns < self._now_ns:
            raise PlantError(
                f"the virtual machine's clock stands at {self._now_ns} ns and cannot go back"
                f" to {until_ns} ns"
            )
        while self._physics_ns + self._step_ns <= until_ns:
            self._step()
        self._now_ns = until_ns
        if not np.isfinite(self._velocity).all():
            bad = np.flatnonzero(~np.isfinite(self._velocity).all(1))
            raise PlantError(f"the physics of copies {bad[:5].tolist()} diverged; reset them")

    def read(self) -> SensorSample:
        """Newest values that have arrived."""
        now_ns, count = self._now_ns, self.count
        imu_ns, gyro, accel = self._imu.newest(now_ns)
        impact_ns, impact_m, impact_sd_m = self._survey.read(now_ns)
        volume_m3, covariance_m2 = self._survey.material(now_ns)
        if self._tracker is not None:
            ball_ns, ball_m = self._tracker.newest(now_ns)
        else:
            ball_ns, ball_m = np.zeros(count, dtype=np.int64), np.full((count, 3), np.nan)
        joints = self._joint_sensors
        return SensorSample(
            t_mono_ns=joints.sample_ns,
            joint_position_rad_m=joints.position_rad_m.copy(),
            joint_velocity_rad_m_per_s=joints.velocity_rad_m_per_s.copy(),
            imu_t_mono_ns=imu_ns,
            imu_gyro_rad_per_s=gyro,
            imu_accel_m_per_s2=accel,
            payload_held=self._load.switch(now_ns),
            supply_pressure_pa=joints.supply_pressure_pa.copy(),
            local_enable=self._enabled.copy(),
            emergency_stop=self._stopped.copy(),
            ball_t_mono_ns=ball_ns,
            ball_position_m=ball_m,
            impact_t_mono_ns=impact_ns,
            impact_position_m=impact_m,
            impact_sd_m=impact_sd_m,
            impact_volume_m3=volume_m3,
            impact_covariance_m2=covariance_m2,
        )

    def write(self, command: ValveCommand) -> None:
        """Set valves and grippers; without another write within 100 ms the valves close.

        So they do where writes go on but their `alive_count` stands still. Without supply no joint moves,
        whatever its spool does.

        Raises:
            PlantError: wrong shape or not a number.
        """
        valve = np.asarray(command.valve_ratio, dtype=np.float64)
        if valve.shape != self._valve.shape or not np.isfinite(valve).all():
            raise PlantError(
                f"valve commands must be {self._valve.shape} finite ratios, got shape {valve.shape}"
            )
        opens = np.asarray(command.gripper_open, dtype=np.bool_)
        if opens.shape != (self.count,):
            raise PlantError(f"gripper commands must be ({self.count},), got shape {opens.shape}")
        np.clip(valve, -1.0, 1.0, out=self._valve)
        if command.alive_count < 0 or command.alive_count != self._alive_count:
            self._write_ns = self._now_ns
        self._alive_count = command.alive_count
        enabled = command.supply_enabled
        self._supplied[:] = True if enabled is None else np.asarray(enabled, dtype=np.bool_)
        self._load.command(opens, self._now_ns)

    def load(self) -> None:
        """Put a load into every empty gripper."""
        empty = ~self._load.held
        if empty.any():
            self._take_load(empty, self._draw_conditions(self._seed))

    def reset(self, joint_position_rad_m: Array, seed: int) -> None:
        """Restart at rest in poses (N, 6), loaded; `seed` determines all later noise."""
        pose = np.asarray(joint_position_rad_m, dtype=np.float64)
        if pose.shape != self._position.shape or not np.isfinite(pose).all():
            raise PlantError(
                f"start poses must be {self._position.shape} finite numbers, got shape {pose.shape}"
            )
        self._rng = rng = np.random.default_rng([seed, self._unit_seed, 0xD0])
        self._seed = seed
        conditions = self._draw_conditions(seed)
        self._imu_phase_ns = STEP_NS * int(rng.integers(SENSOR_PERIOD_NS // STEP_NS))
        self._batch.reset(stage=mujoco.mjtStage.mjSTAGE_NONE.value)
        self._position[:] = pose
        self._batch.forward()
        if self._faults.body is not None:
            self._faults.body.settle(self._whole_position, self._whole_load_torque)
            self._batch.forward()
        active = slice(0, ACTIVE_COUNT)
        self._hydraulics.reset(pose[:, active], self._load_torque[:, active], conditions)
        self._torque[:, active] = self._load_torque[:, active]
        if self._faults.drive is not None:
            self._faults.drive.reset(pose[:, active], seed)
        self._batch.forward()
        self._derived_ns = self._physics_ns
        self._collided = self._contact_count > 0
        self._valve[:] = 0.0
        self._supplied[:] = True
        self._write_ns = self._now_ns
        self._load.close_grippers()
        self._take_load(np.ones(self.count, dtype=np.bool_), conditions)
        self._joint_sensors.reset()
        if self._faults.sensing is not None:
            self._faults.sensing.clear()
            self._show(self._faults.sensing)
        self._sample_joints()
        self._imu.reset()
        # The radio link is up before the reset: the first read finds a sample.
        true = self._true_sensors
        self._imu.sample(self._now_ns, true[:, GYRO], true[:, ACCEL], rng, arrived=True)

    def close(self) -> None:
        """Close the valves."""
        self._valve[:] = 0.0

    def collided(self) -> BoolArray:
        """(N,) whether the gripper has touched ground, arm or machine since the reset."""
        return self._collided.copy()

    def set_local_enable(self, enabled: BoolArray | bool) -> None:
        """Turn the enable switches (N,); valves stay closed while off."""
        self._enabled[:] = enabled

    def set_emergency_stop(self, pressed: BoolArray | bool) -> None:
        """Press or release the emergency stops (N,); valves stay closed while pressed."""
        self._stopped[:] = pressed

    def set_surface_height(self, height_m: Array) -> None:
        """Height (N,) above ground of the surface on which loads touch down, from now on."""
        self.target_height_m[:] = height_m

    def set_solids(self, solids: Solids) -> None:
        """Set the objects that loads land on instead of a plane at `target_height_m`."""
        self._load.solids = solids

    def set_material(self, material: ThrownMaterial | None) -> None:
        """Bulk material in the grippers from now on; None: balls."""
        if material == self._material:
            return
        self._material = material
        rng = np.random.default_rng([self._seed, self._unit_seed, 0xB1, self._now_ns // STEP_NS])
        self._load.grains = None if material is None else GrainFlight(material, self.count, rng)
        self._weigh()

    def true_impact_m(self) -> Array:
        """True impact points (N, 3), NaN before the impact."""
        return self._load.impact_m.copy()

    def truth(self) -> PlantTruth:
        """True state."""
        load = self._load
        load.locate(self._grip_motion(), self._physics_ns)
        return PlantTruth(
            joint_position_rad_m=self._position.copy(),
            joint_velocity_rad_m_per_s=self._velocity.copy(),
            ball_position_m=load.position_m.copy(),
            ball_velocity_m_per_s=load.velocity_m_per_s.copy(),
            release_t_mono_ns=np.where(load.held, 0, load.release_ns),
            release_position_m=load.release_position_m.copy(),
            release_velocity_m_per_s=load.release_velocity_m_per_s.copy(),
            impact_t_mono_ns=load.impact_ns.copy(),
            impact_position_m=load.impact_m.copy(),
            pump_flow_m3_per_s=self._hydraulics.pump_flow_m3_per_s(),
        )

    def _draw_conditions(self, seed: int) -> ThrowConditions:
        drawn = draw_conditions(self._unit, self.count, self._rng)
        load = self._faults.load
        return drawn if load is None else load.conditions(drawn, seed)

    def _show(self, sensing: FaultySensing) -> None:
        """Pass the present state to faulty sensors."""
        true, active = self._true_sensors, slice(0, ACTIVE_COUNT)
        filtered = self._joint_sensors.filtered_rad_m_per_s
        sensing.follow(self._position[:, active], filtered, true[:, GYRO], true[:, ACCEL])

    def _take_load(self, which: BoolArray, conditions: ThrowConditions) -> None:
        self._load.take(which, conditions)
        self._weigh()
        self._survey.clear(which)
        if self._tracker is not None:
            self._tracker.clear(which)

    def _grip_motion(self) -> GripMotion:
        """State at the start of the last physics step, which MuJoCo's derived fields refer to."""
        true = self._true_sensors
        rotation = self._site_rotation[:, self._grip_site].reshape(self.count, 3, 3)
        return GripMotion(
            time_ns=self._derived_ns,
            position_m=true[:, GRIP_POSITION],
            velocity_m_per_s=true[:, GRIP_VELOCITY],
            rate_rad_per_s=true[:, GRIP_RATE],
            rotation=rotation,
        )

    def _command(self) -> Array:
        if self._physics_ns - self._write_ns >= WATCHDOG_NS:
            return self._closed
        if self._enabled.all() and not self._stopped.any():
            return self._valve
        return self._valve * (self._enabled & ~self._stopped)[:, None]

    def _step(self) -> None:
        active = slice(0, ACTIVE_COUNT)
        position, velocity = self._position[:, active], self._velocity[:, active]
        faults, command = self._faults, self._command()
        if faults.drive is not None:
            command = faults.drive.command(command, position)
        if not self._supplied.all():
            command = command * self._supplied[:, None]
        self._torque[:, active] = self._hydraulics.step(position, velocity, command)
        swing = self._velocity[:, ACTIVE_COUNT:]
        self._torque[:, ACTIVE_COUNT:] = (
            -self._body.swing_viscous * swing
            - self._body.swing_coulomb * np.tanh(swing / SWING_STICK_RAD_PER_S)
        )
        if faults.body is not None:
            self._press(faults.body)
        self._batch.step()
        self._derived_ns = self._physics_ns
        self._physics_ns += self._step_ns
        self._collided |= self._contact_count > 0
        self._joint_sensors.follow(velocity)
        if faults.sensing is not None:
            self._show(faults.sensing)
        if self._physics_ns % SENSOR_PERIOD_NS == JOINT_SENSOR_PHASE_NS:
            self._sample_joints()
        if self._derived_ns % SENSOR_PERIOD_NS == self._imu_phase_ns:
            true = self._true_sensors
            self._imu.sample(self._derived_ns, true[:, GYRO], true[:, ACCEL], self._rng)
        if self._load.grains is not None:
            self._load.leave(self._physics_ns, self._grip_motion())
            self._weigh()
        if self._load.is_due(self._physics_ns):
            self._load.release_due(self._physics_ns, self._grip_motion())
        if self._physics_ns % SENSOR_PERIOD_NS == 0 and self._load.flying.any():
            self._fly()

    def _press(self, body: FaultyBody) -> None:
        """Add torques of faults of the body."""
        swing = slice(ACTIVE_COUNT, JOINT_COUNT)
        position, velocity = self._position[:, swing], self._velocity[:, swing]
        self._torque[:, swing] += body.swing_torque(position, velocity, SWING_STICK_RAD_PER_S)
        front = body.front_count
        if front:
            self._whole_torque[:, :front] = body.front_torque(
                self._whole_position, self._whole_velocity
            )

    def _weigh(self) -> None:
        """Give the payload's body the mass that the grippers hold."""
        grains, ball_kg = self._load.grains, self._unit.ball_mass_kg
        # Without material the payload's body stays a ball, thrown or not.
        held_kg = np.zeros(self.count) if grains is None else grains.held_kg()
        if np.array_equal(held_kg, self._material_kg):
            return
        self._material_kg = held_kg
        gyration_m2 = np.where(held_kg > ball_kg, MATERIAL_GYRATION_M**2, self._ball_gyration_m2)
        mass = np.maximum(held_kg, ball_kg)
        self._batch.expand("body_mass")[:, self._payload_body] = mass
        self._batch.expand("body_inertia")[:, self._payload_body] = (mass * gyration_m2)[:, None]
        self._batch.set_const()

    def _fly(self) -> None:
        now_ns = self._physics_ns
        landed = self._load.fly(now_ns, self.target_height_m, self.wind_m_per_s)
        if landed.which.size:
            self._survey.note(landed.which, landed.time_ns, landed.point_m, self._rng)
            if landed.volume_m3 is not None and landed.covariance_m2 is not None:
                self._survey.note_material(landed.which, landed.volume_m3, landed.covariance_m2)
        if self._tracker is not None and now_ns % TRACKER_PERIOD_NS == 0:
            self._tracker.sample(now_ns, self._load.position_m, self._load.flying, self._rng)

    def _sample_joints(self) -> None:
        self._joint_sensors.sample(
            self._physics_ns,
            self._position[:, :ACTIVE_COUNT],
            self._hydraulics.rail_pa[:, 0],
            self._rng,
        )
