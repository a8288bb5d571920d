"""Play that changes on the way has the slopes of the play beside it."""

from collections.abc import Sequence

import numpy as np
import pytest

from diagnosis.causes.evidence import total
from diagnosis.causes.linear import Linear
from diagnosis.causes.own_play import with_own_play
from diagnosis.causes.parameters import index_of, library
from diagnosis.causes.problem import Problem
from diagnosis.causes.residuals import relinearise
from diagnosis.causes.shapes import group_of, unheard_groups, unheard_names
from diagnosis.causes.unheard import play_columns
from diagnosis.causes.whitening import Whitened, information, slope_count, whiten_throw
from diagnosis.healthy.noise import whiten
from sim_twin.effects.effect import Effect
from tests.diagnosis.twin_throws import posed, throws

PLAY = Effect(effect="valve_hysteresis", joint="dipper", parameters={"half_width_ratio": 0.1})
SIZE = index_of()["valve_hysteresis.dipper.half_width_ratio"]
PLACES = np.array(unheard_groups()[group_of("play"), "dipper"])


@pytest.fixture(scope="module")
def problem() -> Problem:
    return posed(throws((PLAY,), 3))


@pytest.fixture(scope="module")
def at(problem: Problem) -> Sequence[Linear]:
    args = problem.prepared, problem.profile, problem.calibration, problem.healthy, problem.linear
    return next(relinearise(*args, [((PLAY,), [library()[SIZE]])]))


def whitened(problem: Problem, at: Sequence[Linear]) -> list[Whitened]:
    return [
        whiten_throw(p, a, problem.model, f, b)
        for p, a, f, b in zip(problem.prepared, at, problem.factor, problem.basis, strict=True)
    ]


def test_play_that_is_the_same_all_along_is_play_and_nothing_else_changes(
    problem: Problem, at: Sequence[Linear]
) -> None:
    before = whitened(problem, at)
    after, _ = with_own_play(problem, before, at, problem.factor, ["dipper"])

    columns = 2 + slope_count() - len(unheard_names()) + PLACES
    for old, new in zip(before, after, strict=True):
        np.testing.assert_allclose(new.gram, new.table.T @ new.table, rtol=1e-8, atol=1e-6)
        moved = np.flatnonzero((old.table != new.table).any(axis=0))
        assert set(columns) <= set(moved) <= {0, 1, *columns}
    changing = problem.layout.size_count - len(unheard_names()) + PLACES

    def alike(precision):
        own = np.sqrt(np.diag(precision))
        return np.abs(precision[SIZE, changing]) / (own[SIZE] * own[changing])

    loose, apart = (alike(total(information(all_)).precision) for all_ in (before, after))
    assert apart.max() < 0.02
    assert loose.max() > 5.0 * apart.max()


def test_a_set_with_changing_play_moves_as_that_play_does_at_the_play_that_is_there(
    problem: Problem, at: Sequence[Linear]
) -> None:
    throw, linear, factor = problem.prepared[0], at[0], problem.factor[0]
    after, priors = with_own_play(problem, whitened(problem, at), at, problem.factor, ["dipper"])

    shapes = after[0].slopes[:, -len(unheard_names()) :][:, PLACES]
    named = after[0].slopes[:, : len(library())]
    block = next(b for b in throw.blocks if b.name == "actuation.dipper")
    lower = factor[throw.blocks.index(block)]
    expected = whiten(lower, play_columns(throw, linear, block))
    found = (shapes + named @ priors.looks_like[:, PLACES])[block.rows]
    np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())
