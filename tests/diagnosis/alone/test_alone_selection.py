"""Structures against their parts."""

from types import SimpleNamespace

import numpy as np
import pytest

from diagnosis.alone import selection
from diagnosis.alone.fit import Fit
from diagnosis.alone.problem import FreeParameter, Option

LEAST = 0.1
FRICTION = Option(
    "passive_coulomb_friction",
    "passive_coulomb_friction",
    (FreeParameter("extra_coulomb_rad_per_s2", "rad/s2", LEAST, 10.0, (1.0,)),),
)
NAME = f"{FRICTION.key}.{FRICTION.parameters[0].name}"


def fitted(options, values, left):
    """A fit that leaves this much of every sample."""
    names = tuple(values)
    residual = left * np.where(np.arange(400) % 2, 1.0, -1.0)
    return Fit(options, names, np.array(list(values.values())), residual, np.zeros((400, 1)))


@pytest.mark.parametrize(("size", "first"), [(LEAST, ()), (5.0 * LEAST, (FRICTION.effect,))])
def test_at_its_least_size_an_effect_is_never_better_than_without_it(monkeypatch, size, first):
    """It is what the search fell back on: dry friction was named beside the drag that a wide swing had."""
    monkeypatch.setattr(selection, "held_out_mean_square", lambda _, found: found.mean_square)
    monkeypatch.setattr(selection, "_has_idle_effect", lambda *_: False)
    visited = {
        frozenset(): fitted((), {}, 0.3),
        frozenset([FRICTION.key]): fitted((FRICTION,), {NAME: size}, 0.1),
    }
    problem = SimpleNamespace(block=np.arange(400) // 20, noise=0.01, nuisance=())
    ranked, _, _ = selection._posterior(problem, visited, 1.0, 0.002)
    assert ranked[0].effects == first
