import mujoco
import numpy as np

from machine.kinematics import hanging_pitch_rad
from machine.spec import MJCF_PATH, load_spec
from training.environment.clearance import clearance, clearance_shapes

SPEC = load_spec()
GRIPPER = ("gripper_body_collision", "gripper_claw_collision")
OBSTACLES = (
    "ground", "chassis_obstacle", "cabin_obstacle", "upper_obstacle",
    "boom_obstacle", "dipper_obstacle", "telescope_obstacle",
)  # fmt: skip


def _mujoco_clearance(q: np.ndarray) -> np.ndarray:
    model = mujoco.MjModel.from_xml_path(str(MJCF_PATH))
    data = mujoco.MjData(model)
    result = np.empty(len(q))
    for i, pose in enumerate(q):
        data.qpos[:] = pose
        mujoco.mj_kinematics(model, data)
        result[i] = min(
            mujoco.mj_geomDistance(model, data, model.geom(a).id, model.geom(b).id, 20.0, None)
            for a in GRIPPER
            for b in OBSTACLES
        )
    return result


def test_clearance_is_mujocos_distance():
    rng = np.random.default_rng(0)
    q = np.zeros((400, 6))
    q[:, :4] = rng.uniform([-3.1, -0.1, -1.1, 0.0], [3.1, 1.28, 1.0, 1.7], (400, 4))
    q[:, 4] = hanging_pitch_rad(q[:, :4]) + rng.uniform(-1.5, 1.5, 400)
    q[:, 5] = rng.uniform(-1.2, 1.2, 400)
    ours, theirs = clearance(SPEC, clearance_shapes(SPEC), q), _mujoco_clearance(q)
    apart = theirs > 0.0
    assert apart.sum() > 100
    # Three spheres for the capsule: never nearer than it, and at most 10 mm farther.
    np.testing.assert_array_less(theirs[apart] - 1e-6, ours[apart])
    assert np.max(ours[apart] - theirs[apart]) < 0.011
    assert np.all(ours[theirs < -0.011] < 0.0)
