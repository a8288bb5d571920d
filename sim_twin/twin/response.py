"""Velocity response of N machines' drives: valve table, dead time, second-order lag.

Linear behind the valve table, except for effects (sim_twin.effects.valve_effects). Pressures are not
modelled: the virtual machine models them, so that the two simulators are independent.
"""

import math

import numpy as np

from machine.calibration import ValveCalibration, actuator_ratio
from machine.conventions import ACTIVE_COUNT, CONTROL_PERIOD_S, Array, IntArray
from machine.spec import MachineSpec
from sim_twin.effects.arrays import EffectArrays
from sim_twin.effects.valve_effects import ValveEffects
from sim_twin.twin.profile import TwinProfile

RATIO_POINT_COUNT = 1000
MIN_DEAD_TIME_S = 0.0
MIN_FREQUENCY_SHARE_RATIO = 0.2
"""Lower bound of random frequencies and gains, relative to their means."""


def lag_matrices(
    natural_frequency_rad_per_s: Array, damping_ratio: Array, period_s: float
) -> tuple[Array, Array, Array, Array]:
    """Exact step of e'' + 2 z w e' + w^2 e = 0 in the state (e, e'/w), e = y - u with u held.

    With tau = w h and s = sqrt(z^2 - 1): exp(-z tau) [[C + z S, S], [-S, C - z S]],
    C = cosh(s tau), S = sinh(s tau) / s (tau at s = 0).

    Args:
        natural_frequency_rad_per_s: w, any shape.
        damping_ratio: z, same shape.
        period_s: h.

    Returns:
        The four elements of the matrix, each of that shape.
    """
    tau = natural_frequency_rad_per_s * period_s
    s = np.sqrt(np.asarray(damping_ratio**2 - 1.0, dtype=np.complex128))
    small = np.abs(s * tau) < 1e-6
    cosh = np.real(np.cosh(s * tau))
    sinh = np.where(small, tau, np.real(np.sinh(s * tau) / np.where(small, 1.0, s)))
    decay = np.exp(-damping_ratio * tau)
    return (
        decay * (cosh + damping_ratio * sinh),
        decay * sinh,
        -decay * sinh,
        decay * (cosh - damping_ratio * sinh),
    )


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
        self._profile, self._count = profile, count
        acts = effects is not None and effects.acts_in("actuation")
        self._effects = ValveEffects(spec, effects) if effects is not None and acts else None
        self._tables = [
            (np.asarray(t.valve_ratio), np.asarray(t.actuator_speed_rad_m_per_s))
            for t in calibration.tables
        ]
        longest = np.asarray(profile.dead_time_s) + 6.0 * np.asarray(profile.spread.dead_time_sd_s)
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
        dead_s = np.asarray(p.dead_time_s) + normal[:, 0] * np.asarray(spread.dead_time_sd_s)
        if effects is not None and effects.dead_time_s is not None:
            dead_s = dead_s + effects.dead_time_s
        ticks = np.clip(dead_s, MIN_DEAD_TIME_S, None) / CONTROL_PERIOD_S
        self._whole = np.minimum(np.floor(ticks).astype(np.int64), self._depth - 2)
        self._fraction = np.clip(ticks - self._whole, 0.0, 1.0)
        frequency = np.asarray(p.natural_frequency_rad_per_s) * np.maximum(
            1.0 + normal[:, 1] * np.asarray(spread.natural_frequency_sd_ratio),
            MIN_FREQUENCY_SHARE_RATIO,
        )
        self._gain = np.asarray(p.gain_ratio) * np.maximum(
            1.0 + normal[:, 2] * np.asarray(spread.gain_sd_ratio), MIN_FREQUENCY_SHARE_RATIO
        )
        damping = np.broadcast_to(np.asarray(p.damping_ratio), frequency.shape)
        if effects is not None:
            effects.reset()
            frequency = effects.frequency(frequency, damping)
        self._matrix = lag_matrices(frequency, damping, CONTROL_PERIOD_S)
        self._history[:] = 0.0
        self._velocity[:] = 0.0
        self._slope[:] = 0.0
        self._tick = 0

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
