import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from machine.messages import LandingEllipse
from server.viewer import shapes
from server.viewer.theme import VIEWPOINTS
from tests.cases import each

radii = st.floats(0.5, 60.0)
points = st.tuples(st.floats(-20.0, 20.0), st.floats(-20.0, 20.0), st.floats(-1.0, 3.0))


def area(mesh: shapes.Mesh) -> float:
    """Signed area seen from above, m2; positive for faces that look up."""
    corners = mesh[0][mesh[1]][..., :2].astype(np.float64)
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return float(0.5 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum())


@given(radius=radii)
def test_rings_lie_on_their_radius(radius: float) -> None:
    for segments in (shapes.polyline(shapes.circle(radius)), shapes.dashed_circle(radius)):
        assert segments.shape[1:] == (2, 3)
        np.testing.assert_allclose(np.linalg.norm(segments, axis=-1), radius, rtol=1e-9)


@given(radius=radii)
def test_a_dashed_ring_is_half_drawn(radius: float) -> None:
    segments = shapes.dashed_circle(radius)
    drawn = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=-1).sum()
    assert drawn == pytest.approx(math.pi * radius, rel=0.02)


@given(inner=radii, width=radii)
def test_flat_shapes_face_up_and_cover_their_area(inner: float, width: float) -> None:
    outer = inner + width
    assert area(shapes.annulus(inner, outer)) == pytest.approx(
        math.pi * (outer**2 - inner**2), rel=2e-3
    )
    assert area(shapes.disc(inner)) == pytest.approx(math.pi * inner**2, rel=2e-3)


ellipses = st.builds(
    LandingEllipse,
    mean_downrange_error_m=st.floats(-1.0, 1.0),
    mean_crossrange_error_m=st.floats(-1.0, 1.0),
    sd_downrange_m=st.floats(0.01, 2.0),
    sd_crossrange_m=st.floats(0.01, 2.0),
    correlation_ratio=st.floats(-0.95, 0.95),
    rollout_count=st.just(200),
    landed_count=st.just(200),
)


@given(ellipse=ellipses, target=points, sigma=st.sampled_from([1.0, 2.0]))
def test_the_ellipse_is_one_mahalanobis_distance_from_its_mean(
    ellipse: LandingEllipse, target: tuple[float, float, float], sigma: float
) -> None:
    outline = shapes.landing_ellipse(ellipse, target, sigma)
    bearing = math.atan2(target[1], target[0])
    offset = outline[:, :2] - np.array(target[:2])
    downrange = offset @ np.array([math.cos(bearing), math.sin(bearing)])
    crossrange = offset @ np.array([-math.sin(bearing), math.cos(bearing)])
    x = (downrange - ellipse.mean_downrange_error_m) / ellipse.sd_downrange_m
    y = (crossrange - ellipse.mean_crossrange_error_m) / ellipse.sd_crossrange_m
    r = ellipse.correlation_ratio
    squared = (x * x - 2.0 * r * x * y + y * y) / (1.0 - r * r)
    np.testing.assert_allclose(squared, sigma**2, rtol=1e-5)
    np.testing.assert_allclose(outline[:, 2], target[2])


def test_a_throw_along_y_spreads_downrange_along_y() -> None:
    ellipse = LandingEllipse(
        mean_downrange_error_m=0.5,
        mean_crossrange_error_m=0.0,
        sd_downrange_m=1.0,
        sd_crossrange_m=0.1,
        correlation_ratio=0.0,
        rollout_count=10,
        landed_count=10,
    )
    outline = shapes.landing_ellipse(ellipse, (0.0, 9.0, 0.0), 1.0)
    assert np.ptp(outline[:, 1]) == pytest.approx(2.0, rel=1e-2)
    assert np.ptp(outline[:, 0]) == pytest.approx(0.2, rel=1e-2)
    assert outline[:-1, 1].mean() == pytest.approx(9.5, abs=1e-6)


@given(points=st.lists(points, min_size=1, max_size=5), half=st.floats(0.01, 0.5))
def test_crosses_are_centred_on_their_points(
    points: list[tuple[float, float, float]], half: float
) -> None:
    segments = shapes.crosses(np.array(points), half)
    assert segments.shape == (2 * len(points), 2, 3)
    np.testing.assert_allclose(segments.mean(axis=1)[::2], points, atol=1e-9)
    np.testing.assert_allclose(segments.mean(axis=1)[1::2], points, atol=1e-9)


@each(
    ("target", "text"),
    [
        ((9.0, 0.0, 0.0), "9.00 m, ahead"),
        ((8.0, 1.0, 0.0), "8.06 m, 7.1° left"),
        ((0.0, -7.5, 0.0), "7.50 m, 90.0° right"),
        ((6.0, 0.0, 1.2), "6.00 m, ahead, +1.20 m high"),
        ((6.0, 0.0, -0.5), "6.00 m, ahead, 0.50 m deep"),
    ],
)
def test_range_and_bearing_in_words(target: tuple[float, float, float], text: str) -> None:
    assert shapes.range_label(target) == text


def test_a_rising_ring_leaves_the_ground_outwards() -> None:
    vertices, faces = shapes.rising_annulus(10.0, 400.0, 0.005)
    flat, same_faces = shapes.annulus(10.0, 400.0)
    np.testing.assert_array_equal(vertices[:, :2], flat[:, :2])
    np.testing.assert_array_equal(faces, same_faces)
    assert sorted({round(float(z), 3) for z in vertices[:, 2]}) == [0.0, 1.95]


@each("aspect", [0.3, 0.73, 0.99])
def test_a_narrow_picture_shows_as_much_from_left_to_right(aspect: float) -> None:
    for view in VIEWPOINTS.values():
        whole = math.tan(0.5 * view.fov_rad) * view.whole_aspect_ratio
        assert math.tan(0.5 * view.fov_of(aspect)) * max(aspect, 0.5) == pytest.approx(whole)
        assert view.fov_of(1.7) == pytest.approx(view.fov_rad)
        assert view.fov_of(aspect) < 2.0
