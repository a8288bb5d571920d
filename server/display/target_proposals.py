"""Proposed targets: each session's target point, from a click in the 3D view or from the fields."""

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal

from machine.conventions import Mode
from machine.errors import RefusedError
from machine.messages import MachineState, Target
from machine.reach import check_target
from machine.spec import MachineSpec
from server.display.impact_display import ImpactDisplay
from server.errors import ApiError
from server.event_hub import EventHub
from server.machines.machine_registry import KnownMachine, MachineRegistry
from server.plans.policy_store import PolicyStore
from server.plans.site_store import SiteStore
from server.plans.zone_store import ZoneStore
from server.schemas.console import TargetView, ViewRequest
from server.schemas.events import PointPickedEvent, TargetProposedEvent
from server.viewer.pick import PickRefusedError
from server.viewer.scene import ViewerScene
from server.viewer.state import PickFor, Reach
from sim_twin.throws.zone_check import ZoneCheck

Source = Literal["pick", "fields"]
SAME_REACH_M = 0.05
"""Reach rings closer to each other than this are drawn as one; labels have a resolution of 0.1 m."""


@dataclass(slots=True)
class ViewContext:
    """Machine, mode and targets of a session's 3D view."""

    machine_id: str | None = None
    mode: Mode | None = None
    targets: dict[str, Target] = field(default_factory=dict[str, Target])
    reach: Reach | None = None
    """As last drawn."""
    pick_for: PickFor = "target"


