"""Between a preview of the twin, a plan's row, and what console and machine get to see of it."""

import json
import math
import zlib
from typing import Any

import numpy as np

from machine.conventions import Mode
from machine.messages import MAX_PATH_COUNT, AimShift, Target, ThrowPlan
from machine.site.objects import GROUND, SiteObject
from machine.site.thrown_material import ThrownMaterial
from machine.site.zones import Zone, zones_sha256
from server.clock import utc_now
from server.plans.landing_errors import errors_of
from server.plans.preview_worker import unit_of
from server.schemas.console import TargetView
from server.schemas.plans import (
    ClearanceView,
    PlanFrames,
    PlanState,
    PlanView,
    PredictionView,
    RefusalView,
)
from server.store.models import Plan
from sim_twin.throws.clearances import Clearance
from sim_twin.throws.preview import ThrowPreview


def plan_target(row: Plan) -> Target:
    """The target of a plan."""
    return Target(x_m=row.target_x_m, y_m=row.target_y_m, z_m=row.target_z_m)


def plan_site(row: Plan) -> tuple[SiteObject, ...]:
    """What stood around the machine when a plan was made."""
    return tuple(SiteObject.model_validate(item) for item in row.site)


def plan_zones(row: Plan) -> tuple[Zone, ...]:
    """Exclusion zones that a plan was checked against."""
    return tuple(Zone.model_validate(item) for item in row.zones)


def plan_aim(row: Plan) -> AimShift | None:
    """The aim correction of a plan."""
    return None if row.aim is None else AimShift.model_validate(row.aim)


def plan_material(row: Plan) -> ThrownMaterial | None:
    """The bulk material of a plan."""
    return None if row.material is None else ThrownMaterial.model_validate(row.material)


def prediction_of(target: Target, preview: ThrowPreview) -> PredictionView | None:
    """The numbers of a preview whose load lands; None for one that never comes down."""
    if preview.impact_m is None:
        return None
    downrange_m, crossrange_m = errors_of(target, preview.impact_m[0], preview.impact_m[1])
    return PredictionView(
        impact_m=preview.impact_m,
        downrange_error_m=downrange_m,
        crossrange_error_m=crossrange_m,
        ellipse=preview.ellipse,
        release_s=preview.release_s,
        flight_s=preview.flight_s,
        duration_s=preview.duration_s,
        release_speed_m_per_s=preview.release_speed_m_per_s,
        lands_on=preview.lands_on or GROUND,
        clearances=tuple(_clearance(item) for item in preview.clearances),
        ball_path_m=_points(preview),
        compute_s=preview.wall_s,
    )


def _clearance(item: Clearance) -> ClearanceView:
    is_angle = unit_of(item.name) == "rad"
    return ClearanceView(
        name=item.name,
        value_m=None if is_angle else item.value_rad_m,
        limit_m=None if is_angle else item.limit_rad_m,
        value_rad=item.value_rad_m if is_angle else None,
        limit_rad=item.limit_rad_m if is_angle else None,
        at_s=item.at_s,
    )


def _points(preview: ThrowPreview) -> tuple[tuple[float, float, float], ...]:
    return tuple((float(x), float(y), float(z)) for x, y, z in preview.ball_path_m)


def frames_of(plan_id: str, preview: ThrowPreview) -> PlanFrames:
    """The motion of a preview."""
    return PlanFrames(
        plan_id=plan_id,
        frame_period_s=preview.frame_period_s,
        frames_rad_m=tuple(
            tuple(round(float(v), 5) for v in frame) for frame in preview.frames_rad_m
        ),
        release_s=_finite(preview.release_s),
        flight_s=_finite(preview.flight_s),
        ball_path_m=_points(preview),
    )


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def pack_frames(frames: PlanFrames) -> bytes:
    """Frames as they are stored."""
    return zlib.compress(frames.model_dump_json().encode())


