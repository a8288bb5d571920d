"""Plans: a target previewed in the twin, from the pose in which the machine stands.

The first numbers are answered at once, the ellipse follows by events. Nothing here commands a machine.
"""

import logging
import threading
from collections.abc import Callable
from concurrent.futures import CancelledError, Future
from datetime import timedelta

import numpy as np

from machine.conventions import JOINT_COUNT, Mode
from machine.errors import RefusedError
from machine.messages import (
    MATERIAL_VERSION,
    ZONES_VERSION,
    AimShift,
    MachineState,
    RejectReason,
    Target,
)
from machine.reach import check_target
from machine.site.thrown_material import ThrownMaterial, load_kg
from machine.spec import MachineSpec
from server.accounts.accounts import Session
from server.clock import new_id, utc_now
from server.errors import from_reason
from server.event_hub import EventHub
from server.machines.machine_registry import MachineRegistry
from server.machines.twin_files import TwinFiles
from server.plans.plan_store import PlanStore, Running
from server.plans.plan_views import (
    frames_of,
    pack_frames,
    plan_aim,
    plan_material,
    plan_site,
    plan_view,
    plan_zones,
    take_preview,
    throw_plan,
)
from server.plans.policy_store import PolicyStore, StoredPolicy
from server.plans.preview_pool import PreviewPool
from server.plans.preview_worker import CancelledPreviewError, PreviewJob
from server.plans.site_store import SiteStore, dump
from server.plans.zone_store import ZoneStore, dump_zones
from server.schemas.events import PlanUpdatedEvent
from server.schemas.plans import PlanRequest, PlanState, PlanView
from server.store.models import Plan
from server.viewer.replay import ThrowMotion
from server.viewer.scene import ViewerScene
from sim_twin.throws.preview import ThrowPreview

logger = logging.getLogger(__name__)

AimOf = Callable[[str, Mode, Target], AimShift | None]
"""Aim correction in force for a machine, a mode and a target."""
MaterialOf = Callable[[str, Target], ThrownMaterial | None]
"""Bulk material that a machine's open job wants at a target."""

FIRST_NUMBERS_WAIT_S = 1.0
"""A plan is answered after this time even if its first numbers are not there yet."""


