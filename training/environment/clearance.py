"""Smallest distance between the gripper and ground, machine and arm, from the spec's collision shapes.

The gripper's capsule is covered by three spheres (error at most 10 mm); everything else is exact. Checked
against MuJoCo's geometry distance (tests/training/environment/test_clearance.py). Numpy or JAX.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from machine.kinematics import namespace
from machine.spec import CollisionShape, MachineSpec

Point = tuple[Any, Any, Any]


@dataclass(frozen=True)
class ClearanceShapes:
    """Collision shapes of one machine type, by body."""

    spheres: tuple[tuple[float, float], ...]
    """Gripper: (distance below the roll axis, radius), m."""
    chassis_boxes: tuple[tuple[Point, Point], ...]
    """Fixed boxes: centre in frame `machine`, half sizes."""
    upper_boxes: tuple[tuple[Point, Point], ...]
    """Boxes that turn with the cabin: centre in the slew frame (z from the ground), half sizes."""
    boom: tuple[Point, Point, float]
    """Capsule: ends in the boom's frame, radius."""
    dipper: tuple[Point, Point, float]
    """Capsule: ends in the dipper's frame, radius."""
    telescope: tuple[Point, Point, float]
    """Capsule: ends in the telescope's frame, radius."""


def clearance_shapes(spec: MachineSpec, chassis_height_m: float = 0.85) -> ClearanceShapes:
    """Shapes of the spec; `chassis_height_m` is the height of the chassis body above ground (MJCF)."""
    by_name = {shape.name: shape for shape in spec.collision_shapes}
    spheres: list[tuple[float, float]] = []
    chassis: list[tuple[Point, Point]] = []
    upper: list[tuple[Point, Point]] = []
    for shape in spec.collision_shapes:
        if shape.body == "gripper" and shape.kind == "capsule":
            below, half = -shape.position_m[2], shape.size_m[1]
            spheres += [(below + half * s, shape.size_m[0]) for s in (-1.0, 0.0, 1.0)]
        elif shape.body == "gripper":
            spheres.append((-shape.position_m[2], shape.size_m[0]))
        elif shape.kind == "box":
            lift = (
                chassis_height_m if shape.body == "chassis" else spec.geometry.slew_frame_height_m
            )
            x, y, z = shape.position_m
            (chassis if shape.body == "chassis" else upper).append(((x, y, z + lift), shape.size_m))
    return ClearanceShapes(
        spheres=tuple(spheres),
        chassis_boxes=tuple(chassis),
        upper_boxes=tuple(upper),
        boom=_capsule(by_name["boom_obstacle"]),
        dipper=_capsule(by_name["dipper_obstacle"]),
        telescope=_capsule(by_name["telescope_obstacle"]),
    )


def _capsule(shape: CollisionShape) -> tuple[Point, Point, float]:
    """Ends of a capsule's axis in its body's frame: position +- R(quaternion) e_z half length."""
    w, x, y, z = shape.quaternion_wxyz_ratio
    axis = np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])
    centre, half = np.asarray(shape.position_m), shape.size_m[1]
    first, second = centre - half * axis, centre + half * axis
    return (
        (float(first[0]), float(first[1]), float(first[2])),
        (float(second[0]), float(second[1]), float(second[2])),
        shape.size_m[0],
    )


def clearance(spec: MachineSpec, shapes: ClearanceShapes, q: Any) -> Any:
    """Smallest distance (N,) of the gripper from ground, machine and arm for positions q (N, 6), m."""
    xp, g = namespace(q), spec.geometry
    boom, tube = q[..., 1], q[..., 1] + q[..., 2]
    swing, roll = tube + q[..., 4], q[..., 5]
    cb, sb, ct, st = xp.cos(boom), xp.sin(boom), xp.cos(tube), xp.sin(tube)
    pivot_x, pivot_z = g.boom_pivot_m[0], g.slew_frame_height_m + g.boom_pivot_m[2]
    tip_x, tip_z = pivot_x + g.boom_length_m * cb, pivot_z + g.boom_length_m * sb
    tube_length = g.dipper_to_telescope_m + q[..., 3]
    tele_x = tip_x + g.telescope_axis_offset_m * ct + tube_length * st
    tele_z = tip_z + g.telescope_axis_offset_m * st - tube_length * ct
    pin_x = tele_x + g.telescope_to_pin_m * st
    pin_z = tele_z - g.telescope_to_pin_m * ct
    capsules = (
        _placed(shapes.boom, pivot_x, pivot_z, cb, sb),
        _placed(shapes.dipper, tip_x, tip_z, ct, st),
        _placed(shapes.telescope, tele_x, tele_z, ct, st),
    )
    ss, cs, sr, cr = xp.sin(swing), xp.cos(swing), xp.sin(roll), xp.cos(roll)
    slew_c, slew_s = xp.cos(q[..., 0]), xp.sin(q[..., 0])
    # All spheres at once, (S, N): a Python loop over them doubles the compile time on a GPU.
    below, radius = (
        xp.asarray(column).reshape(-1, *[1] * boom.ndim)
        for column in zip(*shapes.spheres, strict=True)
    )
    down = g.pitch_to_roll_m + below * cr
    point = (pin_x + down * ss, below * sr, pin_z - down * cs)
    smallest = point[2] - radius
    for first, second, capsule_radius in capsules:
        smallest = xp.minimum(smallest, _to_segment(point, first, second) - radius - capsule_radius)
    beside = (point[0], point[1] + g.arm_plane_offset_m, point[2])
    for centre, half in shapes.upper_boxes:
        smallest = xp.minimum(smallest, _to_box(beside, centre, half) - radius)
    fixed = (
        slew_c * beside[0] - slew_s * beside[1],
        slew_s * beside[0] + slew_c * beside[1],
        beside[2],
    )
    for centre, half in shapes.chassis_boxes:
        smallest = xp.minimum(smallest, _to_box(fixed, centre, half) - radius)
    return smallest.min(axis=0)


def _placed(
    capsule: tuple[Point, Point, float], x: Any, z: Any, c: Any, s: Any
) -> tuple[Point, Point, float]:
    """Ends of a capsule in the arm plane: rotated by the body's angle, shifted to its origin."""
    first, second, radius = capsule
    return _turned(first, x, z, c, s), _turned(second, x, z, c, s), radius


def _turned(point: Point, x: Any, z: Any, c: Any, s: Any) -> Point:
    return (x + c * point[0] - s * point[2], point[1], z + s * point[0] + c * point[2])


def _to_segment(point: Point, first: Point, second: Point) -> Any:
    """Distance of points to segments."""
    xp = namespace(point[0])
    ux, uy, uz = (b - a for a, b in zip(first, second, strict=True))
    px, py, pz = (b - a for a, b in zip(first, point, strict=True))
    along = (px * ux + py * uy + pz * uz) / (ux * ux + uy * uy + uz * uz)
    t = xp.clip(along, 0.0, 1.0)
    return xp.sqrt((px - t * ux) ** 2 + (py - t * uy) ** 2 + (pz - t * uz) ** 2 + 1e-12)


def _to_box(point: Point, centre: Point, half: Point) -> Any:
    """Signed distance of points to an axis-aligned box (negative inside)."""
    xp = namespace(point[0])
    dx, dy, dz = (abs(p - c) - h for p, c, h in zip(point, centre, half, strict=True))
    outside = xp.sqrt(
        xp.maximum(dx, 0.0) ** 2 + xp.maximum(dy, 0.0) ** 2 + xp.maximum(dz, 0.0) ** 2
    )
    return outside + xp.minimum(xp.maximum(dx, xp.maximum(dy, dz)), 0.0)
