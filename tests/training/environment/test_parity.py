"""The trainer's machine against MuJoCo on random states of machines that differ from the drawing.

Stated tolerances: kinematics 1e-9 (m, m/s) in double and 2e-5 in the single precision that trains; passive
accelerations 2e-3 rad/s2 of some 30; flight 1 mm without and 3 mm with drag; observation 1e-6.
"""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from machine.ballistics import drag_per_m
from machine.conventions import Mode
from machine.kinematics import grip_centre, hanging_pitch_rad
from machine.spec import MJCF_PATH, load_spec
from runtime.control import observation
from tests.cases import each
from training.environment.dynamics import drawn_machine, passive_acceleration, passive_body
from training.environment.flight import landing

SPEC = load_spec()
COUNT = 40
TO_PIN_M, TO_ROLL_M, TO_GRIP_M, COM_M = 0.03, -0.02, 0.025, -0.05
MASS_RATIO, INERTIA_RATIO, FRICTION_RATIO = 1.1, 0.9, 1.4


def _states(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    low, high = np.array([-3.0, -0.1, -1.1, 0.0]), np.array([3.0, 1.28, 1.0, 1.7])
    q = np.zeros((COUNT, 6))
    q[:, :4] = rng.uniform(low, high, (COUNT, 4))
    q[:, 4] = hanging_pitch_rad(q[:, :4]) + rng.uniform(-1.0, 1.0, COUNT)
    q[:, 5] = rng.uniform(-1.0, 1.0, COUNT)
    v = rng.uniform(-1.0, 1.0, (COUNT, 6)) * np.array([0.95, 0.5, 0.7, 0.5, 3.0, 3.0])
    a = rng.uniform(-1.0, 1.0, (COUNT, 4)) * np.array([0.8, 1.5, 3.0, 1.5])
    return q, v, a


@pytest.fixture(scope="module")
def built():
    """The MJCF with the same errors, built by MuJoCo's own means; its payload stays where it is drawn."""
    tree = mujoco.MjSpec.from_file(str(MJCF_PATH))
    hanger, gripper = tree.body("hanger"), tree.body("gripper")
    hanger.pos = [0.0, 0.0, hanger.pos[2] - TO_PIN_M]
    gripper.pos = [0.0, 0.0, gripper.pos[2] - TO_ROLL_M]
    gripper.ipos = [0.0, 0.0, gripper.ipos[2] - COM_M]
    gripper.mass *= MASS_RATIO
    gripper.inertia = np.asarray(gripper.inertia) * MASS_RATIO * INERTIA_RATIO
    site = tree.site("grip_centre")
    site.pos = [0.0, 0.0, site.pos[2] - TO_GRIP_M]
    model = tree.compile()
    return model, mujoco.MjData(model)


def _machine():
    return drawn_machine(
        SPEC,
        telescope_to_pin_error_m=TO_PIN_M,
        pitch_to_roll_error_m=TO_ROLL_M,
        roll_to_grip_error_m=TO_GRIP_M,
    )


def test_grip_centre_of_a_drawn_machine_is_mujocos(built):
    model, data = built
    q, v, _ = _states(1)
    site, twist = model.site("grip_centre").id, np.zeros(6)
    theirs = np.empty((2, COUNT, 3))
    for i in range(COUNT):
        data.qpos[:], data.qvel[:] = q[i], v[i]
        mujoco.mj_forward(model, data)
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_SITE, site, twist, 0)
        theirs[:, i] = data.site_xpos[site], twist[3:]
    ours = grip_centre(_machine(), q, v)
    np.testing.assert_allclose(ours.position_m, theirs[0], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(ours.velocity_m_per_s, theirs[1], rtol=0.0, atol=1e-9)
    single = grip_centre(_machine(), jnp.asarray(q, jnp.float32), jnp.asarray(v, jnp.float32))
    np.testing.assert_allclose(single.position_m, theirs[0], rtol=0.0, atol=2e-5)
    np.testing.assert_allclose(single.velocity_m_per_s, theirs[1], rtol=0.0, atol=2e-5)


def test_passive_acceleration_of_a_drawn_machine_is_mujocos(built):
    model, data = built
    q, v, a = _states(2)
    body = passive_body(
        SPEC,
        SPEC.ball.mass_kg,
        friction_scale=FRICTION_RATIO,
        com_error_m=COM_M,
        inertia_scale=INERTIA_RATIO,
        mass_scale=MASS_RATIO,
    )
    ours = passive_acceleration(_machine(), body, q, v, a)
    mass = np.empty((model.nv, model.nv))
    theirs = np.empty((COUNT, 2))
    for i in range(COUNT):
        data.qpos[:], data.qvel[:] = q[i], v[i]
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, mass)
        torque = -data.qfrc_bias[4:] - mass[4:, :4] @ a[i]
        torque -= FRICTION_RATIO * model.dof_damping[4:] * v[i, 4:]
        torque -= FRICTION_RATIO * model.dof_frictionloss[4:] * np.tanh(v[i, 4:] / 0.005)
        theirs[i] = np.linalg.solve(mass[4:, 4:], torque)
    np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=2e-3)
    assert np.abs(theirs).max() > 5.0


