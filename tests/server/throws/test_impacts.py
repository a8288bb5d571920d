import math

from hypothesis import assume, given
from hypothesis import strategies as st

from machine.messages import Target
from server.plans.landing_errors import errors_of, point_of

METRES = st.floats(-12.0, 12.0)


def test_signs():
    target = Target(x_m=0.0, y_m=9.0)
    down, cross = errors_of(target, 0.0, 9.5)
    assert (round(down, 9), round(cross, 9)) == (0.5, 0.0)
    # Looking along +y, the machine's -x is to the left.
    down, cross = errors_of(target, -0.3, 9.0)
    assert (round(down, 9), round(cross, 9)) == (0.0, 0.3)


@given(METRES, METRES, METRES, METRES)
def test_point_and_errors_are_inverse(x, y, down, cross):
    assume(math.hypot(x, y) > 0.1)
    target = Target(x_m=x, y_m=y)
    back = errors_of(target, *point_of(target, down, cross))
    assert math.isclose(back[0], down, abs_tol=1e-9)
    assert math.isclose(back[1], cross, abs_tol=1e-9)


@given(METRES, METRES, METRES, METRES)
def test_errors_keep_distances(x, y, px, py):
    assume(math.hypot(x, y) > 0.1)
    target = Target(x_m=x, y_m=y)
    assert math.isclose(
        math.hypot(*errors_of(target, px, py)), math.hypot(px - x, py - y), abs_tol=1e-9
    )
