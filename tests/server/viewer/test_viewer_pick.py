import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from machine.site.objects import SiteObject
from server.viewer.pick import (
    MAX_PICK_RANGE_M,
    MIN_GRAZING_RAD,
    PickReason,
    PickRefusedError,
    Ray,
    pick_ground,
    pick_surface,
)
from tests.cases import each

coordinates = st.floats(-50.0, 50.0)


def ray_to(origin: tuple[float, float, float], point: tuple[float, float, float]) -> Ray:
    return Ray(np.array(origin), np.array(point) - np.array(origin))


@given(
    point=st.tuples(coordinates, coordinates),
    eye=st.tuples(coordinates, coordinates, st.floats(1.0, 60.0)),
    scale=st.floats(0.01, 100.0),
)
def test_a_ray_to_a_point_picks_that_point_or_is_refused_for_its_angle(
    point: tuple[float, float],
    eye: tuple[float, float, float],
    scale: float,
) -> None:
    aimed = (*point, 0.0)
    ray = ray_to(eye, aimed)
    away_m = math.hypot(eye[0] - point[0], eye[1] - point[1])
    angle = math.atan2(eye[2], away_m)
    if abs(angle - MIN_GRAZING_RAD) < 1e-6:
        return
    scaled = Ray(ray.origin_m, ray.direction * scale)
    if angle < MIN_GRAZING_RAD:
        with pytest.raises(PickRefusedError) as refused:
            pick_ground(scaled)
        assert refused.value.reason is PickReason.GRAZING
    else:
        assert pick_ground(scaled) == pytest.approx(aimed, abs=1e-6)


@each(("degrees", "is_refused"), [(4.9, True), (4.999, True), (5.001, False), (5.1, False)])
def test_grazing_boundary(degrees: float, is_refused: bool) -> None:
    angle = math.radians(degrees)
    ray = Ray(np.array([0.0, 0.0, 2.0]), np.array([math.cos(angle), 0.0, -math.sin(angle)]))
    if is_refused:
        with pytest.raises(PickRefusedError, match="5 deg needed"):
            pick_ground(ray)
    else:
        assert pick_ground(ray)[0] == pytest.approx(2.0 / math.tan(angle))


@each(
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


BED = SiteObject(name="bed", kind="box", x_m=9.0, y_m=0.0, length_m=2.0, width_m=4.0, height_m=1.2)
PIT = SiteObject(name="pit", kind="pit", x_m=9.0, y_m=0.0, length_m=2.0, width_m=2.0, height_m=0.8)
PILE = SiteObject(
    name="pile", kind="pile", x_m=9.0, y_m=0.0, length_m=4.0, width_m=4.0, height_m=1.0
)
EYE = (3.5, -14.0, 9.2)


@each(
    ("item", "point"),
    [
        (BED, (8.4, 1.3, 1.2)),
        (PIT, (8.6, 0.5, -0.8)),
        (PILE, (9.0, -1.0, 0.5)),
        (BED, (6.0, 3.0, 0.0)),
        (PIT, (6.0, 3.0, 0.0)),
    ],
)
def test_a_click_picks_the_surface_that_is_seen(
    item: SiteObject, point: tuple[float, float, float]
) -> None:
    assert pick_surface(ray_to(EYE, point), [item]) == pytest.approx(point, abs=1e-5)


def test_what_an_object_hides_is_not_picked() -> None:
    behind = ray_to(EYE, (9.0, 2.4, 0.0))
    assert pick_surface(behind, []) == pytest.approx((9.0, 2.4, 0.0))
    assert pick_surface(behind, [BED])[2] == pytest.approx(1.2)


def test_sides_are_refused_by_name() -> None:
    for item, point in ((BED, (9.0, -2.0, 0.6)), (PIT, (9.0, 1.0, -0.1))):
        with pytest.raises(PickRefusedError, match=f"the side of {item.name}") as refused:
            pick_surface(ray_to(EYE, point), [item])
        assert refused.value.reason is PickReason.SIDE


def test_the_top_of_an_object_is_refused_at_a_grazing_angle() -> None:
    with pytest.raises(PickRefusedError, match="meets the bed at"):
        pick_surface(ray_to((-20.0, 0.0, 1.5), (9.0, 0.0, 1.2)), [BED])
