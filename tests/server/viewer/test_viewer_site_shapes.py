import numpy as np
import pytest

from machine.site.objects import SiteObject
from server.viewer import shapes
from tests.server.viewer.test_viewer_shapes import area

PITS = [
    SiteObject(
        name=f"pit {index}",
        kind="pit",
        x_m=x,
        y_m=y,
        turn_rad=turn,
        length_m=3.0,
        width_m=2.0,
        height_m=0.8,
    )
    for index, (x, y, turn) in enumerate([(8.0, -3.0, 0.4), (9.5, -3.5, -1.0), (-20.0, 8.0, 0.0)])
]


def covers(mesh: shapes.Mesh, x_m: float, y_m: float) -> int:
    """How many triangles lie over a point."""
    corners = mesh[0][mesh[1]][..., :2].astype(np.float64) - (x_m, y_m)
    following = np.roll(corners, -1, axis=1)
    turns = corners[..., 0] * following[..., 1] - corners[..., 1] * following[..., 0]
    return int((turns > 0.0).all(axis=1).sum())


def test_the_ground_has_holes_where_pits_are_and_covers_all_else_once() -> None:
    ground = shapes.ground_mesh(400.0, [shapes.site_outline(pit) for pit in PITS])
    for x_m, y_m in np.random.default_rng(3).uniform((4.0, -7.0), (13.0, 0.0), (400, 2)):
        over_pit = any(pit.distance_m(x_m, y_m) == 0.0 for pit in PITS)
        assert covers(ground, x_m, y_m) == (0 if over_pit else 1), (x_m, y_m)
    assert covers(ground, -20.0, 8.0) == 0
    assert area(shapes.ground_mesh(400.0, [])) == pytest.approx(np.pi * 400.0**2, rel=1e-2)


def test_the_top_of_a_mesh_is_the_surface_that_loads_land_on() -> None:
    pile = SiteObject(
        name="pile", kind="pile", x_m=9.0, y_m=1.0, turn_rad=0.5, length_m=5.0, width_m=3.0,
        height_m=0.9, top_ratio=0.3,
    )  # fmt: skip
    box = PITS[0].model_copy(update={"kind": "box", "base_height_m": 0.5})
    for item in (pile, box, PITS[0]):
        vertices, faces = shapes.site_mesh(item)
        assert faces.max() == len(vertices) - 1
        centre = vertices[-1]
        assert centre[2] == pytest.approx(
            item.surface_m(float(centre[0]), float(centre[1])), abs=1e-6
        )
        low, high = shapes.site_rims(item)
        inner = high if item.kind != "pit" else low
        middle = 0.99 * inner + 0.01 * inner.mean(axis=0)
        for x_m, y_m, z_m in middle:
            assert z_m == pytest.approx(item.surface_m(x_m, y_m), abs=0.02)
    assert shapes.site_edges(box).shape == (12, 2, 3)
