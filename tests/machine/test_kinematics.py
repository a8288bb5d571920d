"""The chain's arithmetic against MuJoCo on the same MJCF, and against itself."""

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from machine.kinematics import (
    aligned_slew_rad,
    cylinder_arm_m,
    cylinder_length_m,
    grip_centre,
    grip_centre_in_plane_frame,
    hanging_pitch_rad,
    pin_in_plane,
    rotate_z,
    swing_rad,
    to_throw_frame,
)
from machine.spec import MJCF_PATH, load_spec
from tests.cases import each

SPEC = load_spec()
angles = st.floats(-1.2, 1.2)
rates = st.floats(-2.0, 2.0)


@pytest.fixture(scope="module")
def mujoco_machine():
    model = mujoco.MjModel.from_xml_path(str(MJCF_PATH))
    return model, mujoco.MjData(model)


@settings(max_examples=60, deadline=None)
@given(st.tuples(*[angles] * 6), st.tuples(*[rates] * 6))
def test_grip_centre_is_mujocos(mujoco_machine, position, velocity):
    model, data = mujoco_machine
    data.qpos[:], data.qvel[:] = position, velocity
    mujoco.mj_forward(model, data)
    twist = np.zeros(6)
    site = model.site("grip_centre").id
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_SITE, site, twist, 0)
    tool = grip_centre(SPEC, np.array(position), np.array(velocity))
    np.testing.assert_allclose(tool.position_m, data.site_xpos[site], atol=1e-9)
    np.testing.assert_allclose(tool.velocity_m_per_s, twist[3:], atol=1e-9)


@settings(max_examples=30, deadline=None)
@given(st.tuples(*[angles] * 6))
def test_pin_is_mujocos(mujoco_machine, position):
    model, data = mujoco_machine
    data.qpos[:] = position
    data.qpos[0] = 0.0
    mujoco.mj_kinematics(model, data)
    pin = data.site("tool_pin").xpos
    np.testing.assert_allclose(pin_in_plane(SPEC, data.qpos), [pin[0], pin[2]], atol=1e-9)


def test_reach_of_the_arm_is_the_papers():
    stretched = np.array([0.0, 0.28, 1.0086, 1.769, 0.0, 0.0])
    assert pin_in_plane(SPEC, stretched)[0] == pytest.approx(7.485, abs=0.005)


def test_the_same_lines_run_on_jax():
    rng = np.random.default_rng(1)
    position, velocity = rng.uniform(-1, 1, (2, 5, 6))
    ours = grip_centre(SPEC, position, velocity)
    theirs = grip_centre(SPEC, jnp.asarray(position), jnp.asarray(velocity))
    np.testing.assert_allclose(ours.position_m, theirs.position_m, atol=2e-6)
    np.testing.assert_allclose(ours.velocity_m_per_s, theirs.velocity_m_per_s, atol=1e-5)


@given(st.floats(-10, 10), st.floats(-10, 10), st.floats(-7, 7))
def test_rotation_about_z_keeps_length_and_comes_back(x, y, angle):
    vector = np.array([x, y, 1.0])
    there = rotate_z(vector, np.array(angle))
    assert np.linalg.norm(there) == pytest.approx(np.linalg.norm(vector))
    np.testing.assert_allclose(rotate_z(there, np.array(-angle)), vector, atol=1e-9)


@given(st.floats(5.0, 11.0), st.floats(-3.1, 3.1))
def test_an_aligned_cabin_has_the_target_in_the_arm_plane(range_m, bearing):
    target = np.array([range_m * np.cos(bearing), range_m * np.sin(bearing), 0.0])
    local = rotate_z(target, -aligned_slew_rad(SPEC, target))
    assert local[1] == pytest.approx(SPEC.geometry.arm_plane_offset_m, abs=1e-9)
    assert local[0] > 0.0


def test_throw_frame_has_the_target_on_x():
    target = np.array([3.0, 4.0, 0.5])
    np.testing.assert_allclose(to_throw_frame(target, target), [5.0, 0.0, 0.5], atol=1e-12)


def test_hanging_gripper_has_no_swing():
    pose = np.array([0.3, 0.7, -0.4, 0.5, 0.0, 0.0])
    pose[4] = hanging_pitch_rad(pose[:4])
    assert swing_rad(pose) == pytest.approx(0.0)
    tool = grip_centre_in_plane_frame(SPEC, pose, np.zeros(6))
    assert tool.position_m[0] == pytest.approx(pin_in_plane(SPEC, pose)[0])


@each("name", ["boom_cylinder", "dipper_cylinder"])
def test_cylinder_arm_is_the_slope_of_its_length(name):
    cylinder = getattr(SPEC.hydraulics, name)
    angle, step = np.linspace(-1.0, 1.2, 23), 1e-6
    slope = (
        cylinder_length_m(cylinder, angle + step) - cylinder_length_m(cylinder, angle - step)
    ) / (2 * step)
    np.testing.assert_allclose(cylinder_arm_m(cylinder, angle), slope, atol=1e-6)
