"""Effects that no library has are called unknown, with what they look like; healthy throws are not."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from diagnosis.causes import shaped
from diagnosis.causes.evidence import total, weigh
from diagnosis.causes.hypotheses import Hypothesis
from diagnosis.causes.parameters import library
from diagnosis.causes.problem import Problem
from diagnosis.causes.ranking import Ranked, unknown_levels
from diagnosis.causes.shaped import with_shapes
from diagnosis.causes.shapes import SHAPES, UNHEARD, shape_of, unheard_groups, unheard_names
from diagnosis.causes.trials import no_effect, try_sets
from diagnosis.causes.unheard import unheard_columns
from diagnosis.causes.weighing import Trial
from diagnosis.diagnose import diagnose_throws
from diagnosis.loading.prepared import prepare
from diagnosis.loading.throw_data import LoadedSet, ThrowData
from diagnosis.verdict import VerdictKind
from machine.conventions import ACTIVE_COUNT, ACTIVE_JOINTS, Array
from sim_twin.effects.effect import Effect
from sim_twin.twin.grip_point import gripper_axes
from tests.diagnosis.twin_throws import SWITCH_LAG_S, health, posed, profile, throws

THROWS = 6
DIPPER, TELESCOPE = 2, 3
DRIVE_SHAPES = {"way", "play", "command"}
"""Throws need not tell which of them a stretch where a joint is slow looks like most."""


def leaking(valve_ratio: Array) -> Array:
    """The telescope's pilot pressure leaks into the dipper's valve."""
    received = valve_ratio.copy()
    received[:, DIPPER] += 0.2 * valve_ratio[:, TELESCOPE]
    return received


def sticky(valve_ratio: Array) -> Array:
    """A dipper that is slow on a stretch of its way."""
    received = valve_ratio.copy()
    way = np.cumsum(np.abs(valve_ratio[:, DIPPER])) * 0.01
    received[:, DIPPER] *= 1.0 - 0.7 * np.exp(-(((way - 0.25) / 0.1) ** 2))
    return received


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


def opened_by_the_swing() -> LoadedSet:
    """Loads that leave later, by the rate at which the gripper swings as it opens."""
    loaded = throws((), 12)
    rate = np.array(
        [
            np.interp(t.open_command_t_s, p.motion.t_s, p.motion.swing_rate_rad_per_s[:, 0])
            for t, p in zip(loaded.throws, prepare(loaded.throws, profile()), strict=True)
        ]
    )
    late_s = 0.06 * (rate - rate.mean()) / rate.std()
    changed = [
        replace(t, switch_open_t_s=t.switch_open_t_s + own)
        for t, own in zip(loaded.throws, late_s, strict=True)
    ]
    return replace(loaded, throws=tuple(changed))


def without_slew(valve_ratio: Array) -> Array:
    """A slew that stands, whatever it is told."""
    return valve_ratio * np.array([0.0, 1.0, 1.0, 1.0])


def measured_as(changed: Callable[[ThrowData, float], ThrowData], size: float) -> LoadedSet:
    loaded = throws((), THROWS)
    return replace(loaded, throws=tuple(changed(t, size) for t in loaded.throws))


def test_every_column_belongs_to_one_shape_of_one_place() -> None:
    groups = unheard_groups()
    places = [place for group in groups.values() for place in group]
    assert sorted(places) == list(range(len(unheard_names())))
    weighed = {f"{UNHEARD}:{key}" for key, shape in SHAPES.items() if shape.columns}
    assert {effect for effect, _ in groups} == weighed
    assert shape_of("valve_gain") is None
    assert shape_of(f"{UNHEARD}:play") is SHAPES["play"]


def test_columns_act_at_their_own_joint_and_follow_what_they_are_named_for() -> None:
    problem = posed(throws((), 1))
    prepared, linear = problem.prepared[0], problem.linear[0]
    columns = unheard_columns(prepared, linear)
    for place, name in enumerate(unheard_names()):
        shape, joint = name.split(".")[1:3]
        block = prepared.block(f"actuation.{joint}")
        if SHAPES[shape].stage != "actuation":
            continue
        assert block is not None
        outside = np.delete(columns[:, place], np.r_[block.rows])
        assert not outside.any(), name
        assert columns[block.rows, place].any(), name
    boom, dipper = prepared.block("actuation.boom"), prepared.block("actuation.dipper")
    assert boom is not None and dipper is not None
    leak = columns[
        dipper.rows, unheard_names().index("unheard.neighbours.dipper.neighbour_1_ratio")
    ]
    twin = prepared.measured[boom.rows] - linear.residual[boom.rows]
    assert np.corrcoef(leak, twin)[0, 1] > 0.99


def test_a_scale_moves_every_channel_as_throws_with_a_scaled_sensor_differ() -> None:
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
    """Less of it would only shake the simulated gripper less."""
    moving, standing = (
        posed(throws((), 1, received=received)).linear[0].scale[:, 0]
        for received in (None, without_slew)
    )
    prepared = posed(throws((), 1)).prepared[0]
    gyro, ball = prepared.block("swing.gyro.x"), prepared.block("flight.ball")
    assert gyro is not None and ball is not None
    assert np.linalg.norm(standing[gyro.rows]) < 1e-3 * np.linalg.norm(moving[gyro.rows])
    # It still stands elsewhere than it says.
    assert np.abs(standing[ball.rows]).max() > 0.1


def test_a_kick_moves_the_load_alone_and_by_its_time_in_the_air() -> None:
    prepared, linear = posed(throws((), 1)).prepared[0], posed(throws((), 1)).linear[0]
    left = unheard_columns(prepared, linear)[:, unheard_names().index("unheard.kick.y_m_per_s")]
    moved = kicked(prepared.throw, 1.0).ball_m - prepared.throw.ball_m
    ball = prepared.block("flight.ball")
    assert ball is not None
    assert left[ball.rows] == pytest.approx(moved.ravel(), abs=0.03)
    rest = [b.rows for b in prepared.blocks if not b.name.startswith("flight")]
    assert not any(left[rows].any() for rows in rest)


def test_without_a_tracker_a_kick_is_no_hypothesis() -> None:
    """An impact's two coordinates tell a push along three axes from nothing."""
    loaded = throws((), 1)
    blind = replace(loaded, throws=tuple(untracked(t) for t in loaded.throws))
    one = posed(blind)
    assert one.prepared[0].block("flight.ball") is None
    assert one.prepared[0].block("flight.impact") is not None
    places = unheard_groups()[f"{UNHEARD}:kick", None]
    assert not unheard_columns(one.prepared[0], one.linear[0])[:, places].any()


