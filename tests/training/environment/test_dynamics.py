import mujoco
import numpy as np
import pytest

from machine.kinematics import hanging_pitch_rad
from machine.spec import MJCF_PATH, load_spec
from training.environment.dynamics import (
    DriveResponse,
    ResponseState,
    passive_acceleration,
    passive_body,
    respond,
)

SPEC = load_spec()


def _states(count: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    low, high = np.array([-3.0, -0.1, -1.1, 0.0]), np.array([3.0, 1.28, 1.0, 1.7])
    q = np.zeros((count, 6))
    q[:, :4] = rng.uniform(low, high, (count, 4))
    q[:, 4] = hanging_pitch_rad(q[:, :4]) + rng.uniform(-1.2, 1.2, count)
    q[:, 5] = rng.uniform(-1.2, 1.2, count)
    v = rng.uniform(-1.0, 1.0, (count, 6)) * np.array([0.95, 0.5, 0.7, 0.5, 3.0, 3.0])
    a = rng.uniform(-1.0, 1.0, (count, 4)) * np.array([0.8, 1.5, 3.0, 1.5])
    return q, v, a


def _mujoco_acceleration(q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Passive accelerations of the MJCF's rigid body for prescribed active ones."""
    model = mujoco.MjModel.from_xml_path(str(MJCF_PATH))
    data = mujoco.MjData(model)
    result = np.empty((len(q), 2))
    mass = np.empty((model.nv, model.nv))
    for i in range(len(q)):
        data.qpos[:], data.qvel[:] = q[i], v[i]
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, mass)
        # M a + bias = friction torque, rows of pitch and roll
        torque = -data.qfrc_bias[4:] - mass[4:, :4] @ a[i]
        torque -= model.dof_damping[4:] * v[i, 4:]
        torque -= model.dof_frictionloss[4:] * np.tanh(v[i, 4:] / 0.005)
        result[i] = np.linalg.solve(mass[4:, 4:], torque)
    return result


def test_passive_acceleration_is_mujocos():
    q, v, a = _states(200, 0)
    ours = passive_acceleration(SPEC, passive_body(SPEC, SPEC.ball.mass_kg), q, v, a)
    # The MJCF's friction torques are rounded to three digits, nothing else differs.
    np.testing.assert_allclose(ours, _mujoco_acceleration(q, v, a), rtol=0.0, atol=2e-3)


def test_passive_acceleration_is_mujocos_without_friction():
    q, v, a = _states(200, 1)
    model_friction = passive_body(SPEC, SPEC.ball.mass_kg, friction_scale=0.0)
    ours = passive_acceleration(SPEC, model_friction, q, v, a)
    with_friction = passive_acceleration(SPEC, passive_body(SPEC, SPEC.ball.mass_kg), q, v, a)
    loss = np.abs(with_friction - ours)
    assert loss.max() > 0.1
    theirs = _mujoco_acceleration(q, np.where(np.arange(6) < 4, v, 0.0), a)
    still = passive_acceleration(SPEC, model_friction, q, np.where(np.arange(6) < 4, v, 0.0), a)
    np.testing.assert_allclose(still, theirs, rtol=0.0, atol=1e-5)


def test_jax_float32_agrees_with_numpy_float64():
    jnp = pytest.importorskip("jax.numpy")
    q, v, a = _states(200, 2)
    body = passive_body(SPEC, SPEC.ball.mass_kg)
    single = passive_acceleration(
        SPEC,
        body,
        jnp.asarray(q, jnp.float32),
        jnp.asarray(v, jnp.float32),
        jnp.asarray(a, jnp.float32),
    )
    np.testing.assert_allclose(
        np.asarray(single), passive_acceleration(SPEC, body, q, v, a), rtol=1e-4, atol=2e-4
    )


def test_response_settles_at_gain_times_reference_and_rings_as_damping_says():
    wn, zeta, dt = 6.0, 0.5, 0.0005
    one, nothing = np.ones((1, 4)), np.zeros((1, 4))
    response = DriveResponse(nothing, 1e-6 * one, wn * one, zeta * one, 1.03 * one, 0.9 * one)
    for sign, gain in ((1.0, 1.03), (-1.0, 0.9)):
        velocity, state, peak = nothing, ResponseState(nothing, nothing), 0.0
        for _ in range(12000):
            velocity, state = respond(response, state, velocity, 0.4 * sign * one, nothing, dt)
            peak = max(peak, float((sign * velocity).max()))
        np.testing.assert_allclose(velocity, 0.4 * sign * gain, rtol=1e-3)
        overshoot = np.exp(-np.pi * zeta / np.sqrt(1.0 - zeta**2))
        assert peak / (0.4 * gain) - 1.0 == pytest.approx(overshoot, rel=0.03)


def test_overdamped_response_is_stable_at_100_hertz():
    one, nothing = np.ones((1, 4)), np.zeros((1, 4))
    response = DriveResponse(nothing, 0.3 * one, 36.0 * one, 1.6 * one, one, one)
    velocity, state = nothing, ResponseState(nothing, nothing)
    for _ in range(300):
        velocity, state = respond(response, state, velocity, one, nothing, 0.01)
        assert np.all((velocity >= 0.0) & (velocity <= 1.0))
    np.testing.assert_allclose(velocity, one, rtol=1e-3)


def test_boom_and_dipper_push_each_other_back():
    # a_boom = s_boom - 0.6 a_dipper and a_dipper = s_dipper - 0.8 a_boom; the others know nothing of it.
    one, nothing, dt = np.ones((1, 4)), np.zeros((1, 4)), 1e-5
    alone = DriveResponse(nothing, 1e-6 * one, 25.0 * one, 0.8 * one, one, one)
    coupled = alone._replace(boom_from_dipper_ratio=0.6, dipper_from_boom_ratio=0.8)
    state = ResponseState(one, np.array([[0.3, 2.0, -1.0, 0.7]]))
    apart, _ = respond(alone, state, nothing, one, nothing, dt)
    moved, after = respond(coupled, state, nothing, one, nothing, dt)
    boom, dipper = moved[0, 1:3] / dt
    drive = after.acceleration[0]
    assert boom == pytest.approx(drive[1] - 0.6 * dipper, rel=1e-9)
    assert dipper == pytest.approx(drive[2] - 0.8 * boom, rel=1e-9)
    assert boom == pytest.approx((2.0 + 0.6) / (1.0 - 0.48), rel=0.01)
    np.testing.assert_allclose(moved[0, [0, 3]], apart[0, [0, 3]], rtol=1e-12)
    velocity, state = nothing, ResponseState(nothing, nothing)
    for _ in range(300):
        velocity, state = respond(coupled, state, velocity, one, nothing, 0.01)
    np.testing.assert_allclose(velocity, one, rtol=1e-3)
