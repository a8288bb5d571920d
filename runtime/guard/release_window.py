"""Where a load released now would come down, by the safety gate's own arithmetic; batched, pure.

The load leaves some time after the command. Until then the driven joints go on at their present speed and the
gripper swings like a pendulum under a steady pin; then the load flies without air. On healthy throws this
meets the true landing within 1.2 m, which is what the window is for: a release into the wrong swing, a wrong
direction, a target that is not the plan's.
"""

from functools import cache
from typing import NamedTuple

import numpy as np

from machine.conventions import GRAVITY_M_PER_S2, Array, BoolArray
from machine.spec import MachineSpec

STEP_COUNT = 13
"""Steps of 20 ms until the load leaves."""
DEFAULT_RADIUS_M = 2.5
"""Allowed distance from the target where the plan names none: twice the error of this prediction."""
SPEED_LIMIT_M_PER_S = 9.0
"""Of the grip centre; healthy throws stay below 6."""
MOMENT_LIMIT_NM = 120e3
"""Overturning moment of gripper and load about the slew axis: a pendulum that falls from the horizontal pulls
with three times its weight, here 10 m out. Healthy throws reach 65 kN m, and 90 while they settle."""


class Tool(NamedTuple):
    """Grip centre in frame `machine`, (N, 3) each."""

    position_m: Array
    velocity_m_per_s: Array


class _Geometry(NamedTuple):
    boom_x: float
    boom_z: float
    boom: float
    axis_offset: float
    tube: float
    hanger: float
    gripper: float
    plane_offset: float
    pendulum_per_s2: float
    mass_kg: float
    delay_s: float
    ball_radius_m: float


@cache
def _geometry(spec: MachineSpec) -> _Geometry:
    g, p = spec.geometry, spec.passive
    arm = g.pitch_to_roll_m + p.gripper_com_m
    inertia = p.gripper_mass_kg * arm**2 + p.gripper_inertia_kg_m2[0]
    return _Geometry(
        boom_x=g.boom_pivot_m[0],
        boom_z=g.slew_frame_height_m + g.boom_pivot_m[2],
        boom=g.boom_length_m,
        axis_offset=g.telescope_axis_offset_m,
        tube=g.dipper_to_telescope_m + g.telescope_to_pin_m,
        hanger=g.pitch_to_roll_m,
        gripper=g.roll_to_grip_centre_m,
        plane_offset=g.boom_pivot_m[1],
        pendulum_per_s2=p.gripper_mass_kg * GRAVITY_M_PER_S2 * arm / inertia,
        mass_kg=p.gripper_mass_kg + p.hanger_mass_kg,
        delay_s=spec.release.delay_s,
        ball_radius_m=spec.ball.radius_m,
    )


def predicted_landing_m(
    spec: MachineSpec, position_rad_m: Array, velocity_rad_m_per_s: Array, height_m: Array
) -> Array:
    """Points (N, 2) in frame `machine` where loads released now come down; NaN where they do not.

    Args:
        spec: machine type.
        position_rad_m: (N, 6) all joints.
        velocity_rad_m_per_s: (N, 6)
        height_m: (N,) of the surface.
    """
    tool = predicted_release(spec, position_rad_m, velocity_rad_m_per_s)
    fall_m = tool.position_m[:, 2] - height_m - _geometry(spec).ball_radius_m
    up = tool.velocity_m_per_s[:, 2]
    with np.errstate(invalid="ignore"):
        time_s = (up + np.sqrt(up * up + 2.0 * GRAVITY_M_PER_S2 * fall_m)) / GRAVITY_M_PER_S2
    return tool.position_m[:, :2] + time_s[:, None] * tool.velocity_m_per_s[:, :2]


def predicted_release(
    spec: MachineSpec, position_rad_m: Array, velocity_rad_m_per_s: Array
) -> Tool:
    """Grip centres at the moment at which loads that are released now leave, for joints (N, 6)."""
    g = _geometry(spec)
    q, v = position_rad_m, velocity_rad_m_per_s
    step_s = g.delay_s / STEP_COUNT
    active = q[:, :4] + g.delay_s * v[:, :4]
    swing = q[:, 1] + q[:, 2] + q[:, 4]
    swing_rate = v[:, 1] + v[:, 2] + v[:, 4]
    roll, roll_rate = q[:, 5], v[:, 5]
    for _ in range(STEP_COUNT):
        swing_rate = swing_rate - step_s * g.pendulum_per_s2 * np.sin(swing)
        swing = swing + step_s * swing_rate
        roll_rate = roll_rate - step_s * g.pendulum_per_s2 * np.sin(roll)
        roll = roll + step_s * roll_rate
    return tool_motion(spec, active, v[:, :4], swing, swing_rate, roll, roll_rate)


