"""The ground and material of a job as they are drawn."""

import numpy as np
import pytest

from bulk.height_field import level_field, make_grid
from machine.site.objects import SiteKind, SiteObject
from server.jobs.laid_material import laid_material
from server.viewer import shapes
from tests.server.viewer.test_viewer_shapes import area

GRID = make_grid((5.0, 11.0), (-3.0, 3.0), 0.1)
BOX = SiteObject(
    name="box", kind=SiteKind.BOX, x_m=10.0, y_m=2.0, length_m=1.0, width_m=1.0, height_m=1.2
)


def surveyed(depth_m: float):
    x, y = np.meshgrid(GRID.x_m, GRID.y_m)
    trench = (np.abs(x - 8.0) <= 1.0) & (np.abs(y) <= 0.5)
    ground = np.where(trench, -depth_m, 0.0)
    ground[(np.abs(x - BOX.x_m) <= 0.5) & (np.abs(y - BOX.y_m) <= 0.5)] = BOX.height_m
    return level_field(GRID, [], ground)


def test_a_surveyed_trench_takes_the_level_grounds_place():
    drawn = laid_material(surveyed(0.6), objects=[BOX])
    assert drawn.ground is not None and drawn.ground.hole_m is not None
    assert drawn.ground.vertices_m[:, 2].min() == pytest.approx(-0.6)
    assert drawn.ground.vertices_m[:, 2].max() == pytest.approx(0.0)  # the box is drawn by the site
    (x0, y0), (x1, y1) = drawn.ground.hole_m[0], drawn.ground.hole_m[2]
    assert (x0, x1) == pytest.approx((6.9, 9.1)) and (y0, y1) == pytest.approx((-0.6, 0.6))
    assert len(drawn.faces) == 0
    whole = shapes.ground_mesh(30.0, [])
    cut = shapes.ground_mesh(30.0, [drawn.ground.hole_m])
    assert area(whole) - area(cut) == pytest.approx(2.2 * 1.2, rel=1e-3)
    assert area((drawn.ground.vertices_m * (1, 1, 0), drawn.ground.faces)) == pytest.approx(
        2.2 * 1.2
    )


def test_surveyed_ground_above_level_lies_on_it_and_level_ground_is_not_drawn():
    hill = laid_material(surveyed(-0.4), objects=[BOX]).ground
    assert hill is not None and hill.hole_m is None
    assert hill.vertices_m[:, 2].max() == pytest.approx(0.4)
    assert laid_material(surveyed(0.0), objects=[BOX]).ground is None
