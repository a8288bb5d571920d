import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from machine.ballistics import drag_per_m
from machine.ballistics import landing as exact_landing
from machine.spec import load_spec
from training.environment.flight import flight_step, landing, shortfall

BALL = load_spec().ball


def _throws(count: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    position = rng.uniform([3.0, -4.0, 0.6], [9.0, 4.0, 5.0], (count, 3))
    velocity = rng.uniform([-5.0, -5.0, -4.0], [6.0, 5.0, 5.0], (count, 3))
    drag = drag_per_m(BALL) * rng.uniform(0.7, 1.3, count)
    return position, velocity, drag


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000), height=st.floats(0.0, 0.4))
def test_landing_is_within_two_millimetres_of_the_exact_flight(seed: int, height: float):
    position, velocity, drag = _throws(32, seed)
    plane = np.full(32, height + BALL.radius_m)
    x, y, time = landing(position, velocity, plane, drag)
    exact = exact_landing(position, velocity, plane, drag)
    np.testing.assert_allclose(np.stack([x, y], -1), exact.position_m[:, :2], rtol=0, atol=2e-3)
    np.testing.assert_allclose(time, exact.time_s, rtol=0, atol=1e-3)


def test_load_that_rises_through_the_plane_lands_on_it_from_above():
    rng = np.random.default_rng(3)
    position = rng.uniform([6.0, -1.0, 2.0], [7.0, 1.0, 2.4], (32, 3))
    velocity = rng.uniform([2.0, -0.5, 4.5], [4.0, 0.5, 5.5], (32, 3))
    plane, drag = np.full(32, 3.0), np.full(32, drag_per_m(BALL))
    x, y, time = landing(position, velocity, plane, drag)
    # machine.ballistics starts above its plane: from a point of the same flight behind the apex.
    for i in range(32):
        p, v, t = position[i], velocity[i], 0.0
        state = (*p, *v)
        while state[5] > 0.0:
            state, t = flight_step(*state, drag[i], 1e-3), t + 1e-3
        end = exact_landing(np.array(state[:3]), np.array(state[3:]), 3.0, drag[i])
        assert np.hypot(*(end.position_m[:2] - [x[i], y[i]])) < 5e-3
        assert float(end.time_s) + t == pytest.approx(time[i], abs=2e-3)
    np.testing.assert_array_equal(shortfall(position, velocity, plane), 0.0)


def test_load_that_stays_below_the_plane_is_short_by_that_much():
    position, velocity = (
        np.array([[6.0, 0.0, 2.0]] * 2),
        np.array([[3.0, 0.0, 2.0], [3.0, 0.0, -1.0]]),
    )
    plane = np.array([3.0, 2.5])
    # 2^2 / 19.62 = 0.204 m of climb
    np.testing.assert_allclose(shortfall(position, velocity, plane), [0.796, 0.5], atol=1e-3)
    x, _, time = landing(position, velocity, plane, np.zeros(2))
    np.testing.assert_allclose(time, [2.0 / 9.81, 0.0], atol=1e-6)
    np.testing.assert_allclose(x, [6.0 + 3.0 * 2.0 / 9.81, 6.0], atol=1e-3)


def test_load_below_the_plane_lands_where_it_is():
    position, velocity = np.array([[5.0, 1.0, 0.0]]), np.array([[0.0, 0.0, -1e-3]])
    x, y, time = landing(position, velocity, np.array([0.1218]), np.array([0.02]))
    assert np.isfinite([x, y, time]).all()
    np.testing.assert_allclose([x[0], y[0]], [5.0, 1.0], atol=1e-3)
