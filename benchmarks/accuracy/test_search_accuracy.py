"""Sets of effects are found at their sizes, large ones included, and nothing beside them."""

import pytest

from diagnosis.hypotheses.candidate import CandidateSet, Throws, fitted_effects
from diagnosis.hypotheses.marginal_likelihood import marginal_likelihood
from diagnosis.hypotheses.search import search
from sim_twin.effects.effect import Effect
from tests.cases import each
from tests.diagnosis.twin_throws import posed, throws

SHORT = Effect(effect="gripper_length", parameters={"extra_length_m": -0.18})


def found(*effects: Effect) -> tuple[Throws, list[CandidateSet]]:
    """Throws of a twin with these effects, and the sets that the search finds."""
    problem = posed(throws(effects, 4))
    preview = marginal_likelihood(problem.preview_subset())
    asked = Throws(marginal_likelihood(problem), preview)
    return asked, search(asked, lambda share: None)


def assert_found(*effects: Effect) -> None:
    """These effects and no others are the best set, each at its size."""
    asked, candidates = found(*effects)
    best = candidates[0]
    layout = asked.likelihood.problem.layout
    named = {(e.effect, e.joint): e for e in fitted_effects(layout, best.members, best.sizes)}
    assert set(named) == {(e.effect, e.joint) for e in effects}
    for e in effects:
        own = named[e.effect, e.joint].parameters
        assert own == pytest.approx(dict(e.parameters), rel=0.15)
    assert [c.log_evidence for c in candidates] == sorted(
        (c.log_evidence for c in candidates), reverse=True
    )
    assert any(not c.members for c in candidates), "no effect is always among them"


@each("effects", [(SHORT,), ()])
def test_a_set_is_found_at_its_sizes(effects: tuple[Effect, ...]) -> None:
    assert_found(*effects)
