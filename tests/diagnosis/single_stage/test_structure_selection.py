"""Scores of structures against simpler ones."""

from types import SimpleNamespace

import numpy as np
import pytest

from diagnosis.single_stage import structure_selection
from diagnosis.single_stage.fit import StructureFit
from diagnosis.single_stage.fit_problem import EffectOption, FreeParameter

MIN_FRICTION = 0.1
FRICTION = EffectOption(
    "passive_coulomb_friction",
    "passive_coulomb_friction",
    (FreeParameter("extra_coulomb_rad_per_s2", "rad/s2", MIN_FRICTION, 10.0, (1.0,)),),
)
NAME = f"{FRICTION.key}.{FRICTION.parameters[0].name}"


def make_fit(
    options: tuple[EffectOption, ...], values: dict[str, float], residual_size: float
) -> StructureFit:
    residual = residual_size * np.where(np.arange(400) % 2, 1.0, -1.0)
    return StructureFit(
        options, tuple(values), np.array(list(values.values())), residual, np.zeros((400, 1))
    )


def test_an_effect_at_its_smallest_magnitude_is_not_preferred(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(
        structure_selection, "estimate_held_out_squares", lambda _, found: found.residual**2
    )
    monkeypatch.setattr(structure_selection, "_has_insignificant_effect", lambda *_: False)
    problem = SimpleNamespace(block=np.arange(400) // 20, noise=0.01, nuisance=())
    for size, best in ((MIN_FRICTION, ()), (5.0 * MIN_FRICTION, (FRICTION.effect,))):
        visited = {
            frozenset(): make_fit((), {}, 0.3),
            frozenset([FRICTION.key]): make_fit((FRICTION,), {NAME: size}, 0.1),
        }
        ranked, _, _ = structure_selection._rank_structures(problem, visited, 1.0, 0.002)
        assert ranked[0].effects == best


@pytest.mark.parametrize(
    ("worse_on_each", "noise", "is_possible"),
    [
        (0.02 * np.ones(20), 0.01, False),
        (0.4 * (np.arange(20) == 3), 0.01, True),
        (0.4 * (np.arange(20) == 3), 0.1, False),
        (-0.1 * (np.arange(20) == 3), 0.1, True),
    ],
    ids=["worse on every block", "worse on one block", "only noise is left", "no worse in noise"],
)
def test_a_rival_stays_possible_until_held_out_blocks_agree(
    worse_on_each: np.ndarray, noise: float, is_possible: bool
) -> None:
    drift, by_position = (
        EffectOption(name, name, (FreeParameter("ratio", "1", 0.0, 1.0, (0.5,)),))
        for name in ("speed_drift", "speed_by_position")
    )
    fit = make_fit((drift,), {}, 0.1)
    best = structure_selection.ScoredStructure(fit, 0.01, np.full(20, 0.2), 0.0, 0.99)
    rival_fit = make_fit((by_position,), {}, 0.1)
    rival = structure_selection.ScoredStructure(rival_fit, 0.011, 0.2 + worse_on_each, -20.0, 1e-4)
    padded_fit = make_fit((by_position, FRICTION), {}, 0.1)
    padded = structure_selection.ScoredStructure(padded_fit, 0.011, rival.squares, -25.0, 1e-5)
    selection = structure_selection.Selection((best, rival, padded), best, 1.0, 1.0, noise, 0.0)
    assert selection.is_possible(rival) is is_possible
    assert not selection.is_possible(padded)


@pytest.mark.parametrize(("half_width", "is_doubtful"), [(0.3, False), (1.0, True)])
def test_an_effect_whose_size_may_be_zero_is_doubtful_however_sure_its_time_is(
    monkeypatch: pytest.MonkeyPatch, half_width: float, is_doubtful: bool
) -> None:
    change = FreeParameter("change_ratio", "1", -0.95, 2.0, (-0.2,))
    middle = FreeParameter("middle_ratio", "1", 0.02, 0.98, (0.5,), is_absent_at_low=False)
    drift = EffectOption("speed_drift", "speed_drift", (change, middle))
    fit = make_fit((drift,), {"speed_drift.change_ratio": 0.7, "speed_drift.middle_ratio": 0.5}, 1)
    best = structure_selection.ScoredStructure(fit, 1.0, np.ones(20), 0.0, 1.0)
    selection = structure_selection.Selection((best,), best, 1.0, 1.0, 1.0, 0.0)
    half = np.array([half_width, 0.01])
    intervals = {
        name: (value - h, value + h)
        for name, value, h in zip(fit.names, fit.values, half, strict=True)
    }
    monkeypatch.setattr(structure_selection, "parameter_intervals", lambda *_: intervals)
    monkeypatch.setattr(structure_selection, "estimate_standard_errors", lambda *_: half)
    monkeypatch.setattr(structure_selection, "interval_half_width_factor", lambda _: 1.0)
    problem = SimpleNamespace(block=np.arange(400) // 20)
    found = structure_selection.find_doubtful_effects(problem, selection)
    assert found == ({"speed_drift"} if is_doubtful else set())
    assert structure_selection._has_insignificant_effect(problem, fit, 1.0) is is_doubtful
