"""Clearances of a predicted motion from ground, machine, site and joint limits."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import mujoco
import numpy as np

from machine.conventions import ACTIVE_JOINTS, Array
from machine.site.objects import SiteKind
from machine.site.solids import Solids
from machine.spec import MachineSpec
from sim_twin.rigid_body.model import twin_model

FAR_M = 20.0
"""Largest distance that is evaluated."""
OBSTACLES: dict[str, tuple[str, ...]] = {
    "gripper to ground": ("ground",),
    "gripper to chassis": ("chassis_obstacle",),
    "gripper to cabin": ("cabin_obstacle",),
    "gripper to upper carriage": ("upper_obstacle",),
    "gripper to arm": ("boom_obstacle", "dipper_obstacle", "telescope_obstacle"),
}
"""Name of a clearance, as shown to operators, and its collision shapes in m545.xml."""
GRIPPER_SHAPES = ("gripper_body_collision", "gripper_claw_collision")
ARM_SHAPES = ("boom_obstacle", "dipper_obstacle", "telescope_obstacle", *GRIPPER_SHAPES)
"""Shapes of arm and gripper; all are capsules or spheres."""
SITE_MARGIN_M = 0.2
"""Required distance from objects of the site: allows for positions measured with a tape."""
TO_SITE = "arm or gripper to "
"""Prefix of the names of clearances from objects of the site."""
SAMPLE_SPACING_M = 0.15
"""Spacing of points on the axes of capsules; distances from corners are overestimated by at most 15 mm."""


class Clearance(NamedTuple):
    """Smallest clearance of one kind over a motion; m, or rad for position limits of hinges."""

    name: str
    value_rad_m: float
    """Negative for penetration."""
    limit_rad_m: float
    """Smallest allowed clearance."""
    at_s: float
    """Time from the start of the motion."""
    unit: str
    """``m`` or ``rad``."""


def solid_clearances(
    frames_rad_m: Array,
    period_s: float,
    known: Sequence[Clearance] = (),
    known_count: int = 0,
    solids: Solids | None = None,
) -> list[Clearance]:
    """Smallest distances over frames (T, 6): gripper to machine and ground, arm to objects of the site.

    Args:
        frames_rad_m: joint positions.
        period_s: time between frames.
        known: result for the first `known_count` frames, which are not evaluated again.
        known_count: number of these frames.
        solids: objects around the machine.
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
    arm = ArmPoints(model)
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
    """Merge the smallest of distances (T, K) from the site's objects into `smallest`."""
    for column, item in enumerate(solids.objects):
        if item.kind is SiteKind.PIT:
            continue  # A pit is no obstacle above ground.
        name, at = TO_SITE + item.name, int(near_m[:, column].argmin())
        distance = float(near_m[at, column])
        if distance < smallest.get(name, (FAR_M, 0))[0]:
            smallest[name] = (distance, first + at)


class ArmPoints:
    """Points on the axes of the arm's collision shapes: centres of spheres with the shapes' radii."""

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
        self.radius_m: Array = model.geom_size[self._ids, 0]
        """(P,)"""

    def places(self, data: mujoco.MjData) -> Array:
        """Positions (P, 3) of the points for the pose in `data`."""
        axes = data.geom_xmat[self._ids].reshape(-1, 3, 3)[:, :, 2]
        return data.geom_xpos[self._ids] + self._along * axes

    def distances(self, places_m: Array, solids: Solids) -> Array:
        """Distances (T, K) of points (T, P, 3) from the objects of a site."""
        return (solids.distances(places_m)[..., 1:] - self.radius_m[:, None]).min(axis=1)


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