@pytest.mark.parametrize(
    ("loaded", "shapes", "where"),
    [
        (partial(throws, (), THROWS, received=leaking), {"neighbours"}, ("actuation", "dipper")),
        # In six throws it passes for a dead band and a speed limit.
        (partial(throws, (), 12, received=sticky), DRIVE_SHAPES, ("actuation", "dipper")),
        (partial(measured_as, scaled, 0.15), {"scale"}, ("aim", "dipper")),
        (partial(measured_as, kicked, 0.5), {"kick"}, ("release", None)),
        (opened_by_the_swing, {"opening"}, ("release", None)),
    ],
)
def test_what_no_library_has_is_unknown_and_says_what_it_looks_like(
    loaded: Callable[[], LoadedSet], shapes: set[str], where: tuple[str, str | None]
) -> None:
    found = diagnose_throws(loaded(), profile(), health=health())
    signature = found.evidence["unknown"]
    assert found.verdict is VerdictKind.UNKNOWN
    assert isinstance(signature, dict)
    assert (signature["stage"], signature["joint"]) == where
    assert signature["looks_like"] in {SHAPES[shape].said for shape in shapes}


def biased(throw: ThrowData, bias_rad: float) -> ThrowData:
    """A dipper whose sensor is off by the same everywhere; the estimate of the swing stays plumb."""
    off = bias_rad * np.eye(ACTIVE_COUNT)[DIPPER]
    estimate = throw.joint_position_rad_m.copy()
    estimate[:, DIPPER] += bias_rad
    estimate[:, ACTIVE_COUNT] -= bias_rad
    return replace(
        throw,
        sensor_position_rad_m=throw.sensor_position_rad_m + off,
        joint_position_rad_m=estimate,
    )


@pytest.mark.parametrize(
    ("changed", "size", "is_scale"), [(scaled, 0.04, True), (biased, -0.04, False)]
)
def test_a_sensor_s_scale_and_its_bias_are_told_from_each_other_as_they_look(
    changed: Callable[[ThrowData, float], ThrowData], size: float, is_scale: bool
) -> None:
    """A scale's mean is a bias: on what a bias leaves of it alone a scale lost to the bias."""
    problem = posed(measured_as(changed, size))
    base, priors, groups = no_effect(problem).base, problem.layout.priors, problem.layout.groups
    scale, bias = (
        weigh(base, priors, (groups.index((name, "dipper")),))
        for name in (f"{UNHEARD}:scale", "joint_sensor_bias")
    )
    assert (scale.log_odds > bias.log_odds) == is_scale
    assert abs(scale.log_odds - bias.log_odds) > 10.0
    assert (scale if is_scale else bias).mean == pytest.approx(size, rel=0.25)


