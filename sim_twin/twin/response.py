"""Velocity response of N machines' drives: valve table, dead time, second-order lag or oil spring.

The second-order lag is linear; a profile with `drives` has oil springs instead (sim_twin.twin.oil_spring).
Effects act on both (sim_twin.effects.valve_effects). Pressures are not modelled: the virtual machine models
them, so that the two simulators are independent.
"""

import math

import numpy as np

from machine.calibration import ValveCalibration, actuator_ratio
from machine.conventions import ACTIVE_COUNT, CONTROL_PERIOD_S, Array, IntArray
from machine.spec import MachineSpec
from sim_twin.effects.arrays import EffectArrays
from sim_twin.effects.valve_effects import ValveEffects
from sim_twin.lag import lag_matrices
from sim_twin.twin.oil_spring import FourDrives, OilSprings, drive_arrays, squared_reach
from sim_twin.twin.profile import TwinProfile

RATIO_POINT_COUNT = 1000
MIN_DEAD_TIME_S = 0.0
MIN_FREQUENCY_SHARE_RATIO = 0.2
"""Lower bound of random frequencies and gains, relative to their means."""


class _RatioTable:
    """|actuator_ratio| of boom and dipper by interpolation with an error of 1e-6, for speed."""

    def __init__(self, spec: MachineSpec) -> None:
        low, high = spec.position_range_rad_m
        angle = np.zeros((RATIO_POINT_COUNT, ACTIVE_COUNT))
        angle[:, 1:3] = np.linspace(low[1:3] - 0.05, high[1:3] + 0.05, RATIO_POINT_COUNT)
        value = np.abs(actuator_ratio(spec, angle))
        # Contiguous columns, which np.interp does not copy.
        self._tables = [(j, angle[:, j].copy(), value[:, j].copy()) for j in (1, 2)]

    def at(self, active_position_rad_m: Array) -> Array:
        """Actuator ratio magnitudes (N, 4) at positions (N, 4)."""
        ratio = np.ones_like(active_position_rad_m)
        for joint, angles, values in self._tables:
            ratio[:, joint] = np.interp(active_position_rad_m[:, joint], angles, values)
        return ratio