class Planner:
    """Makes plans."""

    def __init__(
        self,
        store: PlanStore,
        registry: MachineRegistry,
        policies: PolicyStore,
        pool: PreviewPool,
        twins: TwinFiles,
        sites: SiteStore,
        zones: ZoneStore,
        hub: EventHub,
        scene: ViewerScene,
        spec: MachineSpec,
        ttl_s: float,
        aim_of: AimOf,
    ) -> None:
        self._store = store
        self._registry = registry
        self._policies = policies
        self._pool = pool
        self._twins = twins
        self._sites = sites
        self._zones = zones
        self._hub = hub
        self._scene = scene
        self._spec = spec
        self._ttl = timedelta(seconds=ttl_s)
        self._aim_of = aim_of
        self.material_of: MaterialOf = _no_material
        self._lock = threading.Lock()
        self._newest: dict[str, str] = {}

    # Making -----------------------------------------------------------------------------------------

    def create(self, machine_id: str, request: PlanRequest, session: Session) -> PlanView:
        """Preview a throw; returns with the first numbers, or after a second without.

        Raises:
            ApiError: no such machine, machine lost, no usable policy.
        """
        known = self._registry.get(machine_id)
        if not known.is_connected or known.state is None:
            raise from_reason(
                RejectReason.MACHINE_LOST,
                f"{machine_id} is not connected: its pose is not known, so nothing can be predicted.",
            )
        aboard = known.state.policy_sha256.get(request.mode.value)
        policy = self._policies.on_machine(request.mode, aboard)
        row = self._new_row(machine_id, request, session, known.state, policy)
        target = request.target.target()
        mass_kg = load_kg(plan_material(row))
        refusal = self._refusal(policy, known.state, target, mass_kg) or _aim_refusal(
            policy, row, target, mass_kg
        )
        if refusal is not None:
            row.state = PlanState.REFUSED.value
            row.refusals = [{"reason": refusal.reason.value, "detail": refusal.detail}]
            row.is_complete = True
            self._scene.clear_plan(session.session_id)
        running = self._store.add(row)
        if refusal is None:
            self._supersede(session.session_id, row.plan_id)
            self._submit(running, policy, known.state, request)
            running.first.wait(FIRST_NUMBERS_WAIT_S)
        return self._store.view(row.plan_id)

    def _new_row(
        self,
        machine_id: str,
        request: PlanRequest,
        session: Session,
        state: MachineState,
        policy: StoredPolicy,
    ) -> Plan:
        target = request.target.target()
        aim = self._aim_of(machine_id, request.mode, target)
        is_older = state.protocol_version < MATERIAL_VERSION
        material = None if is_older else self.material_of(machine_id, target)
        now = utc_now()
        return Plan(
            plan_id=new_id(),
            machine_id=machine_id,
            session_id=session.session_id,
            created_by=session.username,
            created_utc=now,
            expires_utc=now + self._ttl,
            state=PlanState.PREVIEWING.value,
            is_complete=False,
            mode=request.mode.value,
            target_x_m=target.x_m,
            target_y_m=target.y_m,
            target_z_m=target.z_m,
            pace_ratio=request.pace_ratio,
            policy_id=policy.card.policy_id,
            policy_sha256=policy.card.policy_sha256,
            model_sha256=self._spec.sha256,
            twin_profile_version=self._twins.profile_version(machine_id),
            site=dump(self._sites.around(machine_id, target)),
            zones=dump_zones(self._zones.approved(machine_id).zones),
            swept_path_rad_m=[],
            refusals=[],
            prediction=None,
            aim=None if aim is None else aim.model_dump(mode="json"),
            material=None if material is None else material.model_dump(mode="json"),
            calibration_sha256=state.calibration_sha256,
            start_rad_m=list(state.joint_position_rad_m),
            plan_json=None,
            plan_hash=None,
            armed_utc=None,
            fired_utc=None,
            frames=None,
        )

    def _refusal(
        self, policy: StoredPolicy, state: MachineState, target: Target, mass_kg: float
    ) -> RefusedError | None:
        try:
            check_target(policy.card, target, mass_kg)
        except RefusedError as error:
            return error
        if state.model_sha256 != self._spec.sha256:
            return RefusedError(
                RejectReason.MODEL_MISMATCH,
                f"Refused: the machine's model is {state.model_sha256[:12]}, this server's is "
                f"{self._spec.sha256[:12]}. Install the same version on both.",
            )
        aboard = state.policy_sha256.get(policy.card.mode.value)
        if aboard is None:
            return RefusedError(
                RejectReason.POLICY_UNUSABLE,
                f"Refused: {state.machine_id} has no usable policy for {policy.card.mode.value} on "
                "board; its news and its log say why.",
            )
        if aboard != policy.card.policy_sha256:
            return RefusedError(
                RejectReason.POLICY_MISMATCH,
                f"Refused: {state.machine_id} has policy {aboard[:12]} for {policy.card.mode.value} on "
                f"board, which this server does not have; its own is {policy.card.policy_id} "
                f"({policy.card.policy_sha256[:12]}). Upload the first or deploy the second: page Policies.",
            )
        return self._zone_refusal(state)

    def _zone_refusal(self, state: MachineState) -> RefusedError | None:
        """Refusal while the machine has other exclusion zones than those that are approved."""
        approved = self._zones.approved(state.machine_id)
        is_older = state.protocol_version < ZONES_VERSION
        aboard = "" if is_older else state.zones_sha256
        if aboard == approved.sha256:
            return None
        remedy = (
            "Its software does not know zones: update it."
            if is_older
            else "They are being sent to it. Preview again."
        )
        return RefusedError(
            RejectReason.ZONES_MISMATCH,
            f"Refused: {state.machine_id} does not have the approved exclusion zones (version "
            f"{approved.version_count}). {remedy}",
        )

    def _supersede(self, session_id: str, plan_id: str) -> None:
        """A session looks at one preview at a time: the one before it stops."""
        with self._lock:
            before = self._newest.get(session_id)
            self._newest[session_id] = plan_id
        if before is not None:
            self._pool.cancel(before)

    def _submit(
        self,
        running: Running,
        policy: StoredPolicy,
        state: MachineState,
        request: PlanRequest,
    ) -> None:
        row, target = running.row, request.target.target()
        aim = plan_aim(row)
        job = PreviewJob(
            job_id=row.plan_id,
            slot=0,
            policy_dir=policy.folder,
            target=target,
            aim=None if aim is None else aim.aimed(target),
            pace_ratio=request.pace_ratio,
            joint_position_rad_m=state.joint_position_rad_m,
            site=plan_site(row),
            zones=plan_zones(row),
            rollout_count=request.rollout_count,
            calibration_path=self._twins.calibration_path(row.machine_id),
            profile_path=self._twins.profile_path(row.machine_id),
            seed=int(row.plan_id.replace("-", ""), 16) % (1 << 31),
        )
        future = self._pool.submit(job, lambda so_far: self._take(running, so_far, is_done=False))
        future.add_done_callback(lambda done: self._finish(running, done))

    # What the preview says ----------------------------------------------------------------------------

    def _take(self, running: Running, so_far: ThrowPreview, *, is_done: bool) -> None:
        with running.lock:
            if running.is_done:
                return  # an update that was overtaken by the end
            is_first = not running.first.is_set()
            running.is_done = is_done
            take_preview(running.row, so_far, is_complete=is_done)
            message = throw_plan(running.row)
            if message is not None:
                running.seen[message.plan_hash] = message
            if is_first:
                running.row.frames = pack_frames(frames_of(running.row.plan_id, so_far))
            if is_first or is_done:
                self._store.save(running.row)
            view = plan_view(running.row)
        running.first.set()
        self._draw(running.row, so_far, is_first=is_first)
        self._hub.publish(PlanUpdatedEvent(plan=view), running.row.session_id)

    def _finish(self, running: Running, done: "Future[ThrowPreview]") -> None:
        try:
            self._take(running, done.result(), is_done=True)
            return
        except (CancelledPreviewError, CancelledError):
            text = "a newer preview took its place"
        except Exception as error:
            logger.exception("preview %s failed", running.row.plan_id)
            text = f"the preview failed: {error}"
        with running.lock:
            running.is_done = True
            if running.row.prediction is None:
                running.row.state = PlanState.FAILED.value
                running.row.refusals = [
                    {"reason": RejectReason.PREVIEW_FAILED.value, "detail": f"Refused: {text}."}
                ]
            self._store.save(running.row)
            view = plan_view(running.row)
        running.first.set()
        self._hub.publish(PlanUpdatedEvent(plan=view), running.row.session_id)

    def _draw(self, row: Plan, preview: ThrowPreview, *, is_first: bool) -> None:
        if not is_first:
            if preview.ellipse is not None:
                self._scene.update_ellipse(row.session_id, preview.ellipse)
            return
        if preview.frames_rad_m.shape[0] < 2:
            self._scene.clear_plan(row.session_id)
            return
        is_released = np.isfinite(preview.release_s)
        self._scene.show_plan(
            row.session_id,
            (row.target_x_m, row.target_y_m, row.target_z_m),
            ThrowMotion(
                frames_rad_m=preview.frames_rad_m.reshape(-1, JOINT_COUNT),
                frame_period_s=preview.frame_period_s,
                ball_path_m=preview.ball_path_m.reshape(-1, 3),
                release_s=preview.release_s if is_released else None,
                flight_s=preview.flight_s if np.isfinite(preview.flight_s) else 0.0,
            ),
            impact_m=preview.impact_m,
            ellipse=preview.ellipse,
        )


def _no_material(_machine_id: str, _target: Target) -> None:
    return None


def _aim_refusal(
    policy: StoredPolicy, row: Plan, target: Target, mass_kg: float
) -> RefusedError | None:
    """Refusal of a target whose corrected aim is out of the policy's reach."""
    aim = plan_aim(row)
    if aim is None:
        return None
    try:
        check_target(policy.card, aim.aimed(target), mass_kg)
    except RefusedError as error:
        detail = f"With aim correction v{aim.version_count}: {error.detail}"
        return RefusedError(error.reason, detail)
    return None
