"""Play that varies has the slopes of the play beside it."""

from collections.abc import Sequence

import numpy as np
import pytest

from diagnosis.healthy.noise import whiten
from diagnosis.hypotheses.candidates import with_local_play_slopes
from diagnosis.hypotheses.gap_problem import GapProblem
from diagnosis.inference.evidence import total
from diagnosis.linearisation.basis_functions import play_columns
from diagnosis.linearisation.parameters import index_of, library
from diagnosis.linearisation.sensitivities import LinearThrow, relinearise
from diagnosis.linearisation.unmodelled_effects import group_of, unmodelled_groups, unmodelled_names
from diagnosis.linearisation.whitening import Whitened, information, slope_count, whiten_throw
from sim_twin.effects.effect import Effect
from tests.diagnosis.twin_throws import posed, throws

PLAY = Effect(effect="valve_hysteresis", joint="dipper", parameters={"half_width_ratio": 0.1})
SIZE = index_of()["valve_hysteresis.dipper.half_width_ratio"]
PLACES = np.array(unmodelled_groups()[group_of("play"), "dipper"])


@pytest.fixture(scope="module")
def problem() -> GapProblem:
    return posed(throws((PLAY,), 3))


@pytest.fixture(scope="module")
def at(problem: GapProblem) -> Sequence[LinearThrow]:
    args = problem.prepared, problem.profile, problem.calibration, problem.healthy, problem.linear
    return next(relinearise(*args, [((PLAY,), [library()[SIZE]])]))


def whitened(problem: GapProblem, at: Sequence[LinearThrow]) -> list[Whitened]:
    return [
        whiten_throw(p, a, problem.model, f, b)
        for p, a, f, b in zip(problem.prepared, at, problem.factor, problem.basis, strict=True)
    ]


def test_constant_play_is_subtracted_and_nothing_else_changes(
    problem: GapProblem, at: Sequence[LinearThrow]
) -> None:
    before = whitened(problem, at)
    after, _ = with_local_play_slopes(problem, before, at, problem.factor, ["dipper"])

    columns = 2 + slope_count() - len(unmodelled_names()) + PLACES
    for old, new in zip(before, after, strict=True):
        np.testing.assert_allclose(new.gram, new.table.T @ new.table, rtol=1e-8, atol=1e-6)
        moved = np.flatnonzero((old.table != new.table).any(axis=0))
        assert set(columns) <= set(moved) <= {0, 1, *columns}
    changing = problem.layout.size_count - len(unmodelled_names()) + PLACES

    def alike(precision):
        own = np.sqrt(np.diag(precision))
        return np.abs(precision[SIZE, changing]) / (own[SIZE] * own[changing])

    loose, apart = (alike(total(information(all_)).precision) for all_ in (before, after))
    assert apart.max() < 0.02
    assert loose.max() > 5.0 * apart.max()


def test_varying_play_has_the_slopes_of_the_play_present(
    problem: GapProblem, at: Sequence[LinearThrow]
) -> None:
    throw, linear, factor = problem.prepared[0], at[0], problem.factor[0]
    after, priors = with_local_play_slopes(
        problem, whitened(problem, at), at, problem.factor, ["dipper"]
    )

    shapes = after[0].slopes[:, -len(unmodelled_names()) :][:, PLACES]
    named = after[0].slopes[:, : len(library())]
    block = next(b for b in throw.blocks if b.name == "actuation.dipper")
    lower = factor[throw.blocks.index(block)]
    expected = whiten(lower, play_columns(throw, linear, block))
    found = (shapes + named @ priors.looks_like[:, PLACES])[block.rows]
    np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())