def unpack_frames(content: bytes) -> PlanFrames:
    """Stored frames."""
    return PlanFrames.model_validate_json(zlib.decompress(content))


def take_preview(row: Plan, preview: ThrowPreview, *, is_complete: bool) -> None:
    """Write what a preview says into a plan's row."""
    prediction = prediction_of(plan_target(row), preview)
    row.prediction = None if prediction is None else prediction.model_dump(mode="json")
    row.refusals = [
        {"reason": item.reason.value, "detail": item.detail, "surface_m": item.surface_m}
        for item in preview.refused
    ]
    row.is_complete = is_complete
    row.swept_path_rad_m = swept_path(preview) if row.zones else []
    if preview.refused:
        row.state = PlanState.REFUSED.value
    elif is_complete:
        row.state = PlanState.READY.value


def swept_path(preview: ThrowPreview) -> list[Any]:
    """At most `MAX_PATH_COUNT` poses of a preview's motion, at equal times, to the milliradian."""
    frames = preview.frames_rad_m
    if len(frames) == 0:
        return []
    at = np.linspace(0.0, len(frames) - 1.0, MAX_PATH_COUNT)
    first = np.minimum(at.astype(np.int64), max(len(frames) - 2, 0))
    share = (at - first)[:, None]
    following = np.minimum(first + 1, len(frames) - 1)
    poses = (1.0 - share) * frames[first] + share * frames[following]
    return poses.round(3).tolist()


def throw_plan(row: Plan) -> ThrowPlan | None:
    """What would be sent to the machine now; None while there is nothing that may be thrown."""
    if row.plan_json is not None:
        return ThrowPlan.model_validate_json(row.plan_json)
    if row.prediction is None or row.policy_sha256 is None or row.refusals:
        return None
    prediction = PredictionView.model_validate(row.prediction)
    return ThrowPlan(
        plan_id=row.plan_id,
        machine_id=row.machine_id,
        mode=Mode(row.mode),
        target=plan_target(row),
        pace_ratio=row.pace_ratio,
        policy_sha256=row.policy_sha256,
        model_sha256=row.model_sha256,
        twin_profile_version=row.twin_profile_version,
        predicted_impact_m=prediction.impact_m,
        predicted_ellipse=prediction.ellipse,
        site=plan_site(row),
        zones_sha256=zones_sha256(plan_zones(row)) or None,
        swept_path_rad_m=tuple(tuple(pose) for pose in row.swept_path_rad_m or ()) or None,
        aim=plan_aim(row),
        material=plan_material(row),
    )


def plan_view(row: Plan) -> PlanView:
    """A plan for the console."""
    message = throw_plan(row)
    refusals: list[dict[str, Any]] = row.refusals
    return PlanView(
        plan_id=row.plan_id,
        machine_id=row.machine_id,
        state=PlanState(row.state),
        mode=Mode(row.mode),
        target=TargetView.of(plan_target(row)),
        pace_ratio=row.pace_ratio,
        policy_id=row.policy_id,
        policy_sha256=row.policy_sha256,
        model_sha256=row.model_sha256,
        twin_profile_version=row.twin_profile_version,
        aim=plan_aim(row),
        material=plan_material(row),
        plan_hash=None if message is None else message.plan_hash,
        is_complete=row.is_complete,
        refusals=tuple(
            RefusalView(
                reason=item["reason"], detail=item["detail"], surface_m=item.get("surface_m")
            )
            for item in refusals
        ),
        prediction=None
        if row.prediction is None
        else PredictionView.model_validate(row.prediction),
        created_by=row.created_by,
        created_utc=row.created_utc,
        expires_utc=row.expires_utc,
    )


def is_expired(row: Plan) -> bool:
    """Whether a plan is too old to be armed."""
    return row.expires_utc <= utc_now()


def canonical(plan: ThrowPlan) -> str:
    """The text whose hash is the plan's hash; stored when a plan is armed."""
    return json.dumps(plan.model_dump(mode="json"), sort_keys=True, separators=(",", ":"))
