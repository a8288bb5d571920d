import math

import pytest
from pydantic import TypeAdapter, ValidationError

from machine.messages import Target
from machine.site.job_surface import JOB_SURFACE, with_job_surface
from machine.site.objects import SWING_CIRCLE_M, SiteKind, SiteObject, SiteObjects
from machine.site.solids import Solids
from machine.spec import load_spec
from tests.cases import each

SITE = TypeAdapter(SiteObjects)
BED = {
    "name": "truck bed",
    "kind": "box",
    "x_m": 9.0,
    "y_m": 1.0,
    "length_m": 4.0,
    "width_m": 2.0,
    "height_m": 1.2,
}


@each(
    ("change", "words"),
    [
        ({"x_m": 2.0, "y_m": 0.0}, "the machine turns there"),
        ({"length_m": 40.0}, "less than or equal to 30"),
        ({"height_m": 0.0}, "greater than or equal to 0.1"),
        ({"kind": "pit"}, "at most 1.00 m deep, not 1.20 m"),
        ({"kind": "pile"}, "steeper than 45 deg"),
        ({"kind": "pit", "height_m": 0.5, "base_height_m": 0.2}, "only a box"),
        ({"top_ratio": 0.5}, "only a pile"),
        ({"name": "Ground"}, "cannot be named"),
        ({"name": " "}, "pattern"),
        ({"x_m": float("nan")}, "finite"),
        ({"colour": "red"}, "not permitted"),
    ],
)
def test_what_cannot_stand_there_is_refused_with_its_number(change, words):
    with pytest.raises(ValidationError, match=words):
        SiteObject.model_validate(BED | change)


def test_every_name_once_and_no_more_objects_than_can_be_looked_at():
    with pytest.raises(ValidationError, match="two objects are named 'truck bed'"):
        SITE.validate_python([BED, BED | {"name": "Truck bed", "x_m": 20.0}])
    many = [BED | {"name": f"box {i}"} for i in range(33)]
    with pytest.raises(ValidationError, match="at most 32"):
        SITE.validate_python(many)


def test_the_swing_circle_covers_the_chassis_and_the_tail_of_the_carriage():
    shapes = {s.name: s for s in load_spec().collision_shapes}
    boxes = [shapes[name] for name in ("chassis_obstacle", "upper_obstacle")]
    far = max(
        math.hypot(abs(s.position_m[0]) + s.size_m[0], abs(s.position_m[1]) + s.size_m[1])
        for s in boxes
    )
    assert far < SWING_CIRCLE_M < far + 0.2


def test_surfaces_of_a_turned_box_a_pit_and_a_pile():
    bed = SiteObject.model_validate(BED | {"turn_rad": math.pi / 2})
    assert bed.surface_m(9.0, 2.9) == pytest.approx(1.2)  # its length lies along y now
    assert bed.surface_m(10.1, 1.0) is None
    pit = SiteObject.model_validate(BED | {"kind": "pit", "height_m": 0.8})
    assert pit.surface_m(9.0, 1.0) == pytest.approx(-0.8)
    pile = SiteObject(
        name="pile",
        kind=SiteKind.PILE,
        x_m=9.0,
        y_m=0.0,
        length_m=4.0,
        width_m=4.0,
        height_m=1.0,
        top_ratio=0.5,
    )
    assert pile.surface_m(9.5, 0.0) == pytest.approx(1.0)
    assert pile.surface_m(10.5, 0.0) == pytest.approx(0.5)
    assert pile.surface_m(11.1, 0.0) is None
    assert math.degrees(pile.slope_rad) == pytest.approx(45.0)


@each(
    ("changes", "surface_m", "name"),
    [
        ([{}], 1.87, "truck bed"),
        ([{}], 1.22, "truck bed"),
        ([{"kind": "pit", "height_m": 0.8}], -0.33, "truck bed"),
        ([{"kind": "pit", "height_m": 0.8}], -0.08, "truck bed"),
        ([{"kind": "pit", "height_m": 0.8}], 0.03, "ground"),
        ([{"kind": "pit", "height_m": 0.8}], 0.07, "truck bed"),
        ([{"x_m": 12.0, "y_m": 3.0}], 0.06, JOB_SURFACE),
        ([{"x_m": 12.0, "y_m": 3.0}], 0.9, JOB_SURFACE),
        ([{"kind": "pile", "height_m": 0.5}], 1.0, JOB_SURFACE),
    ],
)
def test_the_surface_of_a_job_stands_for_what_lies_on_an_object_or_beside_it(
    changes, surface_m, name
):
    objects = SITE.validate_python([BED | change for change in changes])
    around = with_job_surface(objects, 9.1, 0.9, surface_m)
    target = Target(x_m=9.1, y_m=0.9, z_m=surface_m)
    assert Solids(around).name_at(target) == name
    away = Target(x_m=20.0, y_m=0.0, z_m=0.0)
    assert Solids(around).name_at(away) == "ground"


@each(
    ("objects", "x_m", "surface_m"),
    [
        ((BED,), 9.1, 6.5),
        ((BED | {"x_m": 30.0},), 9.1, -0.4),
        ((BED | {"x_m": 30.0},), 3.5, 0.5),
        ([BED | {"name": f"box {i}", "x_m": 30.0} for i in range(32)], 9.1, 0.9),
        ((BED | {"x_m": 30.0, "name": JOB_SURFACE},), 9.1, 0.9),
    ],
)
def test_a_surface_for_which_no_object_can_stand_leaves_the_site_as_it_is(objects, x_m, surface_m):
    site = SITE.validate_python(objects)
    assert with_job_surface(site, x_m, 0.9, surface_m) == site
