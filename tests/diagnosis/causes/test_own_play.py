"""Play that changes on the way has the slopes of the play beside it."""

import numpy as np

from diagnosis.causes.own_play import with_own_play
from diagnosis.causes.parameters import index_of, library
from diagnosis.causes.residuals import relinearise
from diagnosis.causes.selection import total
from diagnosis.causes.shapes import group_of, unheard_groups, unheard_names
from diagnosis.causes.whitening import information, slope_count, whiten_throw
from sim_twin.effects.effect import Effect
from tests.diagnosis.twin_throws import posed, throws

PLAY = Effect(effect="valve_hysteresis", joint="dipper", parameters={"half_width_ratio": 0.1})


def test_play_that_is_the_same_all_along_is_play_and_nothing_else_changes() -> None:
    problem = posed(throws((PLAY,), 3))
    size = index_of()["valve_hysteresis.dipper.half_width_ratio"]
    args = problem.prepared, problem.profile, problem.calibration, problem.healthy, problem.linear
    at = next(relinearise(*args, [((PLAY,), [library()[size]])]))
    before = [
        whiten_throw(p, a, problem.model, f, b)
        for p, a, f, b in zip(problem.prepared, at, problem.factor, problem.basis, strict=True)
    ]
    after = with_own_play(problem, before, at, problem.factor, ["dipper"])

    places = np.array(unheard_groups()[group_of("play"), "dipper"])
    columns = 2 + slope_count() - len(unheard_names()) + places
    for old, new in zip(before, after, strict=True):
        np.testing.assert_allclose(new.gram, new.table.T @ new.table, rtol=1e-8, atol=1e-6)
        moved = np.flatnonzero((old.table != new.table).any(axis=0))
        assert set(columns) <= set(moved) <= {0, 1, *columns}
    changing = problem.layout.size_count - len(unheard_names()) + places

    def alike(precision):
        own = np.sqrt(np.diag(precision))
        return np.abs(precision[size, changing]) / (own[size] * own[changing])

    loose, apart = (alike(total(information(all_)).precision) for all_ in (before, after))
    assert apart.max() < 0.02
    assert loose.max() > 5.0 * apart.max()
