"""Flight against the closed form in a vacuum and against an independent integrator with drag."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from machine.ballistics import drag_per_m, landing
from machine.conventions import GRAVITY_M_PER_S2
from machine.spec import load_spec

DRAG = drag_per_m(load_spec().ball)
speeds = st.tuples(st.floats(-6, 9), st.floats(-4, 4), st.floats(-3, 7))


def integrated(position, velocity, plane, drag, wind):
    def flow(_, state):
        relative = state[3:] - wind
        push = -drag * np.linalg.norm(relative) * relative
        return [*state[3:], push[0], push[1], push[2] - GRAVITY_M_PER_S2]

    def crossing(_, state):
        return state[2] - plane

    crossing.terminal, crossing.direction = True, -1
    result = solve_ivp(
        flow, (0, 6), [*position, *velocity], events=crossing, rtol=1e-10, atol=1e-10
    )
    return result.y_events[0][0], result.t_events[0][0]


@given(speeds, st.floats(1.0, 4.0))
def test_vacuum_is_the_parabola(velocity, height):
    vx, vy, vz = velocity
    end = landing(np.array([1.0, 2.0, height]), np.array(velocity), 0.0, 0.0)
    time_s = (vz + np.sqrt(vz**2 + 2 * GRAVITY_M_PER_S2 * height)) / GRAVITY_M_PER_S2
    assert end.time_s == pytest.approx(time_s, abs=1e-9)
    np.testing.assert_allclose(end.position_m, [1 + vx * time_s, 2 + vy * time_s, 0.0], atol=1e-8)


@given(speeds, st.floats(-1.0, 2.0))
def test_drag_and_wind_agree_with_an_independent_integrator(velocity, plane):
    position, wind = np.array([0.0, 0.0, 3.1]), np.array([-1.5, 2.0, 0.0])
    state, time_s = integrated(position, velocity, plane, DRAG, wind)
    end = landing(position, np.array(velocity), plane, DRAG, wind)
    np.testing.assert_allclose(end.position_m, state[:3], atol=1e-4)
    np.testing.assert_allclose(end.velocity_m_per_s, state[3:], atol=1e-3)
    assert end.time_s == pytest.approx(time_s, abs=1e-4)


def test_a_batch_is_its_elements():
    rng = np.random.default_rng(3)
    position = np.stack(
        [rng.uniform(-1, 1, (4, 5)), rng.uniform(-1, 1, (4, 5)), rng.uniform(1, 3, (4, 5))], -1
    )
    velocity = rng.uniform(-3, 6, (4, 5, 3))
    together = landing(position, velocity, 0.12, DRAG)
    for i in range(4):
        for j in range(5):
            alone = landing(position[i, j], velocity[i, j], 0.12, DRAG)
            np.testing.assert_array_equal(together.position_m[i, j], alone.position_m)


def test_a_load_that_never_comes_down_through_the_plane_is_nan():
    below = landing(np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 1.0]), 2.0, DRAG)
    assert np.isnan(below.position_m).all()
    unknown = landing(np.array([np.nan, 0.0, 1.0]), np.array([1.0, 0.0, 1.0]), 0.0, DRAG)
    assert np.isnan(unknown.position_m).all()
    assert np.isnan(unknown.time_s)


def test_drag_of_the_ball_shortens_a_typical_throw_as_the_facts_say():
    velocity = 8.0 * np.array([np.cos(np.radians(35)), 0.0, np.sin(np.radians(35))])
    free = landing(np.array([0.0, 0.0, 3.0]), velocity, 0.0, 0.0).position_m[0]
    slowed = landing(np.array([0.0, 0.0, 3.0]), velocity, 0.0, DRAG).position_m[0]
    assert free - slowed == pytest.approx(0.89, abs=0.05)
