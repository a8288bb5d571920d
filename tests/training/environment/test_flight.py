import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from machine.ballistics import drag_per_m
from machine.ballistics import landing as exact_landing
from machine.spec import load_spec
from training.environment.flight import landing

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


def test_load_below_the_plane_lands_where_it_is():
    position, velocity = np.array([[5.0, 1.0, 0.0]]), np.array([[0.0, 0.0, -1e-3]])
    x, y, time = landing(position, velocity, np.array([0.1218]), np.array([0.02]))
    assert np.isfinite([x, y, time]).all()
    np.testing.assert_allclose([x[0], y[0]], [5.0, 1.0], atol=1e-3)
