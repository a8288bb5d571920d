"""A previewed throw against exclusion zones: target, arm and gripper, flight, 99.9 % landing region.

Polygons by shapely. The machine checks again with code of its own (runtime/guard/zones.py).
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import mujoco
import numpy as np
import shapely
from scipy.special import fdtri

from machine.conventions import Array, BoolArray
from machine.messages import LandingEllipse, RejectReason, Target
from machine.site.zones import Zone
from sim_twin.rigid_body.model import twin_model
from sim_twin.throws.clearances import SITE_MARGIN_M, TO_SITE, ArmPoints, Clearance
from sim_twin.throws.refusals import PreviewRefusal

REGION_RATIO = 0.999
"""Share of the loads that come down in the landing region."""
MIN_LANDED_COUNT = 4
"""Fewest landings from which a region can be estimated."""
OUTLINE_POINT_COUNT = 64


class _Overlap(NamedTuple):
    zone: Zone
    depth_m: float
    height_m: float


class ZoneCheck:
    """Zones of one machine, and a load of one size."""

    def __init__(self, zones: Sequence[Zone], radius_m: float) -> None:
        self._zones = tuple(zones)
        self._areas = [shapely.Polygon(zone.corners_m) for zone in zones]
        self._radius_m = radius_m
        shapely.prepare(self._areas)

    @property
    def is_empty(self) -> bool:
        """Whether there are no zones."""
        return not self._zones

    def target_refusal(self, target: Target) -> PreviewRefusal | None:
        """Refusal of a target on which a load would lie in a zone."""
        place = shapely.Point(target.x_m, target.y_m)
        for zone, area in zip(self._zones, self._areas, strict=True):
            if not self._overlaps_height(zone, target.z_m, target.z_m):
                continue
            is_inside = bool(shapely.contains(area, place))
            edge_m = float(shapely.distance(area.exterior, place))
            depth_m = self._radius_m + (edge_m if is_inside else -edge_m)
            if depth_m > 0.0:
                reaches = f"a load at the target reaches {depth_m:.2f} m into"
                return _refusal(f"{reaches} {_named(zone)}")
        return None

    def clearances(self, frames_rad_m: Array, period_s: float) -> tuple[Clearance, ...]:
        """Smallest distance of arm and gripper from each zone over frames (T, 6)."""
        if self.is_empty or not len(frames_rad_m):
            return ()
        model, _ = twin_model()
        data, arm = mujoco.MjData(model), ArmPoints(model)
        places: list[Array] = []
        for frame in frames_rad_m:
            data.qpos[:] = frame
            mujoco.mj_kinematics(model, data)
            places.append(arm.places(data))
        points = np.stack(places)
        found: list[Clearance] = []
        for zone, area in zip(self._zones, self._areas, strict=True):
            gap = (_distances_m(zone, area, points) - arm.radius_m).min(axis=1)
            at = int(gap.argmin())
            name = f"{TO_SITE}zone {zone.name}"
            found.append(Clearance(name, float(gap[at]), SITE_MARGIN_M, at * period_s, "m"))
        return tuple(found)

    def flight_refusals(
        self,
        path_m: Array,
        target: Target,
        impact_m: tuple[float, float, float] | None,
        ellipse: LandingEllipse | None = None,
    ) -> tuple[PreviewRefusal, ...]:
        """Refusals of the load's flight and of the region in which it comes down.

        Args:
            path_m: (M, 3) the nominal flight at equal times, from release to impact.
            target: of the throw.
            impact_m: the nominal impact.
            ellipse: of the scattered throws; None: only the nominal flight is looked at.
        """
        if self.is_empty or impact_m is None or not len(path_m):
            return ()
        if ellipse is None:
            outlines = np.zeros((len(path_m), 1, 2))
        elif ellipse.landed_count < MIN_LANDED_COUNT:
            text = f"{ellipse.landed_count} predicted throws land, too few to keep them out of the zones"
            return (PreviewRefusal(RejectReason.PREVIEW_REFUSED, f"Refused: {text}."),)
        else:
            # Loads leave from one place and scatter more and more on their way.
            share = np.linspace(0.0, 1.0, len(path_m))[:, None, None]
            outlines = share * (region_m(ellipse, target) - impact_m[:2])
            region = self._deepest(outlines[-1:] + impact_m[:2], np.array([target.z_m]))
            if region is not None:
                reaches = f"the landing region (99.9 %) reaches {region.depth_m:.2f} m into"
                return (_refusal(f"{reaches} {_named(region.zone)}"),)
        flight = self._deepest(outlines + path_m[:, None, :2], path_m[:, 2] - self._radius_m)
        if flight is None:
            return ()
        text = f"the load flies {flight.depth_m:.2f} m inside {_named(flight.zone)}, {flight.height_m:.1f} m"
        return (_refusal(f"{text} above ground"),)

    def _deepest(self, outlines_m: Array, bottom_m: Array) -> _Overlap | None:
        """The overlap of loads' outlines (M, P, 2), undersides at heights (M,), that is deepest."""
        if outlines_m.shape[1] == 1:
            areas = shapely.points(outlines_m[:, 0])
        else:
            areas = shapely.convex_hull(shapely.multipoints(outlines_m))
        grown: Any = shapely.buffer(areas, self._radius_m)
        # From one moment to the next a load passes all heights between.
        following = np.append(bottom_m[1:], bottom_m[-1:])
        low, high = np.minimum(bottom_m, following), np.maximum(bottom_m, following)
        deepest: _Overlap | None = None
        for zone, area in zip(self._zones, self._areas, strict=True):
            near = shapely.intersects(area, grown) & self._overlaps_height(zone, low, high)
            for index in np.flatnonzero(near).tolist():
                depth_m = _depth_m(area, grown[index])
                if depth_m > (0.0 if deepest is None else deepest.depth_m):
                    deepest = _Overlap(zone, depth_m, float(bottom_m[index]) + self._radius_m)
        return deepest

    def _overlaps_height(
        self, zone: Zone, low_m: Array | float, high_m: Array | float
    ) -> BoolArray | bool:
        """Whether a load whose underside is between two heights is at a height of the zone."""
        return (high_m + 2.0 * self._radius_m > zone.bottom_m) & (low_m < zone.top_m)


