"""Inputs and outputs of replays of recorded throws."""

from typing import NamedTuple

from machine.conventions import Array, BoolArray
from sim_twin.effects.effect import Effect

FourFlags = tuple[bool, bool, bool, bool]


class ReplayInput(NamedTuple):
    """One recorded throw on the grid of control ticks; t = 0 at row 0, row k at 0.01 k seconds.

    Positions and angles are as reported by sensors and estimator; an element's sensor effects (bias,
    latency, tilt) convert them into true ones.
    """

    valve_ratio: Array
    """(T, 4) valve command during the tick that begins at row k."""
    gripper_open: BoolArray
    """(T,) opening command during the tick that begins at row k; used if `release_t_s` is NaN."""
    position_rad_m: Array
    """(T, 4) driven joints, measured and smoothed. Simulated joints start at row 0, at rest."""
    velocity_rad_m_per_s: Array
    """(T, 4) smoothed velocities of the driven joints; their differences are the accelerations."""
    swing_start_rad: Array
    """(2,) pitch and roll joint angles at row 0. At rest: plumb for the measured boom and dipper."""
    swing_rate_start_rad_per_s: Array
    """(2,)"""
    release_t_s: float = float("nan")
    """Time of the opening command."""
    surface_height_m: float = 0.0
    """Height of the surface at the impact, survey frame."""
    progress_ratio: float = 0.0
    """Position in the set of throws: 0 for the first, 1 for the last; used by drifting effects."""
    hung_at_rest: bool = True
    """Whether the gripper hung at rest before row 0: it then starts plumb, for any tilt of the base. Else the
    reported swing is taken relative to the machine's vertical."""
    opening_t_s: float = float("nan")
    """Measured release time; for elements with `measured_opening`."""
    swing_rad: Array | None = None
    """(T, 2) measured pitch and roll joint angles; for elements with `measured_swing`."""
    swing_rate_rad_per_s: Array | None = None
    """(T, 2)"""
    gyro_rad_per_s: Array | None = None
    """(T, 3) angular rate reported by the IMU, bias removed."""
    start_force_m_per_s2: Array | None = None
    """(3,) specific force reported by the IMU at row 0; None if the swing's start was not estimated from
    it."""


class ReplayElement(NamedTuple):
    """One simulation: a throw, effects in addition to the profile's, and prescribed measurements."""

    throw: int
    """Index of the input."""
    effects: tuple[Effect, ...] = ()
    measured_joints: FourFlags = (False, False, False, False)
    """Driven joints whose motion is prescribed as measured instead of simulated from valve commands."""
    measured_swing: bool = False
    """Whether the motion of both free joints is prescribed as measured."""
    measured_opening: bool = False
    """Whether the load is released at `opening_t_s`."""


class ReplayOutput(NamedTuple):
    """Simulated channels of M elements; T is the longest throw's, later ticks of shorter ones are NaN.

    Row k of every channel is the state at tick k as the sensors report it at that time.
    """

    joint_position_rad_m: Array
    """(M, T, 4)"""
    joint_velocity_rad_m_per_s: Array
    """(M, T, 4)"""
    passive_position_rad: Array
    """(M, T, 2) true pitch and roll joint angles."""
    passive_velocity_rad_per_s: Array
    """(M, T, 2)"""
    gyro_rad_per_s: Array
    """(M, T, 3) frame of the IMU."""
    accel_m_per_s2: Array
    """(M, T, 3) specific force, frame of the IMU."""
    release_t_s: Array
    """(M,) release time; NaN without a release."""
    release_position_m: Array
    """(M, 3) survey frame: frame `machine` at the surveyed pose of the base."""
    release_velocity_m_per_s: Array
    """(M, 3) velocity at the release, survey frame."""
    ball_position_m: Array
    """(M, T, 3) position in flight, survey frame; NaN otherwise."""
    impact_m: Array
    """(M, 3) survey frame; may come after the last tick."""
    impact_t_s: Array
    """(M,)"""


class Flight(NamedTuple):
    """Flights of M loads, survey frame."""

    impact_m: Array
    """(M, 3)"""
    flight_s: Array
    """(M,) from release to impact."""
    track_m: Array
    """(M, S, 3) position every 0.01 s from the release on; NaN from the impact on."""
