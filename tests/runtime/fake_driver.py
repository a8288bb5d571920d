"""A machine made of first-order lags: quick, exact, no swing; for tests around the control step."""

import numpy as np

from machine.calibration import actuator_ratio, nominal_calibration
from machine.conventions import CONTROL_PERIOD_NS
from machine.spec import load_spec
from machine.starts import safe_pose
from runtime.driver import SensorSample, ValveCommand

LAG_S = 0.08
RELEASE_DELAY_NS = 250_000_000
FLIGHT_NS = 600_000_000
IMPACT_M = (8.1, 0.4, 0.0)


class FakeDriver:
    """Implements runtime.driver.Driver for one machine."""

    def __init__(self, *, count: int = 1, unit_seed: int = 0, holds_load: str = "no") -> None:
        self.count = count
        self.unit_seed = unit_seed
        self.commands: list[ValveCommand] = []
        self.loads = 0
        self.is_closed = False
        self.imu_is_silent = False
        self.emergency_stop = False
        self.local_enable = True
        self._spec = load_spec()
        self._tables = nominal_calibration(self._spec).tables
        self._low, self._high = self._spec.position_range_rad_m
        self._now_ns = 1_000_000_000
        self._q = safe_pose()[:4].copy()
        self._v = np.zeros(4)
        self._valve = np.zeros(4)
        self._open_ns = 0
        self._left_ns = 0
        self._is_held = holds_load == "yes"

    def now_ns(self) -> int:
        return self._now_ns

    def advance(self, until_ns: int) -> None:
        while self._now_ns + CONTROL_PERIOD_NS <= until_ns:
            self._step(CONTROL_PERIOD_NS * 1e-9)
            self._now_ns += CONTROL_PERIOD_NS
        if self._is_held and self._open_ns and self._now_ns - self._open_ns >= RELEASE_DELAY_NS:
            self._is_held = False
            self._left_ns = self._now_ns

    def _step(self, dt_s: float) -> None:
        ratio = np.abs(actuator_ratio(self._spec, self._q[None]))[0]
        speed = [
            np.interp(valve, table.valve_ratio, table.actuator_speed_rad_m_per_s)
            for valve, table in zip(self._valve, self._tables, strict=True)
        ]
        self._v += (np.array(speed) / ratio - self._v) * dt_s / LAG_S
        self._q = np.clip(self._q + self._v * dt_s, self._low, self._high)

    def read(self) -> SensorSample:
        now_ns = self._now_ns
        landed_ns = self._left_ns + FLIGHT_NS
        has_landed = self._left_ns > 0 and now_ns >= landed_ns
        is_flying = self._left_ns > 0 and not has_landed
        return SensorSample(
            t_mono_ns=now_ns,
            joint_position_rad_m=self._q[None].copy(),
            joint_velocity_rad_m_per_s=self._v[None].copy(),
            imu_t_mono_ns=np.array([1_000_000_000 if self.imu_is_silent else now_ns]),
            # A living sensor never repeats itself.
            imu_gyro_rad_per_s=np.array([[1e-6 * (now_ns // 10_000_000 % 7), 0.0, self._v[0]]]),
            imu_accel_m_per_s2=np.array([[0.0, 0.0, 9.81 + 1e-6 * (now_ns // 10_000_000 % 5)]]),
            payload_held=np.array([self._is_held]),
            supply_pressure_pa=np.array([self._spec.hydraulics.supply_pressure_pa]),
            local_enable=np.array([self.local_enable]),
            emergency_stop=np.array([self.emergency_stop]),
            ball_t_mono_ns=np.array([now_ns if is_flying else 0]),
            ball_position_m=np.array([[7.0, 0.4, 1.0] if is_flying else [np.nan] * 3]),
            impact_t_mono_ns=np.array([landed_ns if has_landed else 0]),
            impact_position_m=np.array([IMPACT_M]),
            impact_sd_m=np.array([0.02]),
        )

    def write(self, command: ValveCommand) -> None:
        self._valve = command.valve_ratio[0]
        self.commands.append(command)
        del self.commands[:-500]
        if not command.gripper_open[0]:
            self._open_ns = 0
        elif self._open_ns == 0:
            self._open_ns = self._now_ns

    def load(self) -> None:
        self.loads += 1
        self._is_held = True
        self._left_ns = 0

    def close(self) -> None:
        self.is_closed = True
