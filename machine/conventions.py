"""Units, frames, names and order of the joints.

Frames: ``machine`` has its origin on the slew axis at ground level, x forward at zero slew, y left, z up.
``throw`` is ``machine`` rotated about z so that x (downrange) points from the slew axis to the target and
y (crossrange) to its left. Quaternions are wxyz. Transforms are named ``T_world_machine``.
"""

from enum import IntEnum, StrEnum
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
"""Floating-point array; axes and units are in the docstring of its user."""
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]

JOINT_NAMES: Final = ("slew", "boom", "dipper", "telescope", "pitch", "roll")
"""Order along the chain. The first four are driven hydraulically, the last two swing freely."""
ACTIVE_JOINTS: Final = JOINT_NAMES[:4]
PASSIVE_JOINTS: Final = JOINT_NAMES[4:]
ACTIVE_COUNT: Final = 4
JOINT_COUNT: Final = 6

CONTROL_PERIOD_NS: Final = 10_000_000
CONTROL_PERIOD_S: Final = 0.01
POLICY_DECIMATION: Final = 8
"""Control ticks per policy step: 100 Hz / 8 = 12.5 Hz (paper, section III-E)."""
POLICY_PERIOD_S: Final = CONTROL_PERIOD_S * POLICY_DECIMATION

RELEASE_THRESHOLD_RATIO: Final = 0.9
"""The last action opens the gripper above this value (paper, section III-C)."""

DEFAULT_PACE_RATIO: Final = 0.0
"""Default pace of a throw: 0 is careful and most accurate, 1 is fast."""

GRAVITY_M_PER_S2: Final = 9.81

UNIT_SUFFIXES: Final = (
    "_rad_m_per_s3",
    "_rad_m_per_s2",
    "_rad_m_per_s",
    "_rad_m",
    "_rad_per_s2",
    "_rad_per_s",
    "_rad",
    "_per_s2",
    "_m3_per_rad",
    "_m3_per_s",
    "_m3",
    "_m2",
    "_m_per_s2",
    "_m_per_s",
    "_m",
    "_kg_m2",
    "_kg_per_m3",
    "_kg",
    "_ns",
    "_s",
    "_hz",
    "_pa",
    "_k",
    "_per_s",
    "_ratio",
    "_count",
    "_version",
    "_bytes",
)
"""Every numeric field of a message, setting, table or log channel ends with one of these.

``_rad_m`` marks arrays over joints: radians for the hinges, metres for the telescope.
"""

_CONTROL = r"\x00-\x1f\x7f-\x9f\u2028\u2029"
LINE_PATTERN: Final = rf"^[^{_CONTROL}]*$"
"""Texts that people write are one line, because they stand in tables, logs and signed files."""
FILLED_LINE_PATTERN: Final = rf"^[^{_CONTROL}]*[^\s{_CONTROL}][^{_CONTROL}]*$"
"""A line with something to read."""
NAME_PATTERN: Final = rf"^[^\s{_CONTROL}]([^{_CONTROL}]*[^\s{_CONTROL}])?$"
"""A line without spaces at its ends."""


class Mode(StrEnum):
    """How the machine throws: within the arm plane, or with the cabin turning."""

    PLANAR = "2d"
    SPATIAL = "3d"


class Motion(IntEnum):
    """Motion of the control step."""

    HOLD = 0
    """Zero velocity references."""
    ALIGN = 1
    """Turn the cabin until the arm plane contains the target (2D), then damp the swing."""
    THROW = 2
    """Follow the policy."""
    SETTLE = 3
    """After release or abort: bring arm and swing to rest, then go to the safe pose."""
    STOP = 4
    """Close the valves at once; latched above this layer."""


def wrap_angle_rad(angle_rad: Array) -> Array:
    """Wrap angles, any shape, into [-pi, pi)."""
    return (angle_rad + np.pi) % (2.0 * np.pi) - np.pi