class VelocityResponse:
    """State of the four drives of N machines; one `step` per control tick."""

    def __init__(
        self,
        spec: MachineSpec,
        profile: TwinProfile,
        calibration: ValveCalibration,
        count: int,
        effects: EffectArrays | None = None,
    ) -> None:
        self._profile, self._count, self._spec = profile, count, spec
        self._dead_time_s = np.asarray(profile.dead_time_s)
        self._gain_mean = np.asarray(profile.gain_ratio)
        if profile.drives is not None:
            self._dead_time_s = np.array([d.dead_time_s for d in profile.drives])
            self._gain_mean = np.array([d.gain_ratio for d in profile.drives])
        self._springs: OilSprings | None = None
        acts = effects is not None and effects.acts_in("actuation")
        self._effects = ValveEffects(spec, effects) if effects is not None and acts else None
        self._tables = [
            (np.asarray(t.valve_ratio), np.asarray(t.actuator_speed_rad_m_per_s))
            for t in calibration.tables
        ]
        longest = self._dead_time_s + 6.0 * np.asarray(profile.spread.dead_time_sd_s)
        if self._effects is not None and self._effects.dead_time_s is not None:
            longest = longest + np.maximum(self._effects.dead_time_s, 0.0)
        self._ratio = _RatioTable(spec)
        self._depth = math.ceil(float(longest.max()) / CONTROL_PERIOD_S) + 3
        shape = (count, ACTIVE_COUNT)
        self._history = np.zeros((self._depth, *shape))
        self._columns = np.arange(count * ACTIVE_COUNT).reshape(shape)
        self._whole: IntArray = np.zeros(shape, dtype=np.int64)
        self._fraction = np.zeros(shape)
        self._gain = np.ones(shape)
        self._matrix = (np.zeros(shape), np.zeros(shape), np.zeros(shape), np.zeros(shape))
        self._velocity, self._slope = np.zeros(shape), np.zeros(shape)
        self._tick = 0

    def reset(self, normal: Array) -> None:
        """Reset to rest with new random parameters.

        Args:
            normal: standard normal numbers (N, 3, 4) for dead time, frequency and gain.
        """
        p, spread, effects = self._profile, self._profile.spread, self._effects
        dead_s = self._dead_time_s + normal[:, 0] * np.asarray(spread.dead_time_sd_s)
        if effects is not None and effects.dead_time_s is not None:
            dead_s = dead_s + effects.dead_time_s
        ticks = np.clip(dead_s, MIN_DEAD_TIME_S, None) / CONTROL_PERIOD_S
        self._whole = np.minimum(np.floor(ticks).astype(np.int64), self._depth - 2)
        self._fraction = np.clip(ticks - self._whole, 0.0, 1.0)
        frequency_share = np.maximum(
            1.0 + normal[:, 1] * np.asarray(spread.natural_frequency_sd_ratio),
            MIN_FREQUENCY_SHARE_RATIO,
        )
        self._gain = self._gain_mean * np.maximum(
            1.0 + normal[:, 2] * np.asarray(spread.gain_sd_ratio), MIN_FREQUENCY_SHARE_RATIO
        )
        if effects is not None:
            effects.reset()
        if p.drives is not None:
            self._springs = self._oil_springs(p.drives, frequency_share)
        else:
            frequency = np.asarray(p.natural_frequency_rad_per_s) * frequency_share
            damping = np.broadcast_to(np.asarray(p.damping_ratio), frequency.shape)
            if effects is not None:
                frequency = effects.frequency(frequency, damping)
            self._matrix = lag_matrices(frequency, damping, CONTROL_PERIOD_S)
        self._history[:] = 0.0
        self._velocity[:] = 0.0
        self._slope[:] = 0.0
        self._tick = 0

    def _oil_springs(self, drives: FourDrives, frequency_share: Array) -> OilSprings:
        """Drives (N, 4) at rest whose frequencies are scaled by `frequency_share`."""
        nominal = drive_arrays(drives)
        lag_s = nominal.valve_lag_s
        if self._effects is not None:
            lag_s = self._effects.valve_lag(lag_s, np.array([d.mean_lag_s for d in drives]))
        parameters = nominal._replace(
            valve_lag_s=lag_s,
            natural_frequency_rad_per_s=nominal.natural_frequency_rad_per_s * frequency_share,
        )
        return OilSprings(parameters, (self._count, ACTIVE_COUNT))

    def command(self, valve_ratio: Array) -> Array:
        """Steady actuator speed of valve commands (N, 4), m/s and rad/s for the slew."""
        out = np.empty((self._count, ACTIVE_COUNT))
        for joint, (valve, speed) in enumerate(self._tables):
            out[:, joint] = np.interp(valve_ratio[:, joint], valve, speed)
        return out

    def step(
        self, valve_ratio: Array, active_position_rad_m: Array, seen: Array | None = None
    ) -> Array:
        """Joint velocities (N, 4) at the end of a tick with valve commands `valve_ratio` (N, 4).

        A dead time between two ticks averages the two delayed commands that act in the tick. Measured
        velocities, if given (`seen`), determine when sticking joints stop and the initial state of the
        slew's backlash.
        """
        depth, tick, effects = self._depth, self._tick, self._effects
        if effects is None:
            self._history[tick % depth] = self.command(valve_ratio)
        else:
            self._history[tick % depth] = effects.on_speed(
                self.command(effects.on_command(valve_ratio))
            )
        self._tick = tick + 1
        flat = self._history.reshape(-1)
        stride = self._count * ACTIVE_COUNT
        row = ((tick - self._whole) % depth) * stride + self._columns
        newer, older = flat[row], flat.take(row - stride, mode="wrap")
        speed = newer + self._fraction * (older - newer)
        ratio = self._ratio.at(active_position_rad_m)
        target = self._gain * speed / ratio
        if effects is not None:
            target = effects.on_target(target, active_position_rad_m, ratio)
        if self._springs is not None:
            return self._step_springs(self._springs, target, active_position_rad_m, seen)
        a11, a12, a21, a22 = self._matrix
        before, error = self._velocity, self._velocity - target
        self._velocity = target + a11 * error + a12 * self._slope
        self._slope = a21 * error + a22 * self._slope
        if effects is None:
            return self._velocity
        self._velocity, self._slope = effects.on_motion(
            target, before, self._velocity, self._slope, active_position_rad_m, seen
        )
        return effects.on_joint(target, self._velocity, seen)

    def _step_springs(
        self, springs: OilSprings, target: Array, active_position_rad_m: Array, seen: Array | None
    ) -> Array:
        """`step` of drives with oil springs, from the steady joint speeds `target` (N, 4)."""
        effects, before = self._effects, springs.velocity
        velocity = springs.step(target, squared_reach(self._spec, active_position_rad_m))
        if effects is None:
            return velocity
        if effects.has_play:
            moved = effects.on_motion(
                target, before, velocity, springs.slope, active_position_rad_m, seen
            )
            springs.set_motion(*moved)
        return effects.on_joint(target, springs.velocity, seen)
