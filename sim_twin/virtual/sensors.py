"""Sensors of the virtual machine: joint sensors, wireless gripper IMU, ball tracker, impact survey; batched.

They model noise, bias, quantisation, filtering, delay and loss of samples.
"""

from typing import Protocol

import numpy as np

from machine.conventions import Array, BoolArray, IntArray
from sim_twin.virtual.units import MachineUnit

NEVER_NS = np.iinfo(np.int64).max

POSITION_SD_RAD_M = np.array([1.2e-3, 1.0e-3, 1.0e-3, 1.2e-3])
"""White noise of the joint sensors (assumed, 1-2 mrad and mm)."""
POSITION_STEP_RAD_M = np.array([3.83e-4, 3.83e-4, 3.83e-4, 5.0e-4])
"""14-bit encoders; 0.5 mm draw wire at the telescope."""
VELOCITY_SD_RAD_M_PER_S = np.array([6.0e-3, 7.0e-3, 8.0e-3, 7.0e-3])
"""White noise of filtered velocities."""
VELOCITY_FILTER_S = 0.008
PRESSURE_SD_PA = 1.0e5

IMU_BAND_HZ = 50.0
GYRO_SD_RAD_PER_S = np.deg2rad(5.0e-3) * np.sqrt(IMU_BAND_HZ)
"""ASM330LHH: 5 mdps/sqrt(Hz) over the band."""
ACCEL_SD_M_PER_S2 = 60e-6 * 9.81 * np.sqrt(IMU_BAND_HZ)
"""ASM330LHH: 60 ug/sqrt(Hz) over the band."""
IMU_LATENCY_S = (0.015, 0.030)
IMU_LOSS_RATIO = 0.005

TRACKER_SD_M = 0.02
TRACKER_LATENCY_S = (0.030, 0.050)
SURVEY_SD_M = 0.02
SURVEY_DELAY_S = 0.5


class SensingFaults(Protocol):
    """Faults of joint sensors and IMU (sim_twin.faults.sensing_faults)."""

    bias_rad_m: Array

    def joints(self) -> tuple[Array, Array]:
        """Positions and filtered velocities (N, 4) at the joint sensors."""
        ...

    def imu(self) -> tuple[Array, Array]:
        """Angular rates and specific forces (N, 3) at the IMU."""
        ...


class DelayedSamples:
    """Samples in transit from N sensors: each arrives late or is lost; readers get the newest arrived one."""

    def __init__(self, count: int, width: int, depth: int) -> None:
        self._sample_ns = np.zeros((depth, count), dtype=np.int64)
        self._arrival_ns = np.full((depth, count), NEVER_NS, dtype=np.int64)
        self._values = np.full((depth, count, width), np.nan)
        self._rows = np.arange(count)
        self._head = np.zeros(count, dtype=np.int64)

    def clear(self, which: BoolArray | slice = slice(None)) -> None:
        """Discard all samples of these sensors."""
        self._sample_ns[:, which] = 0
        self._arrival_ns[:, which] = NEVER_NS
        self._values[:, which] = np.nan

    def push(self, sample_ns: int, arrival_ns: IntArray, values: Array) -> None:
        """Send values (N, width) sampled at one time, with arrival times (N,); NEVER_NS: lost."""
        sent = np.flatnonzero(arrival_ns != NEVER_NS)
        self._head[sent] = (self._head[sent] + 1) % self._sample_ns.shape[0]
        row = self._head[sent]
        self._sample_ns[row, sent] = sample_ns
        self._arrival_ns[row, sent] = arrival_ns[sent]
        self._values[row, sent] = values[sent]

    def newest(self, now_ns: int) -> tuple[IntArray, Array]:
        """Sample times (N,) and values (N, width) of the newest arrived samples; 0 and NaN: none."""
        arrived_ns = np.where(self._arrival_ns <= now_ns, self._sample_ns, 0)
        row = arrived_ns.argmax(0)
        time_ns = arrived_ns[row, self._rows]
        values = self._values[row, self._rows]
        values[time_ns == 0] = np.nan
        return time_ns, values


