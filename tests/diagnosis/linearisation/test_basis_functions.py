"""Basis functions of effects outside the library."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from diagnosis.linearisation.basis_functions import unmodelled_columns
from diagnosis.linearisation.information import total
from diagnosis.linearisation.parameters import library
from diagnosis.linearisation.unmodelled_effects import (
    UNMODELLED,
    UNMODELLED_EFFECTS,
    unmodelled_effect_of,
    unmodelled_groups,
    unmodelled_names,
)
from diagnosis.loading.throw_data import LoadedSet, ThrowData
from machine.conventions import ACTIVE_COUNT, Array
from sim_twin.rigid_body.grip_point import gripper_axes
from tests.diagnosis.twin_throws import SWITCH_LAG_S, posed, posed_healthy, throws

THROWS = 6
DIPPER, TELESCOPE = 2, 3
"""Throws need not tell which of them a stretch where a joint is slow looks like most."""


def scaled(throw: ThrowData, ratio: float) -> ThrowData:
    """A dipper whose sensor reports too much; the machine's own estimate of the swing stays plumb."""
    factor = np.ones(ACTIVE_COUNT)
    factor[DIPPER] += ratio
    estimate = throw.joint_position_rad_m.copy()
    excess = ratio * estimate[:, DIPPER]
    estimate[:, DIPPER] += excess
    estimate[:, ACTIVE_COUNT] -= excess
    return replace(
        throw,
        sensor_position_rad_m=factor * throw.sensor_position_rad_m,
        sensor_velocity_rad_m_per_s=factor * throw.sensor_velocity_rad_m_per_s,
        joint_position_rad_m=estimate,
    )


def kicked(throw: ThrowData, speed_m_per_s: float) -> ThrowData:
    """A load that leaves with so much more speed to the gripper's left."""
    opened = int(np.searchsorted(throw.t_s, throw.switch_open_t_s - SWITCH_LAG_S))
    axes = gripper_axes(throw.joint_position_rad_m[opened][None])[0]
    kick = speed_m_per_s * axes[:, 1]
    since = throw.ball_t_s - throw.t_s[opened]
    landed = throw.impact_t_s - throw.t_s[opened]
    return replace(
        throw,
        ball_m=throw.ball_m + since[:, None] * kick,
        impact_m=throw.impact_m + landed * kick * np.array([1.0, 1.0, 0.0]),
    )


def untracked(throw: ThrowData) -> ThrowData:
    """The same throw where no tracker saw the load."""
    return replace(throw, ball_t_s=throw.ball_t_s[:0], ball_m=throw.ball_m[:0])


def without_slew(valve_ratio: Array) -> Array:
    """A slew that stands, whatever its command."""
    return valve_ratio * np.array([0.0, 1.0, 1.0, 1.0])


def measured_as(changed: Callable[[ThrowData, float], ThrowData], size: float) -> LoadedSet:
    loaded = throws((), THROWS)
    return replace(loaded, throws=tuple(changed(t, size) for t in loaded.throws))


def test_every_column_belongs_to_one_unmodelled_effect() -> None:
    groups = unmodelled_groups()
    places = [place for group in groups.values() for place in group]
    assert sorted(places) == list(range(len(unmodelled_names())))
    weighed = {f"{UNMODELLED}:{key}" for key, shape in UNMODELLED_EFFECTS.items() if shape.columns}
    assert {effect for effect, _ in groups} == weighed
    assert unmodelled_effect_of("valve_gain") is None
    assert unmodelled_effect_of(f"{UNMODELLED}:play") is UNMODELLED_EFFECTS["play"]