@each(("has_drag", "tolerance_m"), [(False, 1e-3), (True, 3e-3)])
def test_flight_is_that_of_a_free_body_in_mujoco(has_drag: bool, tolerance_m: float):
    """A free ball stepped at 1 ms by Runge-Kutta, the drag as an applied force."""
    ball = SPEC.ball
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><option timestep="0.001" integrator="RK4"/><worldbody><body><freejoint/>'
        f'<geom type="sphere" size="{ball.radius_m}" mass="{ball.mass_kg}" contype="0" '
        'conaffinity="0"/></body></worldbody></mujoco>'
    )
    data = mujoco.MjData(model)
    rng = np.random.default_rng(3)
    position = rng.uniform([3.0, -3.0, 1.5], [7.0, 3.0, 4.0], (12, 3))
    velocity = rng.uniform([-2.0, -3.0, -1.0], [5.0, 3.0, 4.0], (12, 3))
    drag = drag_per_m(ball) if has_drag else 0.0
    plane = np.full(12, ball.radius_m)
    x, y, time = landing(position, velocity, plane, np.full(12, drag))
    for i in range(12):
        mujoco.mj_resetData(model, data)
        data.qpos[:3], data.qvel[:3] = position[i], velocity[i]
        while data.qpos[2] > ball.radius_m:
            before = data.qpos[:3].copy()
            speed = float(np.linalg.norm(data.qvel[:3]))
            data.xfrc_applied[1, :3] = -ball.mass_kg * drag * speed * data.qvel[:3]
            mujoco.mj_step(model, data)
        share = (before[2] - ball.radius_m) / (before[2] - data.qpos[2])
        touch = before + share * (data.qpos[:3] - before)
        assert np.hypot(x[i] - touch[0], y[i] - touch[1]) < tolerance_m
        assert time[i] == pytest.approx(data.time - (1.0 - share) * 1e-3, abs=2e-3)


@each("mode", list(Mode))
def test_a_batch_in_the_trainers_arithmetic_is_the_runtimes_machine_by_machine(mode: Mode):
    """To 1e-6: compiled for a batch in double precision, against one machine at a time in numpy."""
    rng = np.random.default_rng(4)
    q, v, _ = _states(4)
    q[:, 0] += 2.0 * np.pi * rng.integers(-2, 3, COUNT)
    target = np.column_stack(
        [rng.uniform(5, 10, COUNT), rng.uniform(-4, 4, COUNT), np.zeros(COUNT)]
    )
    action_count = len(observation.ACTION_NAMES[mode])
    previous = rng.uniform(-1.5, 1.5, (COUNT, action_count))
    opened = rng.random(COUNT) < 0.5
    older = q - rng.uniform(0.0, 0.1, q.shape)

    def observe(q, v, older, target, previous, opened, pace):
        turns = observation.start_turns(q[..., 0], target)
        frames = [observation.policy_frame(SPEC, mode, x, v, target, turns) for x in (older, q)]
        positions = observation.start_history(frames[0].joint_position_rad_m)
        positions = observation.push_history(positions, frames[1].joint_position_rad_m)
        velocities = observation.start_history(v)
        return observation.build(mode, frames[1], positions, velocities, previous, opened, pace)

    given = (q, v, older, target, previous, opened, rng.random(COUNT))
    with jax.enable_x64(True):
        batch = np.asarray(jax.jit(observe)(*(jnp.asarray(x) for x in given)))
    assert batch.dtype == np.float64
    for i in range(COUNT):
        alone = observe(*(x[i : i + 1] for x in given))
        np.testing.assert_allclose(batch[i], alone[0], rtol=0.0, atol=1e-6)