class JointSensors:
    """Encoders of slew, boom and dipper, draw-wire sensor of the telescope, rail pressure sensor."""

    def __init__(
        self, unit: MachineUnit, count: int, step_s: float, faults: SensingFaults | None = None
    ) -> None:
        self._faults = faults
        self._bias = np.asarray(unit.joint_bias_rad_m)
        if faults is not None:
            self._bias = self._bias + faults.bias_rad_m
        self._share = 1.0 - np.exp(-step_s / VELOCITY_FILTER_S)
        self.filtered_rad_m_per_s = np.zeros((count, 4))
        """Filtered true velocities."""
        self._change = np.zeros((count, 4))
        self.sample_ns = 0
        self.position_rad_m = np.zeros((count, 4))
        self.velocity_rad_m_per_s = np.zeros((count, 4))
        self.supply_pressure_pa = np.zeros(count)

    def reset(self) -> None:
        """Reset the filters to standstill."""
        self.filtered_rad_m_per_s[:] = 0.0

    def follow(self, velocity_rad_m_per_s: Array) -> None:
        """Advance the velocity filters by one physics step with true velocities (N, 4)."""
        filtered = self.filtered_rad_m_per_s
        np.subtract(velocity_rad_m_per_s, filtered, out=self._change)
        np.multiply(self._change, self._share, out=self._change)
        np.add(filtered, self._change, out=filtered)

    def sample(
        self, now_ns: int, position_rad_m: Array, rail_pa: Array, rng: np.random.Generator
    ) -> None:
        """Take a sample: true active positions (N, 4), rail pressure (N,)."""
        shape = position_rad_m.shape
        velocity = self.filtered_rad_m_per_s
        if self._faults is not None:
            position_rad_m, velocity = self._faults.joints()
        noise = rng.standard_normal((2, *shape))
        seen = position_rad_m + self._bias + POSITION_SD_RAD_M * noise[0]
        self.position_rad_m = np.rint(seen / POSITION_STEP_RAD_M) * POSITION_STEP_RAD_M
        self.velocity_rad_m_per_s = velocity + VELOCITY_SD_RAD_M_PER_S * noise[1]
        self.supply_pressure_pa = rail_pa + PRESSURE_SD_PA * rng.standard_normal(shape[0])
        self.sample_ns = now_ns


class GripperImu:
    """Six-axis IMU on the gripper with a radio link: samples are delayed and sometimes lost."""

    def __init__(self, unit: MachineUnit, count: int, faults: SensingFaults | None = None) -> None:
        self._count, self._faults = count, faults
        x, y, z = unit.imu_misalignment_rad
        # Small mounting rotation: measured = R^T true.
        self._mounting = np.eye(3) - np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        self._gyro_bias = np.asarray(unit.gyro_bias_rad_per_s)
        self._accel_bias = np.asarray(unit.accel_bias_m_per_s2)
        self._samples = DelayedSamples(count, 6, depth=6)

    def reset(self) -> None:
        """Discard all samples."""
        self._samples.clear()

    def sample(
        self,
        sample_ns: int,
        gyro: Array,
        specific_force: Array,
        rng: np.random.Generator,
        *,
        arrived: bool = False,
    ) -> None:
        """Send true rates (N, 3), rad/s, and specific forces (N, 3), m/s2, gripper frame.

        With `arrived` they arrive without delay.
        """
        if self._faults is not None:
            gyro, specific_force = self._faults.imu()
        noise = rng.standard_normal((2, self._count, 3))
        sent = np.empty((self._count, 6))
        sent[:, :3] = gyro @ self._mounting.T + self._gyro_bias + GYRO_SD_RAD_PER_S * noise[0]
        sent[:, 3:] = specific_force @ self._mounting.T + self._accel_bias
        sent[:, 3:] += ACCEL_SD_M_PER_S2 * noise[1]
        chance = rng.random((2, self._count))
        low, high = IMU_LATENCY_S
        arrival_ns = sample_ns + ((low + (high - low) * chance[0]) * 1e9).astype(np.int64)
        arrival_ns[chance[1] < IMU_LOSS_RATIO] = NEVER_NS
        if arrived:
            arrival_ns[:] = sample_ns
        self._samples.push(sample_ns, arrival_ns, sent)

    def newest(self, now_ns: int) -> tuple[IntArray, Array, Array]:
        """Sample times (N,), gyro (N, 3), accelerometer (N, 3)."""
        time_ns, values = self._samples.newest(now_ns)
        return time_ns, values[:, :3], values[:, 3:]


