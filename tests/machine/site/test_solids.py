import math

import numpy as np
import pytest

from machine.conventions import GRAVITY_M_PER_S2
from machine.messages import Target
from machine.site.objects import UNDESCRIBED, SiteKind, SiteObject
from machine.site.solids import Solids, touch_share
from machine.site.touchdown import Touchdown, touchdown
from tests.cases import each

RADIUS_M = 0.12
BED = SiteObject(
    name="bed", kind=SiteKind.BOX, x_m=9.0, y_m=0.0, length_m=2.0, width_m=4.0, height_m=1.2
)
PIT = SiteObject(
    name="pit", kind=SiteKind.PIT, x_m=9.0, y_m=0.0, length_m=2.0, width_m=2.0, height_m=0.8
)
PILE = SiteObject(
    name="pile", kind=SiteKind.PILE, x_m=9.0, y_m=0.0, length_m=4.0, width_m=2.0, height_m=0.9
)


def fall(solids: Solids, speed_m_per_s: tuple[float, float, float], x_m: float = 3.0) -> Touchdown:
    """One load in a vacuum from 4 m above (x, 0)."""
    position = np.array([[x_m, 0.0, 4.0]])
    velocity = np.array([speed_m_per_s])
    return touchdown(solids, RADIUS_M, position, velocity, np.zeros(1), np.zeros((1, 3)))


def test_a_load_lands_on_the_ground_where_the_parabola_says():
    end = fall(Solids(), (6.0, 0.5, 2.0))
    height, up = 4.0 - RADIUS_M, 2.0
    time_s = (up + math.sqrt(up**2 + 2 * GRAVITY_M_PER_S2 * height)) / GRAVITY_M_PER_S2
    assert end.time_s[0] == pytest.approx(time_s, abs=1e-6)
    np.testing.assert_allclose(
        end.contact.point_m[0], [3.0 + 6.0 * time_s, 0.5 * time_s, 0.0], atol=1e-5
    )
    assert (end.contact.solid[0], bool(end.contact.is_side[0])) == (0, False)


def test_a_load_lands_on_the_bed_at_its_height():
    end = fall(Solids([BED]), (5.2, 0.0, 2.0))
    assert end.contact.point_m[0, 2] == pytest.approx(1.2, abs=1e-6)
    assert (end.contact.solid[0], bool(end.contact.is_side[0])) == (1, False)
    assert end.centre_m[0, 2] == pytest.approx(1.2 + RADIUS_M, abs=1e-6)


def test_a_flat_throw_hits_the_side_of_the_bed_before_it():
    end = fall(Solids([BED]), (7.0, 0.0, -1.0))
    assert end.contact.point_m[0, 0] == pytest.approx(8.0, abs=1e-6)
    assert 0.0 < end.contact.point_m[0, 2] < 1.2
    assert bool(end.contact.is_side[0])


def test_a_load_flies_over_a_wall_and_under_a_platform():
    wall = SiteObject(
        name="wall", kind="box", x_m=6.0, y_m=0.0, length_m=0.2, width_m=4.0, height_m=2.0
    )
    assert fall(Solids([wall]), (6.0, 0.0, 2.0)).contact.solid[0] == 0
    assert fall(Solids([wall]), (5.0, 0.0, -4.0)).contact.solid[0] == 1
    platform = BED.model_copy(update={"base_height_m": 2.0})
    under = fall(Solids([platform]), (8.0, 0.0, -1.0))
    assert under.contact.solid[0] == 0


def test_a_load_falls_to_the_floor_of_the_pit_or_meets_its_far_wall():
    end = fall(Solids([PIT]), (5.0, 0.0, 2.0))
    assert end.contact.point_m[0, 2] == pytest.approx(-0.8, abs=1e-6)
    assert (end.contact.solid[0], bool(end.contact.is_side[0])) == (1, False)
    wall = fall(Solids([PIT]), (5.85, 0.0, 2.0))
    assert wall.contact.point_m[0, 0] == pytest.approx(10.0, abs=1e-6)
    assert (wall.contact.solid[0], bool(wall.contact.is_side[0])) == (1, True)


