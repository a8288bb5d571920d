"""Play that changes on the way has the slopes of the play beside it."""

import numpy as np

from diagnosis.causes.own_play import with_own_play
from diagnosis.causes.parameters import layout
from diagnosis.causes.problem import pose
from diagnosis.causes.residuals import relinearise
from diagnosis.causes.whitening import whiten_throw
from diagnosis.loading.prepared import prepare
from sim_twin.effects.effect import Effect
from tests.diagnosis.twin_throws import health, profile, throws


def test_what_it_leaves_fits_together_and_moves_the_joint_alone() -> None:
    known = health()
    play = Effect(effect="valve_hysteresis", joint="dipper", parameters={"half_width_ratio": 0.1})
    loaded = throws((play,), 2)
    prepared = prepare(loaded.throws, profile())
    problem = pose(prepared, profile(), loaded.throws[0].calibration, known, layout(known.noise))
    at = next(
        iter(
            relinearise(
                prepared,
                profile(),
                problem.calibration,
                problem.healthy,
                problem.linear,
                [((play,), [])],
            )
        )
    )
    before = [
        whiten_throw(p, a, problem.model, f, b)
        for p, a, f, b in zip(prepared, at, problem.factor, problem.basis, strict=True)
    ]
    after = with_own_play(problem, before, at, problem.factor, ["dipper"])
    for old, new in zip(before, after, strict=True):
        np.testing.assert_allclose(new.gram, new.table.T @ new.table, rtol=1e-8, atol=1e-6)
        moved = np.flatnonzero((old.table != new.table).any(axis=0))
        assert 3 <= moved.size <= 5
