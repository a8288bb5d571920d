"""Effects outside the library are called unknown, with a description."""

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from diagnosis.hypotheses import generation
from diagnosis.hypotheses.candidates import evaluate, no_effect
from diagnosis.hypotheses.comparison import CandidateSet
from diagnosis.hypotheses.exploration import Hypothesis
from diagnosis.hypotheses.gap_problem import GapProblem
from diagnosis.hypotheses.generation import with_unmodelled_effects
from diagnosis.hypotheses.ranking import Ranked, unknown_levels
from diagnosis.linearisation.unmodelled_effects import (
    UNMODELLED,
)
from machine.conventions import ACTIVE_JOINTS
from sim_twin.effects.effect import Effect
from tests.diagnosis.twin_throws import posed, throws

THROWS = 6


def shapes_of(problem: GapProblem, *candidates: CandidateSet) -> set[tuple[str, str | None]]:
    """Shapes that are weighed, alone or beside what trials have."""
    return {problem.layout.groups[m[-1]] for _, m in with_unmodelled_effects(problem, candidates)}


def dipper_effect(effect: str, size: float) -> Effect:
    sizes = {"positive_ratio": size, "negative_ratio": size}
    return Effect(effect=effect, joint="dipper", parameters=sizes)


def test_what_a_library_effect_explains_is_not_unmodelled(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = posed(throws((dipper_effect("valve_gain", 0.15),), THROWS))
    like_a_gain = {(f"{UNMODELLED}:way", "dipper"), (f"{UNMODELLED}:command", "dipper")}
    assert not shapes_of(problem, no_effect(problem)) & like_a_gain
    monkeypatch.setattr(generation, "LEAST_OWN_LOG_EVIDENCE", 0.0)
    assert shapes_of(problem, no_effect(problem)) >= like_a_gain


def test_metering_beside_a_dead_band_is_model_error(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = posed(throws((dipper_effect("valve_dead_band", 0.1),), 3))
    group = problem.layout.groups.index(("valve_dead_band", "dipper"))
    candidate = evaluate(problem, {(group,): np.array([0.1, 0.1])})[0]
    monkeypatch.setattr(generation, "LEAST_OWN_LOG_EVIDENCE", -1.0)
    monkeypatch.setattr(generation, "local_evidence", lambda _: -np.inf)
    monkeypatch.setattr(generation, "UNMODELLED_COUNT", 100)
    everywhere = {(f"{UNMODELLED}:command", joint) for joint in ACTIVE_JOINTS}
    assert everywhere - shapes_of(problem, candidate) == {(f"{UNMODELLED}:command", "dipper")}
    assert everywhere <= shapes_of(problem, no_effect(problem))


def test_no_effect_has_no_model_error() -> None:
    block = "actuation.dipper"
    problem = cast(
        "GapProblem",
        SimpleNamespace(
            model=SimpleNamespace(unknown_level={block: (0.0, 0.1)}), none_levels={block: 1.6}
        ),
    )
    none, found = (
        cast("Hypothesis", SimpleNamespace(members=members, effects=(), levels={block: 0.3}))
        for members in ((), (4,))
    )
    assert unknown_levels(problem, none, none)[block] == pytest.approx(16.0)
    assert unknown_levels(problem, found, none)[block] == pytest.approx(3.0)


def test_two_rivals_together_are_compared_with_unknown():
    one, other = (SimpleNamespace(members=(m,)) for m in (1, 2))
    kept = {
        "hypotheses": [one, other],
        "probability": np.array([0.30, 0.28]),
        "unknown": 0.37,
        "shape": None,
        "ahead": 0.0,
        "levels": {},
        "jitter": None,
        "jitter_probability": 0.0,
        "rival_log_odds": 0.0,
    }
    assert not Ranked(**kept, rival=other).is_unknown
    assert Ranked(**kept, rival=None).is_unknown
