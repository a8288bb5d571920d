import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bulk.height_field import OPEN, Container, Rectangle, level_field, make_grid
from bulk.material import MATERIALS, material
from machine.errors import UsageError

GRID = make_grid((0.0, 6.0), (-3.0, 3.0), 0.1)
BED = Container("truck", Rectangle(3.0, 0.0, 3.0, 2.0, 0.3), 1.0, 0.8)
EDGE = st.floats(-0.04, 0.04)


@given(EDGE, EDGE, st.floats(20.0, 45.0))
@settings(max_examples=12, deadline=None)
def test_a_cone_has_the_angle_of_repose_in_every_direction(dx: float, dy: float, repose: float):
    centre = np.array([3.0 + dx, dy])
    field = level_field(GRID).pour(centre[None], 1.5, math.tan(math.radians(repose)))
    x, y = np.meshgrid(GRID.x_m - centre[0], GRID.y_m - centre[1])
    away, azimuth = np.hypot(x, y), np.arctan2(y, x)
    flank = (field.height_m > 0.1) & (away > 0.2)
    for direction in np.linspace(-math.pi, math.pi, 24, endpoint=False):
        turn = np.angle(np.exp(1j * (azimuth - direction)))
        cells = flank & (np.abs(turn) < 0.15)
        slope = -np.polyfit(away[cells], field.height_m[cells], 1)[0]
        assert abs(math.degrees(math.atan(slope)) - repose) < 1.0, math.degrees(direction)


@given(st.lists(st.tuples(st.floats(0.2, 5.8), st.floats(-2.8, 2.8)), min_size=1, max_size=25))
@settings(max_examples=15, deadline=None)
def test_pouring_keeps_the_volume_and_the_floor(points: list[tuple[float, float]]):
    field = level_field(GRID, [BED])
    after = field.pour(np.array(points), 0.3, 0.7)
    assert after.volume_m3() == pytest.approx(0.3 * len(points), rel=1e-9)
    assert (after.height_m >= after.base_m).all()
    assert (field.height_m == field.base_m).all(), "the version before is as it was"


def test_steps_between_cells_of_many_loads_exceed_the_angle_of_repose_by_half_a_cell_at_most():
    rng = np.random.default_rng(3)
    field = level_field(GRID).pour(rng.normal((3.0, 0.0), 0.4, (60, 2)), 0.05, 0.7)
    for axis in (0, 1):
        assert np.abs(np.diff(field.height_m, axis=axis)).max() <= 1.5 * 0.7 * 0.1 + 1e-9


def test_a_container_holds_its_material_until_it_overflows_onto_the_ground():
    field = level_field(GRID, [BED])
    inside = field.inside(0)
    part = field.pour(np.array([[3.0, 0.0]]), 1.0, 0.7)
    assert part.volume_m3(inside) == pytest.approx(1.0)
    full = part.pour(np.tile([[3.0, 0.0]], (40, 1)), 0.3, 0.7)
    outside = full.volume_m3(full.container_index == OPEN)
    assert outside > 1.0
    assert full.volume_m3() == pytest.approx(13.0)
    # What fell over the wall lies on the ground beside it and is no taller than its own pile.
    ground = full.height_m[full.container_index == OPEN]
    assert ground.max() < 1.8


def test_material_beside_a_wall_does_not_pass_it():
    field = level_field(GRID, [BED])
    x_m, y_m = BED.inside.point_m(0.0, 1.4)
    after = field.pour(np.array([[x_m, y_m]]), 0.4, 0.7)
    assert after.volume_m3(after.inside(0)) == 0.0


def test_digging_takes_what_was_asked_or_what_there_is():
    heap = level_field(GRID).pour(np.array([[3.0, 0.0]]), 1.0, 0.7)
    dug = heap.dig(3.0, 0.0, 0.25, 0.7)
    assert dug.volume_m3 == pytest.approx(0.25, rel=1e-9)
    assert dug.field.volume_m3() == pytest.approx(0.75, rel=1e-9)
    assert (dug.field.height_m >= dug.field.base_m).all()
    rest = dug.field.dig(3.0, 0.0, 5.0, 0.7)
    assert rest.volume_m3 == pytest.approx(0.75)
    with pytest.raises(UsageError, match="not on the grid"):
        heap.dig(30.0, 0.0, 0.25, 0.7)


def test_a_container_lies_on_the_grid_and_on_no_other():
    far = Container("box", Rectangle(12.0, 0.0, 2.0, 2.0), 0.0, 1.0)
    with pytest.raises(UsageError, match=r"box does not lie on the survey.*6\.0 m"):
        level_field(GRID, [far])
    with pytest.raises(UsageError, match="overlaps"):
        level_field(GRID, [BED, BED])


def test_materials_have_sources_and_cohesion_lets_cuts_stand_steeper():
    assert all(item.source for item in MATERIALS.values())
    assert material("gravel").cut_slope_ratio(1.0) == pytest.approx(material("gravel").slope_ratio)
    soil = material("soil")
    assert soil.cut_slope_ratio(0.5) > soil.cut_slope_ratio(2.0) > soil.slope_ratio
    assert material("sand").mass_kg(0.25) == pytest.approx(375.0)
    with pytest.raises(UsageError, match="there are basketball, gravel"):
        material("cheese")
