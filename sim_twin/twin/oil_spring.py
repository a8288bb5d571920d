"""A joint's drive as an inertia on an oil spring, for arrays of drives of any shape.

The valve gives an oil flow, delayed by a first-order lag. The flow v (as a joint speed) and the joint's speed
y load the oil with a deflection x; its torque, the joint's friction and the gripper, which swings by s times
the reach, move the inertia J of the arm:

    x' = v - y
    y' = clip(w^2 x + 2 z_o w (v - y), +-a) - 2 z_f w y + m n^2 s
    s'' = -y' - n^2 s

where the pump feeds p in place of v, p^2 = v^2 (1 - (p - y) w^2 / b), while oil drives the joint: its
pressure follows the load's with a lag, so that the joint's acceleration rises by no more than b a second.

Here w^2 = K/J, with the oil's damping ratio z_o, the friction's z_f, a relief valve that opens at the
acceleration a, the swing's frequency n and the ratio m of the inertia that swings to J. Stiffness, dampers
and relief valve are constant, so w and both damping ratios go with 1/sqrt(J), a with 1/J. Inertias grow with
the square of the reach r: J/J_ref = 1 + c ((r/r_ref)^2 - 1), m J with (r/r_ref)^2.

With no valve lag, z_o = 0, c = 0 and no limit this is the linear response of `sim_twin.twin.response`.
"""

import math
from typing import NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from machine.conventions import CONTROL_PERIOD_S, Array
from machine.kinematics import pin_in_plane
from machine.spec import MachineSpec
from sim_twin.lag import first_order, lag_matrices

REFERENCE_RAD_M = (0.0, 0.8, 0.0, 0.5)
"""Positions of the driven joints for which a drive's parameters hold."""
LEAST_INERTIA_RATIO = 0.1
"""Lower bound of J/J_ref."""
SWING_RAD_PER_S = 3.5
"""n: small swings of the drawn gripper about its roll axis (machine/spec.json: 380 kg, 0.64 m, 41 kg m2)."""
_HALF_COS = math.cos(0.5 * SWING_RAD_PER_S * CONTROL_PERIOD_S)
_HALF_SIN = math.sin(0.5 * SWING_RAD_PER_S * CONTROL_PERIOD_S)


class OilSpringDrive(BaseModel):
    """Drive of one joint, at the reference position."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    dead_time_s: float = Field(ge=0.0, le=1.0)
    valve_lag_s: float = Field(ge=0.0, le=2.0)
    natural_frequency_rad_per_s: float = Field(gt=0.0)
    """w, of arm and load on the oil."""
    oil_damping_ratio: float = Field(ge=0.0)
    """z_o, between oil and joint."""
    friction_damping_ratio: float = Field(ge=0.0)
    """z_f, between joint and ground."""
    reach_inertia_ratio: float = Field(default=0.0, ge=0.0, le=1.0)
    """c: share of the inertia that grows with the square of the reach."""
    swing_inertia_ratio: float = Field(default=0.0, ge=0.0, le=2.0)
    """m: inertia of the swinging gripper over J."""
    acceleration_limit_rad_m_per_s2: float | None = Field(default=None, gt=0.0)
    """a, rad/s2 (telescope m/s2); None: the relief valve does not open."""
    jerk_limit_rad_m_per_s3: float | None = Field(default=None, gt=0.0)
    """b, rad/s3 (telescope m/s3); None: the pump's pressure follows at once."""
    gain_ratio: float = Field(default=1.0, gt=0.0)
    """Steady speed over that of the valve tables."""

    @property
    def mean_lag_s(self) -> float:
        """Mean lag behind the dead time, s."""
        slow = 2.0 * self.friction_damping_ratio / self.natural_frequency_rad_per_s
        return self.valve_lag_s + slow


FourDrives = tuple[OilSpringDrive, OilSpringDrive, OilSpringDrive, OilSpringDrive]


