"""What goes into a replay of recorded throws and what comes out of it."""

from typing import NamedTuple

from machine.conventions import Array, BoolArray
from sim_twin.effects.effect import Effect

FourFlags = tuple[bool, bool, bool, bool]


class ReplayInput(NamedTuple):
    """One recorded throw on the grid of control ticks; t = 0 at row 0, row k at 0.01 k seconds.

    All positions and angles as the machine's sensors and estimator report them: a hypothesis about a
    sensor (bias, latency, tilt) turns them into true ones.
    """

    valve_ratio: Array
    """(T, 4) applied during the tick that begins at row k."""
    gripper_open: BoolArray
    """(T,) commanded during the tick that begins at row k; used where `release_t_s` is NaN."""
    position_rad_m: Array
    """(T, 4) driven joints, measured and smoothed. Row 0 is where simulated joints start, at rest."""
    velocity_rad_m_per_s: Array
    """(T, 4) of the same, smooth: its differences are the accelerations that a gripper feels."""
    swing_start_rad: Array
    """(2,) pitch and roll joint angles at row 0. At rest: plumb for the measured boom and dipper."""
    swing_rate_start_rad_per_s: Array
    """(2,)"""
    release_t_s: float = float("nan")
    """When the opening command was given."""
    surface_height_m: float = 0.0
    """Of the ground at the impact, survey frame."""
    progress_ratio: float = 0.0
    """Place in the set of throws, 0 for the first and 1 for the last; only drifts look at it."""
    hung_at_rest: bool = True
    """Whether the gripper hung at rest before row 0: then it hangs with gravity, however the base leans.
    False takes the swing's start as true against the machine's own vertical."""
    opening_t_s: float = float("nan")
    """When the load was measured to leave; for elements with `measured_opening`."""
    swing_rad: Array | None = None
    """(T, 2) measured pitch and roll joint angles; for elements with `measured_swing`."""
    swing_rate_rad_per_s: Array | None = None
    """(T, 2)"""
    gyro_rad_per_s: Array | None = None
    """(T, 3) reported by the IMU, its bias off; a swing was something else if the IMU is mounted askew."""
    start_force_m_per_s2: Array | None = None
    """(3,) specific force reported by the IMU at row 0; None where the machine did not take the swing's
    start from it."""


class ReplayElement(NamedTuple):
    """One simulation: a throw, what the machine has on top of its profile, and what is taken as measured."""

    throw: int
    """Index of the input."""
    effects: tuple[Effect, ...] = ()
    measured_joints: FourFlags = (False, False, False, False)
    """Driven joints that move as measured instead of as their valves are commanded."""
    measured_swing: bool = False
    """Both free joints move as measured."""
    measured_opening: bool = False
    """The load leaves at `opening_t_s`."""


class ReplayOutput(NamedTuple):
    """What M elements did; T is the longest throw's, later ticks of shorter ones are NaN.

    Row k of every channel is the state at tick k (the IMU too), as the sensors report it at that time.
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
    """(M,) when the load left; NaN if it did not within the throw."""
    release_position_m: Array
    """(M, 3) survey frame: frame `machine` of a machine that stands where it was surveyed."""
    release_velocity_m_per_s: Array
    """(M, 3) of the load as it leaves, survey frame."""
    ball_position_m: Array
    """(M, T, 3) in the air, survey frame; NaN otherwise."""
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
    """(M, S, 3) every 0.01 s from the release on; NaN from the impact on."""
