"""A set of throws seen at a glance."""

from dataclasses import fields, replace
from types import SimpleNamespace
from typing import Any

import pytest

from diagnosis.causes.problem import OF_THROWS, Problem


def problem(modes: str) -> Problem:
    """Throws in these modes, one letter each, with their places instead of what is known of them."""
    places: Any = list(range(len(modes)))
    prepared: Any = [
        SimpleNamespace(place=i, throw=SimpleNamespace(mode=m)) for i, m in enumerate(modes)
    ]
    nothing: Any = None
    whole = Problem(**{field.name: nothing for field in fields(Problem)})
    return replace(whole, **{**dict.fromkeys(OF_THROWS, places), "prepared": prepared})


@pytest.mark.parametrize(
    ("modes", "seen"),
    [
        ("232323232323", [0, 1, 4, 5, 8, 9]),
        ("222222333333", [0, 2, 4, 6, 8, 10]),
        ("222222222223", [0, 2, 4, 6, 8, 10, 11]),
        ("2323232323", [0, 1, 4, 5, 8, 9]),
        ("22222222", list(range(8))),
        ("23", [0, 1]),
    ],
)
def test_every_other_throw_of_each_mode_at_a_glance(modes: str, seen: list[int]) -> None:
    """Alternate throws of both modes would else be throws of one; and few throws are all looked at."""
    glance: Any = problem(modes).at_a_glance()
    assert [p.place for p in glance.prepared] == seen
    assert all(getattr(glance, name) == seen for name in OF_THROWS if name != "prepared")