class DriveArrays(NamedTuple):
    """Parameters of drives, arrays that broadcast to one shape; units as in `OilSpringDrive`."""

    valve_lag_s: Array
    natural_frequency_rad_per_s: Array
    oil_damping_ratio: Array
    friction_damping_ratio: Array
    reach_inertia_ratio: Array
    swing_inertia_ratio: Array
    acceleration_limit_rad_m_per_s2: Array
    """Infinite where there is none."""
    jerk_limit_rad_m_per_s3: Array
    """Infinite where there is none."""


def drive_arrays(drives: FourDrives) -> DriveArrays:
    """Parameters (4,) of a machine's drives."""

    def limits(values: list[float | None]) -> Array:
        return np.array([np.inf if value is None else value for value in values])

    return DriveArrays(
        np.array([d.valve_lag_s for d in drives]),
        np.array([d.natural_frequency_rad_per_s for d in drives]),
        np.array([d.oil_damping_ratio for d in drives]),
        np.array([d.friction_damping_ratio for d in drives]),
        np.array([d.reach_inertia_ratio for d in drives]),
        np.array([d.swing_inertia_ratio for d in drives]),
        limits([d.acceleration_limit_rad_m_per_s2 for d in drives]),
        limits([d.jerk_limit_rad_m_per_s3 for d in drives]),
    )


def squared_reach(spec: MachineSpec, active_position_rad_m: Array) -> Array:
    """Squared distance (..., 4) from each joint's axis to the tool pin over that at the reference position.

    The slew's distance is horizontal; the telescope's does not matter and is 1.
    """
    return _squared_m2(spec, active_position_rad_m) / _squared_m2(spec, np.array(REFERENCE_RAD_M))


def _squared_m2(spec: MachineSpec, active: Array) -> Array:
    g = spec.geometry
    pin = pin_in_plane(spec, active)
    tube_m = g.dipper_to_telescope_m + g.telescope_to_pin_m + active[..., 3]
    from_boom = pin - np.array([g.boom_pivot_m[0], g.boom_pivot_m[2] + g.slew_frame_height_m])
    return np.stack(
        [
            pin[..., 0] ** 2,
            (from_boom**2).sum(axis=-1),
            g.telescope_axis_offset_m**2 + tube_m**2,
            np.ones_like(tube_m),
        ],
        axis=-1,
    )


