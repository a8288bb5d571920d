"""Throws: effects without slopes, and what a healthy machine of another type must not show."""

from pathlib import Path

import pytest

from benchmarks.accuracy.test_search_accuracy import assert_found
from benchmarks.other_plant import Variant
from benchmarks.other_plant import throws as plant_throws
from cli.main import main
from diagnosis.diagnose import diagnose_throws
from diagnosis.hypotheses.candidate import Throws, fitted_effects
from diagnosis.hypotheses.marginal_likelihood import marginal_likelihood
from diagnosis.hypotheses.search import search
from diagnosis.linearisation.unmodelled_effects import (
    UNMODELLED_EFFECTS,
)
from diagnosis.loading.logs import load_throws
from diagnosis.loading.throw_data import LoadedSet
from diagnosis.verdict import VerdictKind
from machine.conventions import Array
from machine.spec import load_spec
from sim_twin.effects.effect import Effect
from sim_twin.twin.profile import nominal_profile
from tests.diagnosis.twin_throws import health, posed, profile, throws

SOFT = Effect(effect="chassis_compliance", joint=None, parameters={"pitch_rad": 0.02})


def named(loaded: LoadedSet) -> dict[tuple[str, str | None], Effect]:
    """The effects of the set with the highest evidence."""
    problem = posed(loaded)
    likelihood = marginal_likelihood(problem)
    best = search(Throws(likelihood, likelihood), lambda share: None)[0]
    effects = fitted_effects(problem.layout, best.members, best.sizes)
    return {(e.effect, e.joint): e for e in effects}


def test_friction_at_rest_and_two_effects_at_once_are_found_at_their_sizes() -> None:
    sticking = {"breakaway_rad_m_per_s": 0.12}
    assert_found(Effect(effect="stiction", joint="dipper", parameters=sticking))
    late = Effect(effect="valve_dead_time", joint="boom", parameters={"extra_dead_time_s": 0.1})
    short = Effect(effect="gripper_length", parameters={"extra_length_m": -0.18})
    assert_found(late, short)


def test_a_second_effect_without_slopes_is_found() -> None:
    backlash = Effect(effect="backlash", joint="dipper", parameters={"gap_rad_m": 0.02})
    play = Effect(effect="valve_hysteresis", joint="dipper", parameters={"half_width_ratio": 0.1})
    assert set(named(throws((backlash, play), 4))) == {
        ("backlash", "dipper"),
        ("valve_hysteresis", "dipper"),
    }


def test_a_soft_chassis_is_found_and_a_firm_one_is_not() -> None:
    (found,) = named(throws((SOFT,), 6)).values()
    assert found.effect == SOFT.effect
    assert found.parameters["pitch_rad"] == pytest.approx(SOFT.parameters["pitch_rad"], rel=0.2)
    assert not named(throws((), 6))


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
    received[:, DIPPER] += 0.4 * valve_ratio[:, TELESCOPE]
    return received


def test_an_effect_outside_the_library_is_unknown_and_described() -> None:
    found = diagnose_throws(throws((), THROWS, received=leaking), profile(), health=health())
    signature = found.evidence["unknown"]
    assert found.verdict is VerdictKind.UNKNOWN
    assert isinstance(signature, dict)
    assert (signature["stage"], signature["joint"]) == ("actuation", "dipper")
    assert signature["looks_like"] == UNMODELLED_EFFECTS["neighbours"].description
