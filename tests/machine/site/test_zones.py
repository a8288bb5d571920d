"""Zones: which shapes are zones, and what names a set."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import TypeAdapter, ValidationError
from shapely.geometry import Polygon

from machine.site.zones import Zone, Zones, ZoneSet, zones_sha256
from tests.cases import each

SQUARE = ((4.0, 1.0), (6.0, 1.0), (6.0, 3.0), (4.0, 3.0))


def zone(corners=SQUARE, **changes):
    values = {"name": "Office", "reason": "people work there", "top_m": 3.0}
    return Zone(corners_m=corners, **{**values, **changes})


def test_a_zone_stands_on_the_ground_unless_it_says_else():
    assert (zone().bottom_m, zone(bottom_m=2.0).bottom_m) == (0.0, 2.0)


@each(
    ("changes", "words"),
    [
        ({"corners": ((0.0, 0.0), (1.0, 0.0))}, "at least 3"),
        ({"corners": ((0.0, 0.0), (2.0, 2.0), (2.0, 0.0), (0.0, 2.0))}, "crosses or touches"),
        ({"corners": ((0.0, 0.0), (1.0, 0.0), (2.0, 0.0))}, "crosses or touches|on a line"),
        ({"corners": ((0.0, 0.0), (1.0, 0.0), (1.0, 0.0), (0.0, 1.0))}, "crosses or touches"),
        ({"corners": ((0.0, 0.0), (0.01, 0.0), (0.0, 0.01))}, "on a line"),
        ({"corners": ((0.0, 0.0), (61.0, 0.0), (0.0, 1.0))}, "less than or equal to 60"),
        ({"corners": ((0.0, 0.0), (math.nan, 0.0), (0.0, 1.0))}, "finite"),
        ({"top_m": 0.05}, "above its bottom"),
        ({"bottom_m": 3.0}, "above its bottom"),
        ({"name": " Office"}, "pattern"),
        ({"reason": "   "}, "pattern"),
    ],
)
def test_what_is_no_zone_is_refused_in_words(changes, words):
    with pytest.raises(ValidationError, match=words):
        zone(**changes)


@given(
    st.lists(st.tuples(st.integers(-4, 4), st.integers(-4, 4)), min_size=3, max_size=7, unique=True)
)
def test_polygons_are_simple_as_another_library_says(corners):
    known = Polygon(corners)
    corners_m = tuple((float(x), float(y)) for x, y in corners)
    try:
        zone(corners_m)
        is_zone = True
    except ValidationError:
        is_zone = False
    assert is_zone == (known.is_valid and known.area >= 0.01)


def test_names_are_given_once():
    with pytest.raises(ValidationError, match="two zones are named 'office'"):
        TypeAdapter(Zones).validate_python([zone(), zone(name="OFFICE")])


def test_a_set_is_named_by_what_it_says():
    one, other = zone(), zone(top_m=3.5)
    assert zones_sha256(()) == ZoneSet(version_count=7).sha256 == ""
    assert len({zones_sha256(s) for s in ((one,), (other,), (one, zone(name="x")))}) == 3
    read = ZoneSet.model_validate_json(ZoneSet(version_count=1, zones=(one,)).model_dump_json())
    assert read.sha256 == zones_sha256((one,))
