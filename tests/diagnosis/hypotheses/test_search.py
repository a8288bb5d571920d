"""Evidence of sets of effects: refined sizes raise it, further effects and unlikely sizes cost it."""

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.hypotheses.candidate import (
    Throws,
    about_healthy_mean,
    evaluate,
    log_prior,
    no_effect,
    refined,
    sizes_by_member,
    with_jumps_at_no_size,
    without_absent_jumps,
)
from diagnosis.hypotheses.marginal_likelihood import marginal_likelihood
from diagnosis.hypotheses.search import search
from sim_twin.effects.effect import Effect
from tests.diagnosis.twin_throws import posed, posed_healthy, throws

LATE = Effect(effect="valve_dead_time", joint="boom", parameters={"extra_dead_time_s": 0.1})


def test_refinement_raises_the_evidence_and_stays_within_bounds() -> None:
    problem = posed(throws((LATE,), 3))
    likelihood = marginal_likelihood(problem)
    asked = Throws(likelihood, likelihood)
    members = (problem.layout.groups.index(("valve_dead_time", "boom")),)
    (far,) = evaluate(asked, [(members, np.array([9.0]))])
    assert far.sizes == problem.layout.priors.high[problem.layout.priors.groups[members[0]]]
    (near,) = refined(asked, [far], 6)
    assert near.log_evidence > far.log_evidence + 10.0
    assert near.sizes[0] == pytest.approx(0.1, abs=0.03)


def test_a_further_effect_and_an_unlikely_size_cost_evidence() -> None:
    problem = posed_healthy(1)
    priors, groups = problem.layout.priors, problem.layout.groups
    one = (groups.index(("gripper_length", None)),)
    two = tuple(sorted((*one, groups.index(("release_delay", None)))))
    small, large = (log_prior(priors, one, np.array([size])) for size in (0.05, 0.25))
    assert small > large
    assert log_prior(priors, (), np.zeros(0)) == 0.0
    sizes = np.full(2, 0.05)
    assert log_prior(priors, two, sizes) < log_prior(priors, one, sizes[:1])
    assert list(sizes_by_member(priors, two, sizes)) == list(two)


def test_a_healthy_deviation_is_simulated_as_the_effect_of_its_size() -> None:
    problem = posed_healthy(3)
    asked = Throws(likelihood := marginal_likelihood(problem), likelihood)
    group = problem.layout.groups.index(("passive_coulomb_friction", None))
    (place,) = problem.layout.priors.groups[group].tolist()
    size = 0.2
    mean = np.zeros(likelihood.covariance.shape[0])
    mean[place] = size
    (none,) = about_healthy_mean(asked, [replace(no_effect(likelihood), healthy_mean=mean)])
    assert none.members == ()
    (effect,) = evaluate(asked, [((group,), np.array([size]))])
    for linear, one, other in zip(problem.linear, none.change, effect.change, strict=True):
        along_slope = size * linear.jacobian[:, place]
        np.testing.assert_allclose(one + along_slope, other, atol=1e-9)
        # Friction that stops a joint has no single slope.
        assert np.abs(one).max() > 0.0


def test_what_a_sticking_joint_gains_at_no_size_is_no_evidence_for_it() -> None:
    problem = posed_healthy(3)
    asked = Throws(likelihood := marginal_likelihood(problem), likelihood)
    groups = problem.layout.groups
    stiction, length = groups.index(("stiction", "slew")), groups.index(("gripper_length", None))
    members = tuple(sorted((stiction, length)))
    sizes = np.array([0.05 if m == stiction else 0.02 for m in members])
    sticking, smooth = evaluate(asked, [(members, sizes), ((length,), np.array([0.02]))])
    assert with_jumps_at_no_size(asked, [smooth]) == []
    (still,) = with_jumps_at_no_size(asked, [sticking])
    without = without_absent_jumps(likelihood, still)
    assert without.members == (length,)
    np.testing.assert_array_equal(without.sizes, [0.02])
    # No further effect: neither its prior odds nor the volume of its size.
    assert without.log_evidence > still.log_evidence
    assert without.covariance.shape == (1, 1)
    assert without.products[0].own.shape == smooth.products[0].own.shape
    assert without_absent_jumps(likelihood, sticking) is sticking


def test_effects_that_look_alike_are_both_simulated_whichever_part_deviates() -> None:
    turned = Effect(effect="base_yaw_drift", parameters={"yaw_rad": 0.08})
    problem = posed(throws((turned,), 6))
    shifts = {part: shift._replace(square=0.0) for part, shift in problem.none_shift.items()}
    levels = dict.fromkeys(problem.none_levels, -5.0)
    problem = replace(problem, none_shift=shifts, none_levels=levels)
    likelihood = marginal_likelihood(problem)
    found = search(Throws(likelihood, likelihood), lambda share: None)
    alone = {problem.layout.groups[c.members[0]] for c in found if len(c.members) == 1}
    assert {("base_yaw_drift", None), ("joint_sensor_bias", "slew")} <= alone
