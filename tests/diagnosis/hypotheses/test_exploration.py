"""Effects that slopes at zero do not show are found."""

from types import SimpleNamespace
from typing import cast

import numpy as np

from diagnosis.hypotheses.comparison import CandidateSet
from diagnosis.hypotheses.exploration import model_error_of_subsets


def test_an_unmodelled_effect_must_exceed_the_model_error_of_the_effects_beside_it() -> None:
    none, chassis, small = (
        cast("CandidateSet", SimpleNamespace(members=m)) for m in ((), (3,), (4,))
    )
    # No effect, two effects, and an unmodelled effect beside nothing and beside each of them.
    evaluated = [(0, ()), (1, (3,)), (2, (4,)), (0, (9,)), (1, (3, 9)), (2, (4, 9))]
    logs = np.array(
        [[0.0, 2700.0, 50.0, 10.0, 2710.0, 60.0], [0.0, 2000.0, -5.0, 10.0, 2010.0, 5.0]]
    )
    form = model_error_of_subsets([none, chassis, small], evaluated, logs)
    np.testing.assert_allclose(form[:, :4], 0.0)
    np.testing.assert_allclose(form[:, 4:], [[54.0, 1.0], [40.0, 0.0]])
