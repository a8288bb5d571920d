"""Effects that no library has are called unknown, with what they look like; healthy throws are not."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from diagnosis.causes.parameters import layout, library
from diagnosis.causes.problem import Problem, pose
from diagnosis.causes.ranking import Ranked
from diagnosis.causes.selection import total
from diagnosis.causes.shapes import SHAPES, UNHEARD, shape_of, unheard_groups, unheard_names
from diagnosis.causes.unheard import unheard_columns
from diagnosis.diagnose import diagnose_throws
from diagnosis.loading.logs import LoadedSet, ThrowData
from diagnosis.loading.prepared import prepare
from diagnosis.verdict import VerdictKind
from machine.conventions import Array
from tests.diagnosis.twin_throws import health, profile, throws

THROWS = 6
BOOM, DIPPER = 1, 2


def posed(loaded: LoadedSet) -> Problem:
    known = health()
    prepared = prepare(loaded.throws, profile())
    return pose(prepared, profile(), loaded.throws[0].calibration, known, layout(known.noise))


def moved(throw: ThrowData, velocity: Array) -> ThrowData:
    """The throw with more velocity (T,) of the dipper, as its sensors report it."""
    seen_velocity = throw.sensor_velocity_rad_m_per_s.copy()
    seen_position = throw.sensor_position_rad_m.copy()
    seen_velocity[:, DIPPER] += velocity
    seen_position[:, DIPPER] += np.cumsum(velocity) * float(np.median(np.diff(throw.sensor_t_s)))
    return replace(
        throw, sensor_velocity_rad_m_per_s=seen_velocity, sensor_position_rad_m=seen_position
    )


def leaking(throw: ThrowData, ratio: float) -> ThrowData:
    return moved(throw, ratio * throw.sensor_velocity_rad_m_per_s[:, BOOM])


def fading(throw: ThrowData, ratio: float) -> ThrowData:
    """A dipper whose speed is short at first, and recovers on the way."""
    velocity = throw.sensor_velocity_rad_m_per_s[:, DIPPER]
    way = np.cumsum(np.abs(velocity)) * 0.01
    return moved(throw, -ratio * velocity * np.exp(-way / 0.1))


def diagnosed(changed: Sequence[ThrowData], loaded: LoadedSet) -> tuple[VerdictKind, object]:
    found = diagnose_throws(replace(loaded, throws=tuple(changed)), profile(), health=health())
    return found.verdict, found.evidence["unknown"]


def test_every_column_belongs_to_one_shape_of_one_joint() -> None:
    groups = unheard_groups()
    places = [place for group in groups.values() for place in group]
    assert sorted(places) == list(range(len(unheard_names())))
    assert {effect for effect, _ in groups} == {f"{UNHEARD}:{key}" for key in SHAPES}
    assert shape_of("valve_gain") is None
    assert shape_of(f"{UNHEARD}:play") is SHAPES["play"]


def test_columns_act_at_their_own_joint_and_follow_what_they_are_named_for() -> None:
    problem = posed(throws((), 1))
    prepared, linear = problem.prepared[0], problem.linear[0]
    columns = unheard_columns(prepared, linear)
    for place, name in enumerate(unheard_names()):
        joint = name.split(".")[2]
        block = prepared.block(f"actuation.{joint}")
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


@pytest.mark.parametrize(
    ("changed", "ratio", "shape"), [(leaking, 0.25, "neighbours"), (fading, 0.6, "way")]
)
def test_what_no_library_has_is_unknown_and_says_what_it_looks_like(
    changed: Callable[[ThrowData, float], ThrowData], ratio: float, shape: str
) -> None:
    loaded = throws((), THROWS)
    verdict, signature = diagnosed([changed(t, ratio) for t in loaded.throws], loaded)
    assert verdict is VerdictKind.UNKNOWN
    assert isinstance(signature, dict)
    assert (signature["stage"], signature["joint"]) == ("actuation", "dipper")
    assert signature["looks_like"] == SHAPES[shape].said


def test_the_same_throws_without_it_have_no_effect() -> None:
    loaded = throws((), THROWS)
    verdict, signature = diagnosed(loaded.throws, loaded)
    assert verdict is VerdictKind.NONE
    assert signature is None


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


def test_two_causes_that_cannot_be_told_apart_are_not_unknown_together():
    """Each of two alike is less probable than "unknown"; one of them is more probable."""
    one, other = (SimpleNamespace(members=(m,)) for m in (1, 2))
    kept = {
        "hypotheses": [one, other],
        "probability": np.array([0.30, 0.28]),
        "unknown": 0.37,
        "shape": None,
        "levels": {},
        "jitter": None,
        "jitter_probability": 0.0,
        "rival_log_odds": 0.0,
    }
    assert not Ranked(**kept, rival=other).is_unknown
    assert Ranked(**kept, rival=None).is_unknown