def test_a_load_lies_on_the_slope_of_a_pile():
    end = fall(Solids([PILE]), (4.9, 0.0, 2.0))
    x_m, _, z_m = end.contact.point_m[0]
    assert z_m == pytest.approx(PILE.surface_m(x_m, 0.0), abs=0.005)
    assert 0.3 < z_m < 0.9
    assert not end.contact.is_side[0]


def test_loads_that_do_not_fly_end_nowhere():
    position = np.array([[np.nan] * 3, [3.0, 0.0, 4.0]])
    velocity = np.array([[np.nan] * 3, [4.0, 0.0, 0.0]])
    end = touchdown(Solids([BED]), RADIUS_M, position, velocity, np.zeros(2), np.zeros((2, 3)))
    assert end.contact.solid.tolist() == [-1, 0]
    assert np.isnan(end.time_s).tolist() == [True, False]


@each(
    ("target", "name", "ground_m"),
    [
        (Target(x_m=9.0, y_m=0.0, z_m=1.2), "bed", 0.0),
        (Target(x_m=9.0, y_m=0.0, z_m=1.23), "bed", 0.0),
        (Target(x_m=7.0, y_m=0.0, z_m=0.0), "ground", 0.0),
        (Target(x_m=7.0, y_m=0.0, z_m=0.5), UNDESCRIBED, 0.5),
        (Target(x_m=7.0, y_m=0.0, z_m=-0.5), UNDESCRIBED, -0.5),
    ],
)
def test_a_target_lies_on_what_is_described_or_on_ground_of_its_height(target, name, ground_m):
    solids = Solids.around([BED], target)
    assert (solids.name_at(target), solids.ground_m) == (name, ground_m)


def test_over_a_pit_there_is_no_ground():
    solids = Solids([PIT])
    assert solids.name_at(Target(x_m=9.0, y_m=0.0, z_m=0.0)) is None
    assert solids.name_at(Target(x_m=9.0, y_m=0.0, z_m=-0.8)) == "pit"


def test_raised_ground_that_nobody_described_is_met_from_above_only():
    solids = Solids([], ground_m=3.0)
    assert fall(solids, (4.0, 0.0, 2.0)).contact.point_m[0, 2] == pytest.approx(3.0, abs=1e-6)
    position, velocity = np.array([[3.0, 0.0, 2.5]]), np.array([[4.0, 0.0, 1.0]])
    low = touchdown(solids, RADIUS_M, position, velocity, np.zeros(1), np.zeros((1, 3)))
    assert low.contact.point_m[0, 2] == pytest.approx(0.0, abs=0.1)


@each("item", [BED, PIT, PILE, BED.model_copy(update={"turn_rad": 0.7})])
def test_distances_grow_by_a_metre_a_metre_and_vanish_on_the_surface(item):
    solids = Solids([item])
    rng = np.random.default_rng(1)
    points = rng.uniform([7.0, -3.0, 0.0], [11.0, 3.0, 3.0], (4000, 3))
    step = rng.standard_normal((4000, 3))
    step *= 0.02 / np.linalg.norm(step, axis=1, keepdims=True)
    change = np.abs(solids.distance(points + step) - solids.distance(points))
    assert change.max() < (0.02 if item is not PILE else 0.04) + 1e-9
    tops = [(x, y, item.surface_m(x, y)) for x, y, _ in points if item.surface_m(x, y) is not None]
    assert len(tops) > 100
    np.testing.assert_allclose(solids.distance(np.array(tops)), 0.0, atol=1e-9)


def test_touch_share_finds_where_gaps_close():
    np.testing.assert_allclose(
        touch_share(lambda u: np.array([0.3, 0.75]) - u, 2), [0.3, 0.75], atol=1e-6
    )