def shapes_of(problem: Problem, *trials: Trial) -> set[tuple[str, str | None]]:
    """Shapes that are weighed, alone or beside what trials have."""
    return {problem.layout.groups[m[-1]] for _, m in with_shapes(problem, trials)}


def dipper_effect(effect: str, size: float) -> Effect:
    sizes = {"positive_ratio": size, "negative_ratio": size}
    return Effect(effect=effect, joint="dipper", parameters=sizes)


def test_what_a_name_explains_is_no_shape(monkeypatch: pytest.MonkeyPatch) -> None:
    """A gain looks like a speed that changes on the way, or with the command, and has nothing beside."""
    problem = posed(throws((dipper_effect("valve_gain", 0.15),), THROWS))
    like_a_gain = {(f"{UNHEARD}:way", "dipper"), (f"{UNHEARD}:command", "dipper")}
    assert not shapes_of(problem, no_effect(problem)) & like_a_gain
    monkeypatch.setattr(shaped, "LEAST_OWN_LOG_EVIDENCE", 0.0)
    assert shapes_of(problem, no_effect(problem)) >= like_a_gain


def test_beside_a_dead_band_its_joint_s_metering_is_form(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = posed(throws((dipper_effect("valve_dead_band", 0.1),), 3))
    group = problem.layout.groups.index(("valve_dead_band", "dipper"))
    trial = try_sets(problem, {(group,): np.array([0.1, 0.1])})[0]
    monkeypatch.setattr(shaped, "LEAST_OWN_LOG_EVIDENCE", -1.0)
    monkeypatch.setattr(shaped, "own_evidence", lambda _: -np.inf)
    monkeypatch.setattr(shaped, "SHAPED_COUNT", 100)
    everywhere = {(f"{UNHEARD}:command", joint) for joint in ACTIVE_JOINTS}
    assert everywhere - shapes_of(problem, trial) == {(f"{UNHEARD}:command", "dipper")}
    assert everywhere <= shapes_of(problem, no_effect(problem))


def test_the_same_throws_without_it_have_no_effect() -> None:
    found = diagnose_throws(throws((), THROWS), profile(), health=health())
    assert found.verdict is VerdictKind.NONE
    assert found.evidence["unknown"] is None


def test_shapes_leave_the_evidence_of_named_effects_as_it_is() -> None:
    """Beside what has a name a shape adds nothing to a named effect, and takes nothing from it."""
    problem = posed(throws((), 3))
    data, plan = total(problem.information), problem.layout
    first = plan.size_count - len(unheard_names())
    named = slice(0, plan.parameter_count)
    across = data.precision[named, first:]
    own, shape = np.diag(data.precision)[named], np.diag(data.precision)[first:]
    told = np.abs(across) / np.sqrt(np.outer(np.maximum(own, 1.0), np.maximum(shape, 1e-9)))
    gains = [
        i
        for i, p in enumerate(library())
        if p.effect in ("valve_gain", "valve_dead_band") and own[i] > 1e4
    ]
    assert len(gains) >= 4
    assert told[gains].max() < 0.1


def test_where_nothing_is_explained_nothing_is_the_form_of_an_effect() -> None:
    """A share of what no effect leaves counts as form error of the effect that explains it, if one does."""
    block = "actuation.dipper"
    problem = cast(
        "Problem",
        SimpleNamespace(
            model=SimpleNamespace(unknown_level={block: (0.0, 0.1)}), none_levels={block: 1.6}
        ),
    )
    none, found = (
        cast("Hypothesis", SimpleNamespace(members=members, effects=(), levels={block: 0.3}))
        for members in ((), (4,))
    )
    assert unknown_levels(problem, none, none)[block] == pytest.approx(16.0)
    assert unknown_levels(problem, found, none)[block] == pytest.approx(3.0)


def test_two_causes_that_cannot_be_told_apart_are_not_unknown_together():
    """Each of two alike is less probable than "unknown"; one of them is more probable."""
    one, other = (SimpleNamespace(members=(m,)) for m in (1, 2))
    kept = {
        "hypotheses": [one, other],
        "probability": np.array([0.30, 0.28]),
        "unknown": 0.37,
        "shape": None,
        "ahead": 0.0,
        "levels": {},
        "jitter": None,
        "jitter_probability": 0.0,
        "rival_log_odds": 0.0,
    }
    assert not Ranked(**kept, rival=other).is_unknown
    assert Ranked(**kept, rival=None).is_unknown