def region_m(ellipse: LandingEllipse, target: Target) -> Array:
    """Outline (P, 2) of the 99.9 % landing region, frame `machine`.

    Of a normal distribution that is estimated from `landed_count` throws (Hotelling's T2).
    """
    n = ellipse.landed_count
    quantile = float(fdtri(2, n - 2, REGION_RATIO))
    scale = math.sqrt(2.0 * (n - 1) * (n + 1) / (n * (n - 2)) * quantile)
    sx, sy = ellipse.sd_downrange_m, ellipse.sd_crossrange_m
    shared = ellipse.correlation_ratio * sx * sy
    # A small number on the diagonal: throws that never scatter have a singular covariance.
    root = np.linalg.cholesky(np.array([[sx * sx, shared], [shared, sy * sy]]) + 1e-12 * np.eye(2))
    angle = np.linspace(0.0, 2.0 * np.pi, OUTLINE_POINT_COUNT, endpoint=False)
    # Circumscribed, so that the polygon holds the ellipse.
    circle = np.stack([np.cos(angle), np.sin(angle)], -1) / math.cos(math.pi / OUTLINE_POINT_COUNT)
    local = scale * circle @ root.T
    local += (ellipse.mean_downrange_error_m, ellipse.mean_crossrange_error_m)
    bearing = math.atan2(target.y_m, target.x_m)
    cos, sin = math.cos(bearing), math.sin(bearing)
    x_m = target.x_m + cos * local[:, 0] - sin * local[:, 1]
    y_m = target.y_m + sin * local[:, 0] + cos * local[:, 1]
    return np.stack([x_m, y_m], axis=-1)


def _distances_m(zone: Zone, area: shapely.Polygon, points_m: Array) -> Array:
    """Signed distances (...) of points (..., 3) from a zone, negative inside."""
    places = shapely.points(points_m[..., :2])
    level = shapely.distance(area, places)
    inside = shapely.distance(area.exterior, places)
    level = np.where(level > 0.0, level, -inside)
    z = points_m[..., 2]
    upright = np.maximum(zone.bottom_m - z, z - zone.top_m)
    outside = np.hypot(np.maximum(level, 0.0), np.maximum(upright, 0.0))
    return outside + np.minimum(np.maximum(level, upright), 0.0)


def _depth_m(area: shapely.Polygon, body: shapely.Geometry) -> float:
    """How far a body reaches into an area; 0 where they are apart."""
    shared = shapely.intersection(area, body)
    if shared.is_empty:
        return 0.0
    corners = shapely.points(shapely.get_coordinates(shared))
    return float(shapely.distance(area.exterior, corners).max())


def _named(zone: Zone) -> str:
    return f"zone '{zone.name}', which is kept free up to {zone.top_m:.1f} m"


def _refusal(text: str) -> PreviewRefusal:
    remedy = "Choose another target."
    return PreviewRefusal(RejectReason.TARGET_IN_ZONE, f"Refused: {text}. {remedy}")
