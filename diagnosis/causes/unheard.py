"""Columns of the shapes of unheard-of effects (shapes.py).

Those of drives are slopes of the library times something measured; a sensor's scale has slopes of its own.
"""

import numpy as np

from diagnosis.causes.linear import Linear
from diagnosis.causes.nuisances import flight_shift
from diagnosis.causes.parameters import index_of, joint_index
from diagnosis.causes.shapes import (
    PLACE_WAVES,
    PLAY_POWERS,
    WAY_POWERS,
    group_of,
    unheard_groups,
    unheard_names,
)
from diagnosis.loading.prepared import Block, PreparedThrow
from machine.conventions import ACTIVE_COUNT, ACTIVE_JOINTS, CONTROL_PERIOD_S, Array
from machine.spec import load_spec
from sim_twin.twin.grip_point import gripper_axes

DIRECTIONS = ("positive", "negative")
WAY_RAD_M = 0.12
"""Bumps on the way are about this wide: half of what a joint at speed passes in 0.6 s (by eye)."""


def unheard_columns(prepared: PreparedThrow, at_none: Linear) -> Array:
    """Columns (n, u) of a throw in the order of `unheard_names`.

    Args:
        prepared: the throw.
        at_none: linearised without any effect.
    """
    out = np.zeros((at_none.residual.size, len(unheard_names())))
    for (effect, where), places in unheard_groups().items():
        if effect == group_of("scale"):
            out[:, places[0]] = at_none.scale[:, joint_index(where)]
        elif effect == group_of("kick"):
            out[:, places] = _kicks(prepared, at_none)
    for joint, name in enumerate(ACTIVE_JOINTS):
        block = prepared.block(f"actuation.{name}")
        if block is not None:
            for key, columns in _of_joint(prepared, at_none, block, joint).items():
                out[block.rows, _span(group_of(key), name)] = np.column_stack(columns)
    return out


def _span(effect: str, joint: str | None) -> slice:
    places = unheard_groups()[effect, joint]
    return slice(places[0], places[-1] + 1)


def _of_joint(
    prepared: PreparedThrow, linear: Linear, block: Block, joint: int
) -> dict[str, list[Array]]:
    """Columns (n,) of the joint's rows by shape."""
    motion, rated = prepared.motion, load_spec().limits.speed_positive_rad_m_per_s
    slopes, name = linear.jacobian[block.rows], ACTIVE_JOINTS[joint]
    gain = slopes[:, [index_of()[f"valve_gain.{name}.{way}_ratio"] for way in DIRECTIONS]].sum(
        axis=1
    )

    def at_rows(track: Array) -> Array:
        return np.interp(block.t_s, motion.t_s, track)

    way = _way(prepared, block, joint)
    place = at_rows(_place(motion.position_rad_m[:, joint], joint))
    others = [k for k in range(ACTIVE_COUNT) if k != joint]
    share = np.abs(gain) / rated[joint]
    return {
        "way": [gain * _bump(way, k) for k in WAY_POWERS]
        + [gain * np.cos(np.pi * k * place) for k in PLACE_WAVES],
        "play": list(play_columns(prepared, linear, block).T),
        "neighbours": [
            rated[joint] / rated[k] * at_rows(linear.predicted_velocity[:, k]) for k in others
        ],
        "command": [gain * share, gain * share**2],
    }


def play_columns(prepared: PreparedThrow, linear: Linear, block: Block) -> Array:
    """Columns (n, k) of a driven joint's play that changes on the way, at the rows of its block."""
    joint = block.name.removeprefix("actuation.")
    slope = linear.jacobian[block.rows, index_of()[f"valve_hysteresis.{joint}.half_width_ratio"]]
    way = _way(prepared, block, joint_index(joint))
    return np.column_stack([slope * _bump(way, k) for k in PLAY_POWERS])


def _way(prepared: PreparedThrow, block: Block, joint: int) -> Array:
    """How far a joint has come since the start of the throw, in widths of a bump, at the rows of a block."""
    motion = prepared.motion
    speed = np.abs(motion.velocity_rad_m_per_s[:, joint])
    return np.interp(block.t_s, motion.t_s, np.cumsum(speed) * CONTROL_PERIOD_S) / WAY_RAD_M


def _kicks(prepared: PreparedThrow, linear: Linear) -> Array:
    """Columns (n, 3) of a velocity that the load gains along the gripper's axes as it leaves.

    Zero where no tracker saw the load: two coordinates of an impact tell such a push from nothing else.
    """
    out = np.zeros((linear.residual.size, 3))
    if prepared.block("flight.ball") is None:
        return out
    motion, opening_s = prepared.motion, prepared.input.opening_t_s
    pose = np.concatenate([motion.position_rad_m, motion.swing_rad], axis=1)
    at_opening = np.array([np.interp(opening_s, motion.t_s, track) for track in pose.T])
    for axis, along in enumerate(gripper_axes(at_opening[None])[0].T):
        flight_shift(prepared, linear, out[:, axis], np.r_[np.zeros(3), along])
    return out


def _place(position_rad_m: Array, joint: int) -> Array:
    """0 to 1 of a joint's range; the slew, which goes round, in half turns."""
    low, high = (float(end[joint]) for end in load_spec().position_range_rad_m)
    if not np.isfinite(high - low):
        return position_rad_m / np.pi
    return (position_rad_m - low) / (high - low)


def _bump(way: Array, power: int) -> Array:
    """Along a way in bump widths: highest, with 1, at `power` widths."""
    return np.asarray((way / max(power, 1)) ** power * np.exp(power - way))
