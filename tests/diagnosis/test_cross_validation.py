"""The gap closes on held-out throws."""

import numpy as np
import pytest

from diagnosis.correction import with_effects
from diagnosis.cross_validation import Ends, _closed, shrink
from diagnosis.hypotheses.candidate import Throws, evaluate
from diagnosis.hypotheses.gap_problem import GapProblem, pose_problem
from diagnosis.hypotheses.marginal_likelihood import MarginalLikelihood, marginal_likelihood
from diagnosis.hypotheses.ranking import Hypothesis
from diagnosis.linearisation.open_loop import impacts
from diagnosis.linearisation.parameters import layout
from diagnosis.loading.prepared import prepare
from sim_twin.effects.effect import Effect
from sim_twin.twin.profile import load_profile, save_profile
from tests.diagnosis.twin_throws import health, profile, throws

EFFECT = Effect(effect="valve_lag", joint="boom", parameters={"extra_lag_s": 0.12})


@pytest.fixture(scope="module")
def problem() -> GapProblem:
    known = health()
    loaded = throws((EFFECT,), 6)
    plan = layout(known.noise)
    prepared = prepare(loaded.throws, profile())
    return pose_problem(prepared, profile(), loaded.throws[0].calibration, known, plan)


def posed_with(problem: GapProblem, effect: Effect) -> tuple[MarginalLikelihood, Hypothesis]:
    """The throws, and the hypothesis of this effect at its size."""
    likelihood = marginal_likelihood(problem)
    members = (problem.layout.groups.index((effect.effect, effect.joint)),)
    sizes = np.array(list(effect.parameters.values()))
    (found,) = evaluate(Throws(likelihood, likelihood), [(members, sizes)])
    return likelihood, Hypothesis(members, (effect,), found)


def test_held_out_gap_closes_as_predicted(problem: GapProblem) -> None:
    shown = shrink(*posed_with(problem, EFFECT), floor_m=0.03)
    assert shown is not None
    found, measure = shown
    assert measure == "impact"
    assert found.held_out_throws == 6
    assert found.after_m < 0.4 * found.before_m
    assert found.ratio > 0.7
    assert found.ci90[0] <= found.ratio <= found.ci90[1]
    assert found.predicted_ratio == pytest.approx(found.ratio, abs=0.1)
    assert 0.0 < found.removable_ratio <= 1.0


def test_profile_with_the_effect_moves_the_impact_after_a_round_trip(
    problem: GapProblem, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.mktemp("profile") / "next.json"
    save_profile(with_effects(problem.profile, (EFFECT,)), path)
    reloaded = load_profile(path)
    assert reloaded.version_count == problem.profile.version_count + 1
    measured = np.stack([p.throw.impact_m[:2] for p in problem.prepared])
    before, after = (
        measured - impacts(problem.prepared, problem.healthy, one, problem.calibration)
        for one in (problem.profile, reloaded)
    )
    assert np.abs(after).max() < 0.5 * np.abs(before).max()


def test_gap_within_healthy_scatter_is_measured_on_the_channels(problem: GapProblem) -> None:
    shown = shrink(*posed_with(problem, EFFECT), floor_m=10.0)
    assert shown is not None
    found, measure = shown
    assert measure == "channels"
    assert found.ratio > 0.8


def test_a_set_quieter_than_its_type_shows_its_gain() -> None:
    loud_type = Ends(before=0.8, after=0.3, floor=1.0)
    assert _closed(loud_type, least_seen=0.25) == pytest.approx(0.5 / 0.55)
    assert _closed(Ends(before=0.8, after=0.8, floor=1.0), least_seen=0.8) == 0.0
    assert _closed(Ends(before=2.0, after=0.5, floor=1.0), least_seen=0.4) == pytest.approx(0.9375)
    assert _closed(Ends(before=2.0, after=2.5, floor=1.0), least_seen=2.4) == pytest.approx(-0.5)