def test_columns_act_at_their_own_joint() -> None:
    problem = posed_healthy(1)
    prepared, linear = problem.prepared[0], problem.linear[0]
    columns = unmodelled_columns(prepared, linear)
    for place, name in enumerate(unmodelled_names()):
        shape, joint = name.split(".")[1:3]
        block = prepared.block(f"actuation.{joint}")
        if UNMODELLED_EFFECTS[shape].stage != "actuation":
            continue
        assert block is not None
        outside = np.delete(columns[:, place], np.r_[block.rows])
        assert not outside.any(), name
        assert columns[block.rows, place].any(), name
    boom, dipper = prepared.block("actuation.boom"), prepared.block("actuation.dipper")
    assert boom is not None and dipper is not None
    leak = columns[
        dipper.rows, unmodelled_names().index("unmodelled.neighbours.dipper.neighbour_1_ratio")
    ]
    twin = prepared.measured[boom.rows] - linear.residual[boom.rows]
    assert np.corrcoef(leak, twin)[0, 1] > 0.99


def test_scale_columns_match_throws_with_a_scaled_sensor() -> None:
    ratio = 0.01
    loaded = throws((), 1)
    changed = replace(loaded, throws=tuple(scaled(t, ratio) for t in loaded.throws))
    before, after = posed(loaded), posed(changed)
    slope = before.linear[0].scale[:, DIPPER]
    moved = (after.linear[0].residual - before.linear[0].residual) / ratio
    for name in ("actuation.dipper", "swing.gyro.y", "flight.ball", "flight.impact"):
        block = before.prepared[0].block(name)
        assert block is not None
        assert np.corrcoef(slope[block.rows], moved[block.rows])[0, 1] > 0.98, name
        size = float(np.linalg.norm(slope[block.rows]) / np.linalg.norm(moved[block.rows]))
        assert size == pytest.approx(1.0, abs=0.2), name


def test_noise_of_a_joint_that_stands_has_no_scale() -> None:
    moving, standing = (
        posed(throws((), 1, received=received)).linear[0].scale[:, 0]
        for received in (None, without_slew)
    )
    prepared = posed_healthy(1).prepared[0]
    gyro, ball = prepared.block("swing.gyro.x"), prepared.block("flight.ball")
    assert gyro is not None and ball is not None
    assert np.linalg.norm(standing[gyro.rows]) < 1e-3 * np.linalg.norm(moving[gyro.rows])
    # It still stands elsewhere than it says.
    assert np.abs(standing[ball.rows]).max() > 0.1


def test_kick_columns_move_the_load_alone() -> None:
    prepared, linear = posed_healthy(1).prepared[0], posed_healthy(1).linear[0]
    left = unmodelled_columns(prepared, linear)[
        :, unmodelled_names().index("unmodelled.kick.y_m_per_s")
    ]
    moved = kicked(prepared.throw, 1.0).ball_m - prepared.throw.ball_m
    ball = prepared.block("flight.ball")
    assert ball is not None
    assert left[ball.rows] == pytest.approx(moved.ravel(), abs=0.03)
    rest = [b.rows for b in prepared.blocks if not b.name.startswith("flight")]
    assert not any(left[rows].any() for rows in rest)


def test_without_a_tracker_there_are_no_kick_columns() -> None:
    loaded = throws((), 1)
    blind = replace(loaded, throws=tuple(untracked(t) for t in loaded.throws))
    one = posed(blind)
    assert one.prepared[0].block("flight.ball") is None
    assert one.prepared[0].block("flight.impact") is not None
    places = unmodelled_groups()[f"{UNMODELLED}:kick", None]
    assert not unmodelled_columns(one.prepared[0], one.linear[0])[:, places].any()


def test_unmodelled_effects_are_orthogonal_to_named_ones() -> None:
    problem = posed_healthy(3)
    data, plan = total(problem.information), problem.layout
    first = plan.size_count - len(unmodelled_names())
    named = slice(0, plan.parameter_count)
    across = data.precision[named, first:]
    own, shape = np.diag(data.precision)[named], np.diag(data.precision)[first:]
    similarity = np.abs(across) / np.sqrt(np.outer(np.maximum(own, 1.0), np.maximum(shape, 1e-9)))
    gains = [
        i
        for i, p in enumerate(library())
        if p.effect in ("valve_gain", "valve_dead_band") and own[i] > 1e4
    ]
    assert len(gains) >= 4
    assert similarity[gains].max() < 0.1
