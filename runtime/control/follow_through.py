"""The moments after the release: keep the empty gripper's back swing away from the arm.

A far throw leaves the tube nearly level and the gripper swinging by a radian; half a period later it would
strike the telescope (relative pitch beyond -2.3 rad, spec.collision_shapes). Velocity requests only.
"""

from typing import NamedTuple

import numpy as np

from machine.conventions import Array, BoolArray
from machine.kinematics import pin_in_plane
from machine.spec import MachineSpec

LASTS_S = 3.0
LARGE_SWING_RAD = 0.30
"""Below this the ordinary damping does the rest; the gripper is clear of the arm there."""
LEAD_S = 0.40
"""The swing is taken this much ahead: dead time, lag, and the time an axis needs to gain speed."""
OUTWARD_M_PER_S = 0.4
"""Telescope while the load side swings out: the pin follows and takes energy out of the swing."""
FOLD_RAD_PER_S = 0.6
FOLDED_RAD = 1.0
"""Tube angle (boom + dipper) down to which the dipper folds on the way back: it makes room for the back
swing, and only then does its inward motion damp instead of driving it."""
PIN_HEIGHT_M = 2.4
"""Folding lowers the pin; the boom lifts it back to where the hanging gripper clears the ground by 1 m."""
LIFT_PER_S = 1.0
LIFT_RAD_PER_S = 0.35


class FollowThrough(NamedTuple):
    """What the arm does about the back swing."""

    request_rad_m_per_s: Array
    """(N, 4), slew 0."""
    runs: BoolArray
    """(N,) whether it still rules the arm."""


def follow_through(
    spec: MachineSpec,
    time_s: Array,
    active_position_rad_m: Array,
    swing_ahead_rad: Array,
    swing_amplitude_rad: Array,
) -> FollowThrough:
    """Out with the swing by the telescope, back with it by folding the dipper, boom against the ground.

    Args:
        spec: machine.
        time_s: (N,) since the release motion ended.
        active_position_rad_m: (N, 4).
        swing_ahead_rad: (N,) swing `LEAD_S` from now, positive outward.
        swing_amplitude_rad: (N,)
    """
    swings_out = swing_ahead_rad > 0.0
    tube = active_position_rad_m[:, 1] + active_position_rad_m[:, 2]
    height = pin_in_plane(spec, active_position_rad_m)[:, 1]
    request = np.zeros_like(active_position_rad_m)
    request[:, 1] = np.clip(LIFT_PER_S * (PIN_HEIGHT_M - height), 0.0, LIFT_RAD_PER_S)
    request[:, 2] = np.where(~swings_out & (tube > FOLDED_RAD), -FOLD_RAD_PER_S, 0.0)
    request[:, 3] = np.where(swings_out, OUTWARD_M_PER_S, 0.0)
    runs = (time_s < LASTS_S) & (swing_amplitude_rad > LARGE_SWING_RAD)
    return FollowThrough(request, runs)
