"""Basis functions of the unmodelled effects (unmodelled_effects.py) for one throw.

Those of drives are slopes of the library times a measured signal; a sensor's scale has slopes of its own.
"""

import numpy as np

from diagnosis.linearisation.nuisances import flight_shift
from diagnosis.linearisation.parameters import index_of, joint_index
from diagnosis.linearisation.sensitivities import LinearThrow
from diagnosis.linearisation.unmodelled_effects import (
    PLACE_WAVES,
    PLAY_ORDERS,
    TRAVEL_ORDERS,
    group_of,
    unmodelled_groups,
    unmodelled_names,
)
from diagnosis.loading.prepared import Block, PreparedThrow
from machine.conventions import ACTIVE_COUNT, ACTIVE_JOINTS, CONTROL_PERIOD_S, Array
from machine.spec import load_spec
from sim_twin.rigid_body.grip_point import gripper_axes

DIRECTIONS = ("positive", "negative")
BUMP_WIDTH_RAD_M = 0.12
"""Width of the bumps along a joint's travel, rad or m: half of what a joint at speed travels in 0.6 s."""


def unmodelled_columns(prepared: PreparedThrow, no_effect_throw: LinearThrow) -> Array:
    """Columns (n, u) of a throw in the order of `unmodelled_names`.

    Args:
        prepared: the throw.
        no_effect_throw: linearised without effect.
    """
    out = np.zeros((no_effect_throw.residual.size, len(unmodelled_names())))
    for (effect, where), places in unmodelled_groups().items():
        if effect == group_of("scale"):
            out[:, places[0]] = no_effect_throw.scale[:, joint_index(where)]
        elif effect == group_of("kick"):
            out[:, places] = _kicks(prepared, no_effect_throw)
    for joint, name in enumerate(ACTIVE_JOINTS):
        block = prepared.block(f"actuation.{name}")
        if block is not None:
            for key, columns in _of_joint(prepared, no_effect_throw, block, joint).items():
                out[block.rows, _span(group_of(key), name)] = np.column_stack(columns)
    return out


def _span(effect: str, joint: str | None) -> slice:
    places = unmodelled_groups()[effect, joint]
    return slice(places[0], places[-1] + 1)


def _of_joint(
    prepared: PreparedThrow, linear: LinearThrow, block: Block, joint: int
) -> dict[str, list[Array]]:
    """Columns (n,) at the joint's rows, by unmodelled effect."""
    motion, rated = prepared.motion, load_spec().limits.speed_positive_rad_m_per_s
    slopes, name = linear.jacobian[block.rows], ACTIVE_JOINTS[joint]
    gain = slopes[:, [index_of()[f"valve_gain.{name}.{way}_ratio"] for way in DIRECTIONS]].sum(
        axis=1
    )

    def at_rows(track: Array) -> Array:
        return np.interp(block.t_s, motion.t_s, track)

    way = _travel(prepared, block, joint)
    place = at_rows(_place(motion.position_rad_m[:, joint], joint))
    others = [k for k in range(ACTIVE_COUNT) if k != joint]
    share = np.abs(gain) / rated[joint]
    return {
        "way": [gain * _bump(way, k) for k in TRAVEL_ORDERS]
        + [gain * np.cos(np.pi * k * place) for k in PLACE_WAVES],
        "play": list(play_columns(prepared, linear, block).T),
        "neighbours": [
            rated[joint] / rated[k] * at_rows(linear.predicted_velocity[:, k]) for k in others
        ],
        "command": [gain * share, gain * share**2],
    }


def play_columns(prepared: PreparedThrow, linear: LinearThrow, block: Block) -> Array:
    """Columns (n, k) of a driven joint's varying play, at the rows of its block."""
    joint = block.name.removeprefix("actuation.")
    slope = linear.jacobian[block.rows, index_of()[f"valve_hysteresis.{joint}.half_width_ratio"]]
    way = _travel(prepared, block, joint_index(joint))
    return np.column_stack([slope * _bump(way, k) for k in PLAY_ORDERS])


def _travel(prepared: PreparedThrow, block: Block, joint: int) -> Array:
    """Travel of a joint since the start of the throw, in widths of a bump, at the rows of a block."""
    motion = prepared.motion
    speed = np.abs(motion.velocity_rad_m_per_s[:, joint])
    return np.interp(block.t_s, motion.t_s, np.cumsum(speed) * CONTROL_PERIOD_S) / BUMP_WIDTH_RAD_M


def _kicks(prepared: PreparedThrow, linear: LinearThrow) -> Array:
    """Columns (n, 3) of a velocity that the load gains along the gripper's axes at release.

    Zero without a ball track: the two coordinates of an impact cannot separate such a push from other
    effects.
    """
    out = np.zeros((linear.residual.size, 3))
    if prepared.block("flight.ball") is None:
        return out
    motion, opening_s = prepared.motion, prepared.input.opening_t_s
    pose_problem = np.concatenate([motion.position_rad_m, motion.swing_rad], axis=1)
    at_opening = np.array([np.interp(opening_s, motion.t_s, track) for track in pose_problem.T])
    for axis, along in enumerate(gripper_axes(at_opening[None])[0].T):
        flight_shift(prepared, linear, out[:, axis], np.r_[np.zeros(3), along])
    return out


def _place(position_rad_m: Array, joint: int) -> Array:
    """Position within a joint's range, 0 to 1; the slew, which is continuous, in half turns."""
    low, high = (float(end[joint]) for end in load_spec().position_range_rad_m)
    if not np.isfinite(high - low):
        return position_rad_m / np.pi
    return (position_rad_m - low) / (high - low)


def _bump(way: Array, power: int) -> Array:
    """A bump along the travel in bump widths: maximum 1 at `power` widths."""
    return np.asarray((way / max(power, 1)) ** power * np.exp(power - way))
