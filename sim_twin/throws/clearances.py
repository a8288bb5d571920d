"""How close a predicted motion comes to ground, machine and joint limits; geometry only, no dynamics."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import mujoco
import numpy as np

from machine.conventions import ACTIVE_JOINTS, Array
from machine.spec import MachineSpec
from sim_twin.twin.model import twin_model

FAR_M = 20.0
OBSTACLES: dict[str, tuple[str, ...]] = {
    "gripper to ground": ("ground",),
    "gripper to chassis": ("chassis_obstacle",),
    "gripper to cabin": ("cabin_obstacle",),
    "gripper to upper carriage": ("upper_obstacle",),
    "gripper to arm": ("boom_obstacle", "dipper_obstacle", "telescope_obstacle"),
}
"""What the operator is told -> collision shapes of m545.xml."""
GRIPPER_SHAPES = ("gripper_body_collision", "gripper_claw_collision")


class Clearance(NamedTuple):
    """Smallest distance of one kind over a motion; metres, radians for the hinges' limits."""

    name: str
    value_rad_m: float
    """Negative where it overlaps."""
    limit_rad_m: float
    """Below this the motion is refused."""
    at_s: float
    """When, from the start of the motion."""
    unit: str
    """``m`` or ``rad``."""


def solid_clearances(
    frames_rad_m: Array, period_s: float, known: Sequence[Clearance] = (), known_count: int = 0
) -> list[Clearance]:
    """Distances between the gripper's collision shapes and everything solid, over frames (T, 6).

    Args:
        frames_rad_m: joint positions.
        period_s: from frame to frame.
        known: what this function returned for the first `known_count` frames; they are not looked at again.
        known_count: how many.
    """
    model, _ = twin_model()
    data = mujoco.MjData(model)
    pairs = {
        name: [
            (model.geom(mine).id, model.geom(other).id)
            for mine in GRIPPER_SHAPES
            for other in others
        ]
        for name, others in OBSTACLES.items()
    }
    smallest: dict[str, tuple[float, int]] = dict.fromkeys(pairs, (FAR_M, 0))
    smallest |= {c.name: (c.value_rad_m, round(c.at_s / period_s)) for c in known}
    segment = np.zeros(6)
    for index, frame in enumerate(frames_rad_m[known_count:], known_count):
        data.qpos[:] = frame
        mujoco.mj_kinematics(model, data)
        for name, ids in pairs.items():
            distance = min(
                float(mujoco.mj_geomDistance(model, data, mine, other, FAR_M, segment))
                for mine, other in ids
            )
            if distance < smallest[name][0]:
                smallest[name] = (distance, index)
    return [
        Clearance(name, distance, 0.0, index * period_s, "m")
        for name, (distance, index) in smallest.items()
    ]


def limit_clearances(
    spec: MachineSpec, frames_rad_m: Array, period_s: float
) -> Iterator[Clearance]:
    """Distances of the limited active joints from their nearer limit, over frames (T, 6)."""
    low, high = spec.position_range_rad_m
    for joint in np.flatnonzero(np.isfinite(low)):
        position = frames_rad_m[:, joint]
        margin = np.minimum(position - low[joint], high[joint] - position)
        at = int(np.argmin(margin))
        unit = "m" if ACTIVE_JOINTS[joint] == "telescope" else "rad"
        name = f"{ACTIVE_JOINTS[joint]} to its limit"
        yield Clearance(name, float(margin[at]), 0.0, at * period_s, unit)
