"""Effects that slopes at zero do not show are found."""

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from diagnosis.hypotheses import generation
from diagnosis.hypotheses.candidates import no_effect
from diagnosis.hypotheses.comparison import CandidateSet, beats_none
from diagnosis.hypotheses.exploration import explore, model_error_of_subsets
from diagnosis.hypotheses.refinement import large_enough
from sim_twin.effects.effect import Effect
from tests.diagnosis.twin_throws import posed, throws

SOFT = Effect(effect="chassis_compliance", joint=None, parameters={"pitch_rad": 0.02})


def test_a_second_effect_without_slopes_is_found() -> None:
    loaded = throws(
        (
            Effect(effect="backlash", joint="dipper", parameters={"gap_rad_m": 0.02}),
            Effect(effect="valve_hysteresis", joint="dipper", parameters={"half_width_ratio": 0.1}),
        ),
        4,
    )
    problem = posed(loaded)
    found = explore(problem, lambda share: None)
    best = max(found, key=lambda h: h.log_evidence[0])
    pairs = [(e.effect, e.joint) for e in best.effects]
    assert ("backlash", "dipper") in pairs
    assert ("valve_hysteresis", "dipper") in pairs


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


def test_a_soft_chassis_is_found_and_a_firm_one_is_not() -> None:
    for effects, is_found in (((SOFT,), True), ((), False)):
        problem = posed(throws(effects, 6))
        singles = large_enough(problem, generation.refined_singles(problem, no_effect(problem)))
        found = [t for t in singles if problem.layout.groups[t.members[0]][0] == SOFT.effect]
        assert bool(found) is is_found
        if found:
            assert beats_none(found[0])
            assert found[0].sizes[0] == pytest.approx(SOFT.parameters["pitch_rad"], rel=0.2)