class TargetProposals:
    """Targets and 3D view settings of all sessions."""

    def __init__(
        self,
        scene: ViewerScene,
        policies: PolicyStore,
        sites: SiteStore,
        zones: ZoneStore,
        hub: EventHub,
        impacts: ImpactDisplay,
        registry: MachineRegistry,
        spec: MachineSpec,
    ) -> None:
        self._ball_radius_m = spec.ball.radius_m
        self._scene = scene
        self._sites = sites
        self._zones = zones
        self._impacts = impacts
        self._policies = policies
        self._hub = hub
        self.on_watch: list[Callable[[str, str], None]] = []
        """Called with session and machine when a session chooses what it watches."""
        self._lock = threading.Lock()
        self._contexts: dict[str, ViewContext] = {}
        self._aboard: dict[str, Mapping[str, str]] = {}
        """Policy versions on board by machine: sha256 by mode."""
        registry.on_state.append(self._take_state)

    def _context(self, session_id: str) -> ViewContext:
        with self._lock:
            return self._contexts.setdefault(session_id, ViewContext())

    def target_of(self, session_id: str, machine_id: str) -> TargetView | None:
        """The proposed target of a session for a machine."""
        target = self._context(session_id).targets.get(machine_id)
        return None if target is None else TargetView.of(target)

    def propose(
        self, session_id: str, machine_id: str, target: Target, mode: Mode | None, source: Source
    ) -> TargetView:
        """Set a session's target and show it."""
        context = self._context(session_id)
        context.targets[machine_id] = target
        context.mode = mode or context.mode
        if source == "fields" and context.machine_id == machine_id:
            self._show_target(session_id, target)
        self._draw_reach(session_id)
        view = TargetView.of(target)
        refusal = self._zone_refusal(machine_id, target) or self._refusal(
            machine_id, target, context.mode
        )
        self._tell(session_id, machine_id, view, source, refusal)
        return view

    def remove(self, session_id: str, machine_id: str) -> None:
        """Remove a session's target and its preview."""
        self._context(session_id).targets.pop(machine_id, None)
        self._scene.set_target(session_id, None)
        self._scene.clear_plan(session_id)
        self._draw_reach(session_id)
        self._tell(session_id, machine_id, None, "fields", "")

    def take_pick(self, session_id: str, point_m: tuple[float, float, float]) -> None:
        """A click in the 3D view."""
        context = self._context(session_id)
        if context.machine_id is None:
            return
        if context.pick_for == "point":
            x_m, y_m, z_m = point_m
            event = PointPickedEvent(
                machine_id=context.machine_id, session_id=session_id, x_m=x_m, y_m=y_m, z_m=z_m
            )
            self._hub.publish(event, session_id)
            return
        target = Target(x_m=point_m[0], y_m=point_m[1], z_m=point_m[2])
        self.propose(session_id, context.machine_id, target, None, "pick")

    def take_refused_pick(self, session_id: str, error: PickRefusedError) -> None:
        """A click that gave no target."""
        context = self._context(session_id)
        # Where a point is asked for, a click that gives none says nothing about the target.
        if context.machine_id is not None and context.pick_for == "target":
            self._tell(session_id, context.machine_id, None, "pick", str(error))

    def set_view(self, session_id: str, request: ViewRequest) -> None:
        """Change what a session's 3D view shows."""
        context = self._context(session_id)
        if request.machine_id is not None:
            is_other = context.machine_id != request.machine_id
            context.machine_id = request.machine_id
            self._scene.show_machine(session_id, request.machine_id)
            if is_other:
                # The scene forgets the marks around the machine before, rings and target among them.
                context.reach = None
                self._show_target(session_id, context.targets.get(request.machine_id))
            self._impacts.watch(session_id, request.machine_id)
            self._scene.set_site(session_id, self._sites.objects(request.machine_id))
            self._show_zones(session_id, request.machine_id)
            for listener in self.on_watch:
                listener(session_id, request.machine_id)
        if request.mode is not None:
            context.mode = request.mode
        if request.machine_id is not None or request.mode is not None:
            self._draw_reach(session_id)
        if request.theme is not None:
            self._scene.set_theme(session_id, request.theme)
        if request.camera is not None:
            self._scene.set_camera(session_id, request.camera)
        if request.is_picking is not None:
            self._scene.set_picking(session_id, request.is_picking)
        if request.pick_for is not None:
            context.pick_for = request.pick_for
            self._scene.set_pick_for(session_id, request.pick_for)
        if request.sketch is not None:
            sketch = request.sketch
            self._scene.set_sketch(session_id, sketch.corners_m, sketch.bottom_m, sketch.top_m)
        if request.play_preview:
            self._scene.play_preview(session_id)

    def _take_state(self, known: KnownMachine, state: MachineState) -> None:
        """Redraw the reach in all sessions that watch a machine whose policies changed."""
        if self._aboard.get(known.machine_id) == state.policy_sha256:
            return
        self._aboard[known.machine_id] = state.policy_sha256
        for session_id in self._watching(known.machine_id):
            self._draw_reach(session_id)

    def _show_target(self, session_id: str, target: Target | None) -> None:
        point = None if target is None else (target.x_m, target.y_m, target.z_m)
        self._scene.set_target(session_id, point)

    def _watching(self, machine_id: str) -> list[str]:
        """Sessions that watch a machine."""
        with self._lock:
            return [
                session_id
                for session_id, context in self._contexts.items()
                if context.machine_id == machine_id
            ]

    def show_zones(self, machine_id: str) -> None:
        """Redraw changed exclusion zones in all sessions that watch their machine."""
        for session_id in self._watching(machine_id):
            self._show_zones(session_id, machine_id)

    def _show_zones(self, session_id: str, machine_id: str) -> None:
        active = self._zones.approved(machine_id).zones
        self._scene.set_zones(session_id, active, self._zones.draft(machine_id))

    def show_site(self, machine_id: str) -> None:
        """Redraw a changed site in all sessions that watch its machine."""
        for session_id in self._watching(machine_id):
            self._scene.set_site(session_id, self._sites.objects(machine_id))

    def end_session(self, session_id: str) -> None:
        """Forget a session."""
        self._impacts.end_session(session_id)
        with self._lock:
            self._contexts.pop(session_id, None)

    def _draw_reach(self, session_id: str) -> None:
        """Draw the rings where mode, policies or the height of the session's target have changed."""
        context = self._context(session_id)
        machine_id = context.machine_id or ""
        target = context.targets.get(machine_id)
        reach = self._reach(self._aboard.get(machine_id, {}), context.mode, target)
        if reach != context.reach:
            context.reach = reach
            self._scene.set_reach(session_id, reach)

    def _reach(self, aboard: Mapping[str, str], mode: Mode | None, target: Target | None) -> Reach:
        reach = self._policies.reach(aboard)
        by_mode = {item.mode: item for item in reach.modes}
        chosen = [by_mode[mode]] if mode is not None and mode in by_mode else list(by_mode.values())
        planar, spatial = by_mode.get(Mode.PLANAR), by_mode.get(Mode.SPATIAL)
        height_m = 0.0 if target is None else target.z_m
        modes = [item.mode for item in chosen]
        on_ground_m, raised_m = (
            self._policies.farthest_m(aboard, modes, h) for h in (0.0, height_m)
        )
        is_flat = on_ground_m - raised_m < SAME_REACH_M
        return Reach(
            static_m=reach.static_reach_m,
            planar_m=None if planar is None else planar.range_max_m,
            spatial_m=None if spatial is None else spatial.range_max_m,
            min_m=min((item.range_min_m for item in chosen), default=0.0),
            mode=mode if mode in by_mode else None,
            raised_m=None if is_flat else raised_m,
            height_m=0.0 if is_flat else height_m,
        )

    def _zone_refusal(self, machine_id: str, target: Target) -> str:
        """Why no load may lie at the target; empty if one may."""
        zones = ZoneCheck(self._zones.approved(machine_id).zones, self._ball_radius_m)
        refusal = zones.target_refusal(target)
        return "" if refusal is None else refusal.detail

    def _refusal(self, machine_id: str, target: Target, mode: Mode | None) -> str:
        """Why no throw (of this mode) can reach the target; empty if one can."""
        aboard = self._aboard.get(machine_id, {})
        texts: list[str] = []
        for candidate in Mode if mode is None else (mode,):
            try:
                policy = self._policies.on_machine(candidate, aboard.get(candidate.value))
                check_target(policy.card, target)
            except RefusedError as error:
                texts.append(error.detail)
            except ApiError as error:
                texts.append(error.message)
            else:
                return ""
        return texts[-1] if texts else ""

    def _tell(
        self,
        session_id: str,
        machine_id: str,
        target: TargetView | None,
        source: Source,
        refusal: str,
    ) -> None:
        event = TargetProposedEvent(
            machine_id=machine_id,
            session_id=session_id,
            target=target,
            source=source,
            refusal=refusal,
        )
        self._hub.publish(event, session_id)
