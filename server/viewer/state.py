"""What one operator's session shows in its 3D view; kept on the server, so that a reload shows it again."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np

from machine.conventions import Array, Mode
from machine.messages import LandingEllipse
from machine.site.objects import SiteObject
from machine.site.zones import Corner, Zone
from server.viewer.replay import Playback, ThrowMotion
from server.viewer.shapes import LaidMaterial
from server.viewer.theme import CameraPreset, ThemeName

Point = tuple[float, float, float]
PickFor = Literal["target", "point"]
SAME_TARGET_M = 1e-3


@dataclass(frozen=True)
class Reach:
    """Distances from the slew axis on the ground, m; None where a mode has no usable policy."""

    static_m: float
    planar_m: float | None = None
    spatial_m: float | None = None
    min_m: float = 0.0
    mode: Mode | None = None
    """Ground out of this mode's reach is dimmed; None dims what no mode reaches."""
    raised_m: float | None = None
    """As far as this mode (or any) reaches at the target's height; None where it is as on the ground."""
    height_m: float = 0.0
    """Of the target, above ground."""

    @property
    def dimmed_beyond_m(self) -> float:
        """Where the dimmed ground begins."""
        by_mode = {Mode.PLANAR: self.planar_m, Mode.SPATIAL: self.spatial_m}
        known = [r for r in by_mode.values() if r is not None] or [self.static_m]
        chosen = None if self.mode is None else by_mode[self.mode]
        return max(known) if chosen is None else chosen


@dataclass(frozen=True)
class ShownPlan:
    """A previewed throw."""

    target_m: Point
    motion: ThrowMotion
    impact_m: Point | None
    ellipse: LandingEllipse | None
    is_estimate: bool = False
    """The target moved on: of this plan only the ellipse is drawn, where it would about lie."""

    def estimate_at(self, target_m: Point) -> "ShownPlan":
        """Estimated plan for a target nearby, until it is previewed itself.

        In frame `throw` the ellipse keeps its mean and its correlation; its standard deviations grow with
        the range, because errors of speed and direction at the release do.
        """
        ellipse = self.ellipse
        before_m, after_m = (math.hypot(p[0], p[1]) for p in (self.target_m, target_m))
        if ellipse is not None and before_m > 0.0:
            scale = after_m / before_m
            changes = {
                "sd_downrange_m": scale * ellipse.sd_downrange_m,
                "sd_crossrange_m": scale * ellipse.sd_crossrange_m,
            }
            ellipse = ellipse.model_copy(update=changes)
        return ShownPlan(target_m, self.motion, None, ellipse, is_estimate=True)


@dataclass(frozen=True)
class ImpactMarks:
    """Impacts drawn as crosses; the last one may be the throw just made."""

    points_m: Array = field(default_factory=lambda: np.zeros((0, 3)))
    """Shape (N, 3), frame `machine`."""
    latest: Point | None = None
    latest_text: str = ""
    """For people, with signs: ``+0.12 m long, 0.05 m left``."""


class LiveSample(NamedTuple):
    """The newest pose of a machine."""

    number: int
    """Grows with every sample."""
    joints_rad_m: Array
    ball_m: Point | None
    is_load_held: bool


@dataclass(frozen=True)
class ReplayState:
    """Where a replay stands."""

    at_s: float
    duration_s: float
    is_playing: bool


class ZoneOutline(NamedTuple):
    """Corners so far and heights of a zone that is being drawn."""

    corners_m: tuple[Corner, ...]
    bottom_m: float = 0.0
    top_m: float = 3.0


@dataclass
class ShownSession:
    """Everything drawn for one session."""

    machine_id: str | None = None
    target_m: Point | None = None
    site: tuple[SiteObject, ...] = ()
    is_picking: bool = True
    pick_for: PickFor = "target"
    """What a click gives: the target, or a point for the page around the view."""
    zones: tuple[Zone, ...] = ()
    """Approved."""
    draft_zones: tuple[Zone, ...] = ()
    sketch: ZoneOutline = field(default_factory=lambda: ZoneOutline(()))
    """The zone that is being drawn."""
    material: LaidMaterial | None = None
    """Of the machine's open job."""
    reach: Reach | None = None
    plan: ShownPlan | None = None
    preview: Playback | None = None
    impacts: ImpactMarks = field(default_factory=ImpactMarks)
    replay: Playback | None = None
    replay_ghost: Playback | None = None
    replay_site: tuple[SiteObject, ...] | None = None
    """What stood there when the replayed throw was made; None where nobody knows."""
    theme: ThemeName = "light"
    camera: CameraPreset = "3d"
    camera_count: int = 0
    """Grows with every asked camera change."""

    def move_target(self, target_m: Point | None) -> None:
        """Set or remove the target; what was previewed for another one becomes an estimate."""
        self.target_m = target_m
        if self.plan is not None and target_m is not None and not _is_same(self.plan, target_m):
            self.plan, self.preview = self.plan.estimate_at(target_m), None

    def take_plan(self, plan: ShownPlan, *, play: bool) -> None:
        """Show a preview; one that arrives after its target was moved on is an estimate."""
        if self.target_m is not None and not _is_same(plan, self.target_m):
            self.plan, self.preview = plan.estimate_at(self.target_m), None
            return
        self.plan, self.target_m = plan, plan.target_m
        self.preview = Playback(plan.motion) if play else None

    @property
    def drawn_material(self) -> LaidMaterial | None:
        """Bulk material that lies there now; what lay there at a replayed throw nobody knows."""
        return self.material if self.replay is None else None

    @property
    def drawn_site(self) -> tuple[SiteObject, ...]:
        """What stands around the machine in what is shown: today's site, or that of the replay."""
        if self.replay is None or self.replay_site is None:
            return self.site
        return self.replay_site


def _is_same(plan: ShownPlan, target_m: Point) -> bool:
    return not plan.is_estimate and math.dist(plan.target_m, target_m) < SAME_TARGET_M


def as_joints(values: Sequence[float] | Array) -> Array:
    """Joint positions as an array (6,).

    Raises:
        ValueError: not six finite numbers.
    """
    joints = np.asarray(values, dtype=np.float64)
    if joints.shape != (6,) or not np.isfinite(joints).all():
        raise ValueError(f"Six finite joint positions needed, got {values!r}.")
    return joints
