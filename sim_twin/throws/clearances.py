"""How close a predicted motion comes to ground, machine and joint limits; geometry only, no dynamics."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import mujoco
import numpy as np

from machine.conventions import ACTIVE_JOINTS, Array
from machine.site.objects import SiteKind
from machine.site.solids import Solids
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
ARM_SHAPES = ("boom_obstacle", "dipper_obstacle", "telescope_obstacle", *GRIPPER_SHAPES)
"""Everything that moves out over the yard; capsules and spheres, all of them."""
SITE_MARGIN_M = 0.2
"""Kept from objects of the site. Chosen by eye: people say where things stand with a tape measure."""
TO_SITE = "arm or gripper to "
"""Begins the names of clearances from objects of the site."""
SAMPLE_SPACING_M = 0.15
"""Of points on the axes of capsules; a corner between two of them is seen 15 mm too far off at most."""


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
    frames_rad_m: Array,
    period_s: float,
    known: Sequence[Clearance] = (),
    known_count: int = 0,
    solids: Solids | None = None,
) -> list[Clearance]:
    """Distances from everything solid, over frames (T, 6): gripper to machine and ground, arm to the site.

    Args:
        frames_rad_m: joint positions.
        period_s: from frame to frame.
        known: what this function returned for the first `known_count` frames; they are not looked at again.
        known_count: how many.
        solids: what stands around the machine.
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
    arm = _ArmPoints(model)
    places: list[Array] = []
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
        if solids is not None and solids.objects:
            places.append(arm.places(data))
    if solids is not None and places:
        _note_site(smallest, solids, arm.distances(np.stack(places), solids), known_count)
    return [
        Clearance(name, distance, SITE_MARGIN_M if name.startswith(TO_SITE) else 0.0, at, "m")
        for name, (distance, index) in smallest.items()
        for at in (index * period_s,)
    ]


def _note_site(
    smallest: dict[str, tuple[float, int]], solids: Solids, near_m: Array, first: int
) -> None:
    """Take the smallest of distances (T, K) from the site's objects into `smallest`."""
    for column, item in enumerate(solids.objects):
        if item.kind is SiteKind.PIT:
            continue  # nothing of it stands in the way
        name, at = TO_SITE + item.name, int(near_m[:, column].argmin())
        distance = float(near_m[at, column])
        if distance < smallest.get(name, (FAR_M, 0))[0]:
            smallest[name] = (distance, first + at)


class _ArmPoints:
    """Points on the axes of the arm's collision shapes, which stand for spheres of the shapes' radii."""

    def __init__(self, model: mujoco.MjModel) -> None:
        ids: list[int] = []
        along: list[float] = []
        for name in ARM_SHAPES:
            geom = model.geom(name)
            half_m = float(geom.size[1]) if geom.type[0] == mujoco.mjtGeom.mjGEOM_CAPSULE else 0.0
            count = 1 + int(np.ceil(2.0 * half_m / SAMPLE_SPACING_M))
            ids += [int(geom.id)] * count
            along += np.linspace(-half_m, half_m, count).tolist()
        self._ids, self._along = np.array(ids), np.array(along)[:, None]
        self._radius_m: Array = model.geom_size[self._ids, 0]

    def places(self, data: mujoco.MjData) -> Array:
        """Where the points (P, 3) are as the arm stands in `data`."""
        axes = data.geom_xmat[self._ids].reshape(-1, 3, 3)[:, :, 2]
        return data.geom_xpos[self._ids] + self._along * axes

    def distances(self, places_m: Array, solids: Solids) -> Array:
        """Distances (T, K) of the arm at places (T, P, 3) from the objects of a site."""
        return (solids.distances(places_m)[..., 1:] - self._radius_m[:, None]).min(axis=1)


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
