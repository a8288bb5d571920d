import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from machine.conventions import JOINT_NAMES
from machine.kinematics import cylinder_length_m
from machine.spec import MJCF_PATH, load_spec
from server.viewer.pose import CylinderPart, Part, local_pose, machine_parts, stroke_m
from tests.cases import each

SPEC = load_spec()
MODEL = mujoco.MjModel.from_xml_path(str(MJCF_PATH))
PARTS = machine_parts(MODEL, SPEC)
joints = st.tuples(
    st.floats(-9.0, 9.0),
    st.floats(-0.10, 1.28),
    st.floats(-1.10, 1.0086),
    st.floats(-0.031, 1.769),
    st.floats(-2.0, 2.0),
    st.floats(-1.0, 1.0),
)


def world_poses(values: np.ndarray) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Rotation (3, 3) and position (3,) of all parts in frame `machine`."""
    found: dict[str, tuple[np.ndarray, np.ndarray]] = {"": (np.eye(3), np.zeros(3))}
    for part in PARTS:
        rotation, position = found[part.path.rsplit("/", 1)[0]]
        pose = local_pose(part, values)
        matrix = np.zeros(9)
        mujoco.mju_quat2Mat(matrix, np.array(pose.quaternion_wxyz))
        found[part.path] = (
            rotation @ matrix.reshape(3, 3),
            position + rotation @ np.array(pose.position_m),
        )
    return {path.rsplit("/", 1)[-1]: pose for path, pose in found.items()}


@given(values=joints)
@settings(max_examples=60)
def test_the_tree_of_parts_agrees_with_mujoco(values: tuple[float, ...]) -> None:
    data = mujoco.MjData(MODEL)
    for name, value in zip(JOINT_NAMES, values, strict=True):
        data.joint(name).qpos[0] = value
    mujoco.mj_kinematics(MODEL, data)
    drawn = world_poses(np.array(values))
    for body_id in range(1, MODEL.nbody):
        name = MODEL.body(body_id).name
        rotation, position = drawn[name]
        np.testing.assert_allclose(position, data.xpos[body_id], atol=1e-9)
        np.testing.assert_allclose(rotation, data.xmat[body_id].reshape(3, 3), atol=1e-9)


@given(values=joints)
@settings(max_examples=60)
def test_barrel_and_rod_point_at_each_other_over_the_cylinders_length(
    values: tuple[float, ...],
) -> None:
    drawn = world_poses(np.array(values))
    for part in PARTS:
        if not isinstance(part, CylinderPart) or part.is_rod:
            continue
        joint = JOINT_NAMES[part.joint_index]
        barrel, rod = drawn[f"{joint}_barrel"], drawn[f"{joint}_rod"]
        length = float(cylinder_length_m(part.cylinder, np.array(values[part.joint_index])))
        axis = barrel[0] @ np.array([1.0, 0.0, 0.0])
        np.testing.assert_allclose(barrel[1] + length * axis, rod[1], atol=1e-9)
        np.testing.assert_allclose(rod[0] @ np.array([1.0, 0.0, 0.0]), axis, atol=1e-9)


def test_parents_come_before_their_children() -> None:
    seen = {""}
    for part in PARTS:
        assert part.path.rsplit("/", 1)[0] in seen
        seen.add(part.path)


def test_only_the_chassis_and_the_load_never_move() -> None:
    assert {part.name for part in PARTS if type(part) is Part} == {"chassis", "payload"}


@each("joint", ["boom", "dipper"])
def test_stroke_covers_the_joints_range(joint: str) -> None:
    cylinder = getattr(SPEC.hydraulics, f"{joint}_cylinder")
    index = JOINT_NAMES.index(joint)
    low, high = (
        SPEC.limits.position_min_rad_m[index] or 0.0,
        SPEC.limits.position_max_rad_m[index] or 0.0,
    )
    shortest, longest = stroke_m(cylinder, low, high)
    lengths = cylinder_length_m(cylinder, np.linspace(low, high, 17))
    assert shortest == pytest.approx(lengths.min(), abs=1e-3)
    assert longest == pytest.approx(lengths.max(), abs=1e-3)