class BallTracker:
    """Camera beside the machine that tracks the load in flight."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._samples = DelayedSamples(count, 3, depth=6)

    def clear(self, which: BoolArray | slice = slice(None)) -> None:
        """Discard samples of machines whose load is in the gripper again."""
        self._samples.clear(which)

    def sample(
        self, now_ns: int, ball_m: Array, visible: BoolArray, rng: np.random.Generator
    ) -> None:
        """Send positions (N, 3) of the loads that are visible (N,)."""
        noise = rng.standard_normal((self._count, 3))
        low, high = TRACKER_LATENCY_S
        late_s = rng.uniform(low, high, self._count)
        arrival_ns = np.where(visible, now_ns + (late_s * 1e9).astype(np.int64), NEVER_NS)
        self._samples.push(now_ns, arrival_ns, ball_m + TRACKER_SD_M * noise)

    def newest(self, now_ns: int) -> tuple[IntArray, Array]:
        """Sample times (N,), positions (N, 3)."""
        return self._samples.newest(now_ns)


class ImpactSurveyor:
    """Survey of impacts."""

    def __init__(self, count: int) -> None:
        self._time_ns = np.zeros(count, dtype=np.int64)
        self._point_m = np.full((count, 3), np.nan)
        self._volume_m3 = np.full(count, np.nan)
        self._covariance_m2 = np.full((count, 3), np.nan)

    def clear(self, which: BoolArray | slice = slice(None)) -> None:
        """Discard the impacts of machines with a new load."""
        self._time_ns[which] = 0
        for values in (self._point_m, self._volume_m3, self._covariance_m2):
            values[which] = np.nan

    def note(
        self, which: IntArray, impact_ns: IntArray, impact_m: Array, rng: np.random.Generator
    ) -> None:
        """Survey true impacts (M,), (M, 3) of the machines `which` (M,)."""
        self._time_ns[which] = impact_ns
        error = SURVEY_SD_M * rng.standard_normal((which.size, 3))
        error[:, 2] = 0.0
        self._point_m[which] = impact_m + error

    def note_material(self, which: IntArray, volume_m3: Array, covariance_m2: Array) -> None:
        """Note how the material of machines `which` (M,) lies: volumes (M,), xx, xy, yy (M, 3)."""
        self._volume_m3[which], self._covariance_m2[which] = volume_m3, covariance_m2

    def material(self, now_ns: int) -> tuple[Array, Array]:
        """Volumes (N,) and covariances (N, 3) of material; NaN: none yet, or a ball."""
        known = self._is_known(now_ns)
        volume = np.where(known, self._volume_m3, np.nan)
        return volume, np.where(known[:, None], self._covariance_m2, np.nan)

    def read(self, now_ns: int) -> tuple[IntArray, Array, Array]:
        """Times of impact (N,), points (N, 3) and standard deviations (N,); 0 and NaN: none yet."""
        known = self._is_known(now_ns)
        point = np.where(known[:, None], self._point_m, np.nan)
        return np.where(known, self._time_ns, 0), point, np.where(known, SURVEY_SD_M, np.nan)

    def _is_known(self, now_ns: int) -> BoolArray:
        return (self._time_ns > 0) & (self._time_ns + int(SURVEY_DELAY_S * 1e9) <= now_ns)
