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
        structure_selection, "estimate_held_out_mean_square", lambda _, found: found.mean_square
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
