"""Previews of a set of throws, and the bounds of its sizes."""

from dataclasses import fields, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from diagnosis.hypotheses.gap_problem import OF_THROWS, GapProblem
from diagnosis.linearisation.parameters import beside, layout
from sim_twin.effects.effect import Effect
from tests.diagnosis.twin_throws import health


def problem(modes: str) -> GapProblem:
    """Throws in these modes, one letter each, with their places instead of what is known of them."""
    places: Any = list(range(len(modes)))
    prepared: Any = [
        SimpleNamespace(place=i, throw=SimpleNamespace(mode=m)) for i, m in enumerate(modes)
    ]
    nothing: Any = None
    whole = GapProblem(**{field.name: nothing for field in fields(GapProblem)})
    return replace(whole, **{**dict.fromkeys(OF_THROWS, places), "prepared": prepared})


def test_a_preview_has_every_other_throw_of_each_mode() -> None:
    for modes, expected in (
        ("232323232323", [0, 1, 4, 5, 8, 9]),
        ("222222333333", [0, 2, 4, 6, 8, 10]),
        ("222222222223", [0, 2, 4, 6, 8, 10, 11]),
        # Few throws are all kept.
        ("22222222", list(range(8))),
        ("23", [0, 1]),
    ):
        preview: Any = problem(modes).preview_subset()
        assert [p.place for p in preview.prepared] == expected, modes
        kept = [getattr(preview, name) for name in OF_THROWS if name != "prepared"]
        assert all(one == expected for one in kept), modes


def test_sizes_beside_what_a_twin_has_keep_the_bounds() -> None:
    plan = layout(health().noise)
    lighter = Effect(effect="payload_mass", parameters={"extra_mass_kg": -0.4})
    place = plan.priors.groups[plan.groups.index(("payload_mass", None))]
    own = beside(plan, (lighter,)).priors
    assert plan.priors.low[place] == -0.5
    assert own.low[place] == pytest.approx(-0.1)
    assert own.high[place] == plan.priors.high[place]
    others = np.delete(np.arange(plan.size_count), place)
    np.testing.assert_array_equal(own.low[others], plan.priors.low[others])
