import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from server.viewer_door.pick import (
    MAX_PICK_RANGE_M,
    MIN_GRAZING_RAD,
    PickReason,
    PickRefusedError,
    Ray,
    pick_ground,
)

coordinates = st.floats(-50.0, 50.0)


def ray_to(origin: tuple[float, float, float], point: tuple[float, float, float]) -> Ray:
    return Ray(np.array(origin), np.array(point) - np.array(origin))


@given(
    point=st.tuples(coordinates, coordinates),
    eye=st.tuples(coordinates, coordinates, st.floats(1.0, 60.0)),
    height_m=st.floats(-1.0, 0.9),
    scale=st.floats(0.01, 100.0),
)
def test_a_ray_to_a_point_picks_that_point_or_is_refused_for_its_angle(
    point: tuple[float, float],
    eye: tuple[float, float, float],
    height_m: float,
    scale: float,
) -> None:
    aimed = (*point, height_m)
    ray = ray_to(eye, aimed)
    away_m = math.hypot(eye[0] - point[0], eye[1] - point[1])
    angle = math.atan2(eye[2] - height_m, away_m)
    if abs(angle - MIN_GRAZING_RAD) < 1e-6:
        return
    scaled = Ray(ray.origin_m, ray.direction * scale)
    if angle < MIN_GRAZING_RAD:
        with pytest.raises(PickRefusedError) as refused:
            pick_ground(scaled, height_m)
        assert refused.value.reason is PickReason.GRAZING
    else:
        assert pick_ground(scaled, height_m) == pytest.approx(aimed, abs=1e-6)


@pytest.mark.parametrize(
    ("degrees", "is_refused"), [(4.9, True), (4.999, True), (5.001, False), (5.1, False)]
)
def test_grazing_boundary(degrees: float, is_refused: bool) -> None:
    angle = math.radians(degrees)
    ray = Ray(np.array([0.0, 0.0, 2.0]), np.array([math.cos(angle), 0.0, -math.sin(angle)]))
    if is_refused:
        with pytest.raises(PickRefusedError, match="5 deg needed"):
            pick_ground(ray)
    else:
        assert pick_ground(ray)[0] == pytest.approx(2.0 / math.tan(angle))


@pytest.mark.parametrize(
    ("origin", "direction", "reason"),
    [
        ((0, 0, 5), (1, 0, 0.3), PickReason.SKY),
        ((0, 0, 5), (1, 0, 0.0), PickReason.SKY),
        ((0, 0, -5), (0, 0, -1), PickReason.SKY),
        ((0, 0, 30), (1, 0, -0.3), PickReason.TOO_FAR),
        ((0, 0, 5), (0, 0, 0), PickReason.MALFORMED),
        ((0, 0, 5), (0, math.nan, -1), PickReason.MALFORMED),
        ((math.inf, 0, 5), (0, 0, -1), PickReason.MALFORMED),
    ],
)
def test_clicks_that_give_no_target_say_why(
    origin: tuple[float, float, float], direction: tuple[float, float, float], reason: PickReason
) -> None:
    with pytest.raises(PickRefusedError) as refused:
        pick_ground(Ray(np.array(origin, dtype=float), np.array(direction, dtype=float)))
    assert refused.value.reason is reason
    assert str(refused.value).endswith(".")


def test_the_yard_is_as_wide_as_a_target_message_allows() -> None:
    from machine.messages import Target

    edge = MAX_PICK_RANGE_M
    Target(x_m=edge, y_m=-edge, z_m=0.0)
    assert pick_ground(Ray(np.array([edge, 0.0, 9.0]), np.array([0.0, 0.0, -1.0])))[0] == edge
    with pytest.raises(PickRefusedError):
        pick_ground(Ray(np.array([edge + 0.01, 0.0, 9.0]), np.array([0.0, 0.0, -1.0])))


def test_a_raised_plane_is_met_earlier() -> None:
    ray = Ray(np.array([0.0, 0.0, 4.0]), np.array([1.0, 0.0, -1.0]))
    assert pick_ground(ray, 1.5) == pytest.approx((2.5, 0.0, 1.5))
