import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from machine.calibration import actuator_ratio, nominal_calibration
from machine.spec import load_spec
from sim_twin.lag import lag_matrices
from sim_twin.twin.profile import exact_profile, nominal_profile
from sim_twin.twin.response import VelocityResponse
from tests.cases import each

SPEC = load_spec()
CALIBRATION = nominal_calibration(SPEC)
PROFILE = exact_profile(nominal_profile(SPEC))
NOTHING = np.zeros((1, 3, 4))
MIDDLE = np.array([[0.0, 0.5, 0.0, 0.5]])


@given(w=st.floats(0.5, 80.0), z=st.floats(0.05, 4.0), period_s=st.floats(0.001, 0.02))
def test_lag_is_the_exact_solution_of_its_equation(w: float, z: float, period_s: float) -> None:
    a11, a12, a21, a22 = lag_matrices(np.array(w), np.array(z), period_s)
    # State (e, e'/w): d/dt = w [[0, 1], [-1, -2 z]].
    exact = expm(period_s * w * np.array([[0.0, 1.0], [-1.0, -2.0 * z]]))
    np.testing.assert_allclose(np.array([[a11, a12], [a21, a22]]), exact, atol=1e-9)


def test_critical_damping_is_no_gap() -> None:
    near = [
        np.array(lag_matrices(np.array(20.0), np.array(1.0 + d), 0.01)) for d in (-1e-9, 0, 1e-9)
    ]
    np.testing.assert_allclose(near[0], near[1], atol=1e-8)
    np.testing.assert_allclose(near[2], near[1], atol=1e-8)


def steps(response: VelocityResponse, valve: np.ndarray, ticks: int) -> np.ndarray:
    return np.stack([response.step(valve, MIDDLE)[0].copy() for _ in range(ticks)])


@each("boom", np.linspace(-0.1, 1.28, 7))
def test_steady_joint_speed_is_actuator_speed_over_the_moment_arm(boom: float) -> None:
    response = VelocityResponse(SPEC, PROFILE, CALIBRATION, 1)
    response.reset(NOTHING)
    position = np.array([[0.0, boom, 0.9 - boom, 0.5]])
    valve = np.array([[0.0, 0.5, -0.7, 0.0]])
    for _ in range(400):
        velocity = response.step(valve, position)
    wanted = response.command(valve) / np.abs(actuator_ratio(SPEC, position))
    np.testing.assert_allclose(velocity, wanted, rtol=2e-6, atol=1e-12)


@settings(max_examples=25)
@given(dead_s=st.floats(0.0, 0.5))
def test_any_dead_time_delays_by_exactly_that(dead_s: float) -> None:
    """The area that a step response loses is speed times (dead time + 2 z / w)."""
    profile = PROFILE.model_copy(update={"dead_time_s": (dead_s,) * 4})
    response = VelocityResponse(SPEC, profile, CALIBRATION, 1)
    response.reset(NOTHING)
    valve = np.array([[0.0, 0.0, 0.0, 0.5]])
    speed = steps(response, valve, 300)[:, 3]
    steady = response.command(valve)[0, 3]
    # Sampled at the ends of ticks: the trapezium sum counts half of the last value.
    travelled = 0.01 * (speed.sum() - 0.5 * speed[-1])
    lost_s = 3.0 - travelled / steady
    assert lost_s == pytest.approx(dead_s + 0.1, abs=2e-3)


def test_reset_forgets_motion_and_delayed_commands() -> None:
    response = VelocityResponse(SPEC, PROFILE, CALIBRATION, 1)
    response.reset(NOTHING)
    steps(response, np.full((1, 4), 0.8), 30)
    response.reset(NOTHING)
    assert np.abs(steps(response, np.zeros((1, 4)), 60)).max() < 1e-9


def test_drawn_parameters_never_turn_a_drive_around() -> None:
    response = VelocityResponse(SPEC, nominal_profile(SPEC), CALIBRATION, 1)
    response.reset(np.full((1, 3, 4), -200.0))
    speed = steps(response, np.full((1, 4), 0.8), 300)
    assert np.isfinite(speed).all()
    assert (speed >= -1e-12).all()