class OilSprings:
    """State of drives; one `step` per control tick. All arrays broadcast to `shape`."""

    def __init__(self, parameters: DriveArrays, shape: tuple[int, ...]) -> None:
        """Drives at rest with the oil relaxed."""
        self.parameters = parameters
        self._decay, self._mean = first_order(parameters.valve_lag_s)
        self._lacks_pressure = bool(np.isfinite(parameters.jerk_limit_rad_m_per_s3).any())
        self._is_limited = bool(np.isfinite(parameters.acceleration_limit_rad_m_per_s2).any())
        self._varies = bool((parameters.reach_inertia_ratio > 0.0).any())
        self._swings = bool((parameters.swing_inertia_ratio > 0.0).any())
        self._set_inertia(np.ones(shape))
        self._pull = np.zeros(shape)
        self._swing, self._swing_rate = np.zeros(shape), np.zeros(shape)
        self._flow = np.zeros(shape)
        self._deflection = np.zeros(shape)
        self.velocity = np.zeros(shape)
        """Of the joints, rad/s and m/s."""

    def _set_inertia(self, inertia_ratio: Array) -> None:
        """Parameters at J/J_ref."""
        p = self.parameters
        self._inertia = inertia_ratio
        root = np.sqrt(inertia_ratio)
        self._frequency = p.natural_frequency_rad_per_s / root
        self._friction = p.friction_damping_ratio / root
        self._oil = p.oil_damping_ratio / root
        self._limit = p.acceleration_limit_rad_m_per_s2 / inertia_ratio
        self._matrix = lag_matrices(self._frequency, self._friction + self._oil, CONTROL_PERIOD_S)

    @property
    def slope(self) -> Array:
        """Acceleration over the frequency that oil and friction give a joint that moves with its flow."""
        return self._frequency * self._deflection - 2.0 * self._friction * self.velocity

    def set_motion(self, velocity: Array, slope: Array) -> None:
        """Continue from another velocity and slope."""
        self.velocity = velocity
        self._deflection = (slope + 2.0 * self._friction * velocity) / self._frequency

    def step(self, target: Array, squared_reach_ratio: Array) -> Array:
        """Joint speeds at the end of a tick.

        The linear part is exact for a flow that is constant over the tick, at its mean.

        Args:
            target: steady joint speeds that the valves ask for, rad/s and m/s.
            squared_reach_ratio: (r/r_ref)^2.
        """
        h, p = CONTROL_PERIOD_S, self.parameters
        if self._varies:
            inertia = 1.0 + p.reach_inertia_ratio * (squared_reach_ratio - 1.0)
            self._set_inertia(np.maximum(inertia, LEAST_INERTIA_RATIO))
        behind = self._flow - target
        flow = target + self._mean * behind
        self._flow = target + self._decay * behind
        w, friction = self._frequency, 2.0 * self._friction
        if self._lacks_pressure:
            flow = self._fed(flow)
        a11, a12, _, a22 = self._matrix
        if self._swings:
            share = p.swing_inertia_ratio * squared_reach_ratio / self._inertia
            self._pull = share * SWING_RAD_PER_S**2 * self._swing
        # With x = w (deflection - rest) and e = y - flow: x' = -w e, e' = w x - 2 z w e.
        rest = friction * flow - self._pull / w
        x, e = w * self._deflection - rest, self.velocity - flow
        before, oil = self.velocity, self._deflection
        self.velocity = flow + a12 * x + a22 * e
        self._deflection = (a11 * x - a12 * e + rest) / w
        if self._is_limited:
            self._relieve(before, oil, flow, h)
        if self._swings:
            self._swing_on(self.velocity - before)
        return self.velocity

    def _swing_on(self, change: Array) -> None:
        """Swing over a tick whose end has another joint speed: exact for an impulse in its middle."""
        c, s = _HALF_COS, _HALF_SIN
        for push in (-change, 0.0):
            swing, rate = self._swing, self._swing_rate
            self._swing = c * swing + s / SWING_RAD_PER_S * rate
            self._swing_rate = c * rate - s * SWING_RAD_PER_S * swing + push

    def _fed(self, flow: Array) -> Array:
        """The part of a flow that the pump has pressure for: what drives a joint rises at a limited rate."""
        rate = self.parameters.jerk_limit_rad_m_per_s3 / self._inertia / self._frequency**2
        side, asked = np.sign(flow), np.abs(flow)
        speed = side * self.velocity
        # The valve's flow goes with the root of the pressure drop, which falls as the load's pressure rises:
        # fed^2 = asked^2 (1 - (fed - speed) / rate).
        half = 0.5 * asked**2 / rate
        fed = np.sqrt(half**2 + asked**2 * np.maximum(1.0 + speed / rate, 0.0)) - half
        drives = (side * self._deflection >= 0.0) & (asked > speed)
        return np.where(drives, side * fed, flow)

    def _relieve(self, before: Array, oil: Array, flow: Array, h: float) -> None:
        """Where the relief valve opens within the tick: constant torque, and the oil stays as it is."""
        w, limit = self._frequency, self._limit
        drag = 2.0 * self._friction * w
        pushed = (self.velocity - before) / h + 0.5 * drag * (self.velocity + before) - self._pull
        opens = np.abs(pushed) > limit
        if not opens.any():
            return
        push = np.sign(pushed) * limit
        free = before + h * (push + self._pull - 0.5 * drag * before)
        held = free / (1.0 + 0.5 * drag * h)
        rate = flow - 0.5 * (held + before)
        kept = np.where(rate * push > 0.0, oil, oil + h * rate)
        most = limit / w**2
        self.velocity = np.where(opens, held, self.velocity)
        self._deflection = np.where(opens, np.clip(kept, -most, most), self._deflection)