def is_allowed(
    spec: MachineSpec,
    position_rad_m: Array,
    velocity_rad_m_per_s: Array,
    target_m: Array,
    radius_m: Array | float,
) -> BoolArray:
    """Whether loads (N,) released now come down within `radius_m` of their targets (N, 3)."""
    landing = predicted_landing_m(spec, position_rad_m, velocity_rad_m_per_s, target_m[:, 2])
    miss = landing - target_m[:, :2]
    return np.hypot(miss[:, 0], miss[:, 1]) <= radius_m


def tool_motion(
    spec: MachineSpec,
    active_rad_m: Array,
    speed_rad_m_per_s: Array,
    swing_rad: Array,
    swing_rate_rad_per_s: Array,
    roll_rad: Array,
    roll_rate_rad_per_s: Array,
) -> Tool:
    """Grip centre of joints (N, 4), and of a gripper at absolute swing and roll (N,).

    Complex numbers x + i z in the arm plane: each link is a length times a unit vector, and turns with it.
    """
    g = _geometry(spec)
    slew, boom, tube = (
        active_rad_m[:, 0],
        active_rad_m[:, 1],
        active_rad_m[:, 1] + active_rad_m[:, 2],
    )
    boom_rate = speed_rad_m_per_s[:, 1]
    tube_rate = boom_rate + speed_rad_m_per_s[:, 2]
    upper = g.boom * np.exp(1j * boom)
    outward = np.exp(1j * tube)
    lower = (g.axis_offset - 1j * (g.tube + active_rad_m[:, 3])) * outward
    hang = -1j * np.exp(1j * swing_rad)
    below = g.hanger + g.gripper * np.cos(roll_rad)
    point = complex(g.boom_x, g.boom_z) + upper + lower + below * hang
    motion = (
        1j * boom_rate * upper
        + 1j * tube_rate * lower
        - 1j * speed_rad_m_per_s[:, 3] * outward
        + 1j * swing_rate_rad_per_s * below * hang
        - g.gripper * np.sin(roll_rad) * roll_rate_rad_per_s * hang
    )
    across = g.plane_offset + g.gripper * np.sin(roll_rad)
    across_rate = g.gripper * np.cos(roll_rad) * roll_rate_rad_per_s
    turn = np.exp(1j * slew)
    place = (point.real + 1j * across) * turn
    pace = (motion.real + 1j * across_rate) * turn + 1j * speed_rad_m_per_s[:, 0] * place
    # Filled in place: `stack` takes ten times as long for so few numbers, every tick.
    tool = Tool(np.empty((len(slew), 3)), np.empty((len(slew), 3)))
    for out, plane, height in (
        (tool.position_m, place, point),
        (tool.velocity_m_per_s, pace, motion),
    ):
        out[:, 0], out[:, 1], out[:, 2] = plane.real, plane.imag, height.imag
    return tool


def exceeds_tool_limits(
    spec: MachineSpec, position_rad_m: Array, velocity_rad_m_per_s: Array
) -> BoolArray:
    """Whether machines (N,) move their tool too fast, or load the chassis by too high a moment."""
    speed, moment = tool_load(spec, position_rad_m, velocity_rad_m_per_s)
    return (speed > SPEED_LIMIT_M_PER_S) | (moment > MOMENT_LIMIT_NM)


def tool_load(
    spec: MachineSpec, position_rad_m: Array, velocity_rad_m_per_s: Array
) -> tuple[Array, Array]:
    """Speed (N,) of the grip centre, m/s, and moment (N,) of gripper and load about the slew axis, N m.

    Weight and the pull of the swing together: m (g + w^2 l) r. It is no tip-over protection: that is the
    machine's own load moment limiter.
    """
    g = _geometry(spec)
    q, v = position_rad_m, velocity_rad_m_per_s
    swing_rate = v[:, 1] + v[:, 2] + v[:, 4]
    tool = tool_motion(
        spec, q[:, :4], v[:, :4], q[:, 1] + q[:, 2] + q[:, 4], swing_rate, q[:, 5], v[:, 5]
    )
    speed = np.sqrt((tool.velocity_m_per_s**2).sum(axis=1))
    reach = np.hypot(tool.position_m[:, 0], tool.position_m[:, 1])
    pull = GRAVITY_M_PER_S2 + (swing_rate**2 + v[:, 5] ** 2) * (g.hanger + g.gripper)
    return speed, g.mass_kg * pull * reach
