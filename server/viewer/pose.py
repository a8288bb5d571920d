"""Poses of the machine's parts as a tree: only what a joint moves is sent to the browsers.

Every part's pose is relative to its parent, so that one joint angle is one quaternion on the wire.
`tests/server/viewer/test_viewer_pose.py` holds it to mj_kinematics.
"""

import math
from dataclasses import dataclass

import mujoco
import numpy as np

from machine.conventions import JOINT_NAMES, Array
from machine.spec import CylinderSpec, MachineSpec

Quaternion = tuple[float, float, float, float]
Vector = tuple[float, float, float]
IDENTITY: Quaternion = (1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Part:
    """A body of the model, or half of a hydraulic cylinder."""

    name: str
    path: str
    """Path in the view's tree, below the machine's root: ``/chassis/upper/boom``."""
    position_m: Vector
    """In the parent's frame, at zero joint position."""
    quaternion_wxyz: Quaternion


@dataclass(frozen=True)
class JointPart(Part):
    """A body moved by one joint."""

    joint_index: int
    axis: Vector
    is_slide: bool


@dataclass(frozen=True)
class CylinderPart(Part):
    """Barrel (along +x from its pin) or rod (along -x from its pin) of a hydraulic cylinder."""

    cylinder: CylinderSpec
    joint_index: int
    is_rod: bool


@dataclass(frozen=True)
class LocalPose:
    """Pose in the parent's frame."""

    position_m: Vector
    quaternion_wxyz: Quaternion


def axis_quaternion(axis: Vector, angle_rad: float) -> Quaternion:
    """Rotation about a unit axis."""
    s = math.sin(angle_rad / 2.0)
    return math.cos(angle_rad / 2.0), axis[0] * s, axis[1] * s, axis[2] * s


def multiply(a: Quaternion, b: Quaternion) -> Quaternion:
    """Hamilton product a b: b first, then a."""
    return (
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )


def local_pose(part: Part, joints_rad_m: Array) -> LocalPose:
    """Pose of a part in its parent's frame for joint positions of shape (6,)."""
    if isinstance(part, JointPart):
        q = float(joints_rad_m[part.joint_index])
        if part.is_slide:
            x, y, z = (p + a * q for p, a in zip(part.position_m, part.axis, strict=True))
            return LocalPose((x, y, z), part.quaternion_wxyz)
        turn = axis_quaternion(part.axis, q)
        return LocalPose(part.position_m, multiply(part.quaternion_wxyz, turn))
    if isinstance(part, CylinderPart):
        angle = _cylinder_angle_rad(part.cylinder, float(joints_rad_m[part.joint_index]))
        if part.is_rod:
            angle -= float(joints_rad_m[part.joint_index])
        # The arm's joints turn about -y: positive angles raise +x towards +z.
        return LocalPose(part.position_m, axis_quaternion((0.0, -1.0, 0.0), angle))
    return LocalPose(part.position_m, part.quaternion_wxyz)


def _cylinder_angle_rad(cylinder: CylinderSpec, joint_rad: float) -> float:
    """Angle of the line base pin -> rod pin in the parent's xz plane."""
    c, s = math.cos(joint_rad), math.sin(joint_rad)
    rod_x = c * cylinder.rod_xz_m[0] - s * cylinder.rod_xz_m[1]
    rod_z = s * cylinder.rod_xz_m[0] + c * cylinder.rod_xz_m[1]
    return math.atan2(rod_z - cylinder.base_xz_m[1], rod_x - cylinder.base_xz_m[0])


def _vector(values: Array) -> Vector:
    return float(values[0]), float(values[1]), float(values[2])


def machine_parts(model: mujoco.MjModel, spec: MachineSpec) -> tuple[Part, ...]:
    """All parts, parents before children: the bodies of the model and the two drawn cylinders."""
    paths = {0: ""}
    parts: list[Part] = []
    for body_id in range(1, model.nbody):
        body = model.body(body_id)
        paths[body_id] = f"{paths[int(model.body_parentid[body_id])]}/{body.name}"
        w, x, y, z = (float(v) for v in model.body_quat[body_id])
        position = _vector(model.body_pos[body_id])
        joint_id = int(model.body_jntadr[body_id])
        if joint_id < 0:
            parts.append(Part(body.name, paths[body_id], position, (w, x, y, z)))
            continue
        parts.append(
            JointPart(
                name=body.name,
                path=paths[body_id],
                position_m=position,
                quaternion_wxyz=(w, x, y, z),
                joint_index=JOINT_NAMES.index(model.joint(joint_id).name),
                axis=_vector(model.jnt_axis[joint_id]),
                is_slide=int(model.jnt_type[joint_id]) == int(mujoco.mjtJoint.mjJNT_SLIDE),
            )
        )
    by_name = {part.name: part for part in parts}
    hydraulics = spec.hydraulics
    for joint, cylinder in (
        ("boom", hydraulics.boom_cylinder),
        ("dipper", hydraulics.dipper_cylinder),
    ):
        parts.extend(_cylinder_parts(by_name, joint, cylinder))
    return tuple(parts)


def _cylinder_parts(
    by_name: dict[str, Part], joint: str, cylinder: CylinderSpec
) -> tuple[CylinderPart, CylinderPart]:
    child = by_name[joint]
    parent_path = child.path.rsplit("/", 1)[0]
    pivot = child.position_m
    base = (pivot[0] + cylinder.base_xz_m[0], pivot[1], pivot[2] + cylinder.base_xz_m[1])
    rod = (cylinder.rod_xz_m[0], 0.0, cylinder.rod_xz_m[1])
    index = JOINT_NAMES.index(joint)
    barrel_name, rod_name = f"{joint}_barrel", f"{joint}_rod"
    return (
        CylinderPart(
            barrel_name, f"{parent_path}/{barrel_name}", base, IDENTITY, cylinder, index, False
        ),
        CylinderPart(rod_name, f"{child.path}/{rod_name}", rod, IDENTITY, cylinder, index, True),
    )


def stroke_m(cylinder: CylinderSpec, low_rad: float, high_rad: float) -> tuple[float, float]:
    """Shortest and longest pin-to-pin length over a joint's range, m."""
    angles = np.linspace(low_rad, high_rad, 200)
    c, s = np.cos(angles), np.sin(angles)
    x = c * cylinder.rod_xz_m[0] - s * cylinder.rod_xz_m[1] - cylinder.base_xz_m[0]
    z = s * cylinder.rod_xz_m[0] + c * cylinder.rod_xz_m[1] - cylinder.base_xz_m[1]
    lengths = np.hypot(x, z)
    return float(lengths.min()), float(lengths.max())
