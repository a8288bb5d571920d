"""Throws: effects without slopes, and what a healthy machine of another type must not show."""

from pathlib import Path

import pytest

from benchmarks.other_plant import Variant
from benchmarks.other_plant import throws as plant_throws
from cli.main import main
from diagnosis.diagnose import diagnose_throws
from diagnosis.hypotheses import generation
from diagnosis.hypotheses.candidates import no_effect
from diagnosis.hypotheses.comparison import beats_none
from diagnosis.hypotheses.exploration import explore
from diagnosis.hypotheses.refinement import large_enough
from diagnosis.linearisation.unmodelled_effects import (
    UNMODELLED_EFFECTS,
)
from diagnosis.loading.logs import load_throws
from diagnosis.verdict import VerdictKind
from machine.conventions import Array
from machine.spec import load_spec
from sim_twin.effects.effect import Effect
from sim_twin.twin.profile import nominal_profile
from tests.diagnosis.twin_throws import health, posed, profile, throws

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


def test_a_soft_chassis_is_found_and_a_firm_one_is_not() -> None:
    for effects, is_found in (((SOFT,), True), ((), False)):
        problem = posed(throws(effects, 6))
        singles = large_enough(problem, generation.refined_singles(problem, no_effect(problem)))
        found = [t for t in singles if problem.layout.groups[t.members[0]][0] == SOFT.effect]
        assert bool(found) is is_found
        if found:
            assert beats_none(found[0])
            assert found[0].sizes[0] == pytest.approx(SOFT.parameters["pitch_rad"], rel=0.2)


def test_a_machine_closer_to_its_twin_than_the_type_has_its_own_model() -> None:
    late = Effect(effect="release_delay", parameters={"extra_delay_s": 0.1})
    found = diagnose_throws(throws((late,), 6), profile())
    assert found.verdict is VerdictKind.EXPLAINED
    assert [e.effect for e in found.causes[0].effects] == ["release_delay"]


def test_a_healthy_machine_of_another_type_has_no_cause(tmp_path: Path) -> None:
    loaded = plant_throws(tmp_path, Variant(), 6)
    found = diagnose_throws(loaded, nominal_profile(load_spec()))
    assert found.verdict is VerdictKind.NONE, found.causes[:2]


THROWS = 6
DIPPER, TELESCOPE = 2, 3


def test_throws_of_one_mode_alone_show_no_effect_of_a_healthy_machine(tmp_path: Path) -> None:
    logs = tmp_path / "logs"
    asked = ["record", "--plant", "virtual", "--mode", "2d", "--throws", "6", "--out", str(logs)]
    assert main(asked) == 0
    loaded = load_throws([logs])
    twin = loaded.throws[0].twin_profile
    assert twin is not None
    assert diagnose_throws(loaded, twin).verdict is VerdictKind.NONE


def leaking(valve_ratio: Array) -> Array:
    """Pilot pressure of the telescope's valve leaks into the dipper's."""
    received = valve_ratio.copy()
    received[:, DIPPER] += 0.2 * valve_ratio[:, TELESCOPE]
    return received


def test_an_effect_outside_the_library_is_unknown_and_described() -> None:
    found = diagnose_throws(throws((), THROWS, received=leaking), profile(), health=health())
    signature = found.evidence["unknown"]
    assert found.verdict is VerdictKind.UNKNOWN
    assert isinstance(signature, dict)
    assert (signature["stage"], signature["joint"]) == ("actuation", "dipper")
    assert signature["looks_like"] == UNMODELLED_EFFECTS["neighbours"].description
