"""Random starts are poses the real machine could be in."""

import mujoco
import numpy as np

from machine.conventions import Mode
from machine.kinematics import aligned_slew_rad, swing_rad
from machine.spec import MJCF_PATH, load_spec
from machine.starts import is_valid_start, safe_pose, sample_starts
from tests.cases import each

SPEC = load_spec()


@each("mode", list(Mode))
def test_starts_touch_nothing_hang_plumb_and_are_valid(mode):
    rng = np.random.default_rng(5)
    target = np.tile([9.0, 0.0, 0.0], (300, 1))
    poses = sample_starts(SPEC, mode, target, rng)
    model = mujoco.MjModel.from_xml_path(str(MJCF_PATH))
    data = mujoco.MjData(model)
    assert is_valid_start(SPEC, poses).all()
    np.testing.assert_allclose(swing_rad(poses), 0.0, atol=1e-12)
    for pose in poses:
        data.qpos[:] = pose
        mujoco.mj_forward(model, data)
        assert data.ncon == 0


def test_planar_starts_are_aligned_and_spatial_ones_look_everywhere():
    rng = np.random.default_rng(6)
    target = np.tile([6.0, 6.0, 0.0], (400, 1))
    planar = sample_starts(SPEC, Mode.PLANAR, target, rng)
    np.testing.assert_allclose(planar[:, 0], aligned_slew_rad(SPEC, target))
    spatial = sample_starts(SPEC, Mode.SPATIAL, target, rng)
    counts, _ = np.histogram(spatial[:, 0], bins=8, range=(-np.pi, np.pi))
    assert counts.min() > 20


def test_starts_repeat_with_the_seed():
    target = np.tile([9.0, 0.0, 0.0], (5, 1))
    first = sample_starts(SPEC, Mode.SPATIAL, target, np.random.default_rng(7))
    second = sample_starts(SPEC, Mode.SPATIAL, target, np.random.default_rng(7))
    np.testing.assert_array_equal(first, second)


def test_the_safe_pose_is_valid_at_any_slew():
    for slew in np.linspace(-3, 3, 7):
        assert is_valid_start(SPEC, safe_pose(slew))


@each(("joint", "value"), [(1, 1.27), (2, 1.0), (3, 1.76), (1, -0.09)])
def test_a_pose_at_a_limit_is_no_start(joint, value):
    pose = safe_pose()
    pose[joint] = value
    assert not is_valid_start(SPEC, pose)
