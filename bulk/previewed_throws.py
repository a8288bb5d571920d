"""Throws of a policy as its previews in the nominal twin show them: scatter and releases by range."""

import math
from pathlib import Path

import numpy as np

from bulk.footprint import GripRelease
from bulk.material import Material
from bulk.throw_model import LandingScatter, ThrowModel, make_model
from machine.calibration import nominal_calibration
from machine.conventions import Mode
from machine.errors import UsageError
from machine.kinematics import grip_centre
from machine.messages import Target
from machine.policy_card import PolicyCard, load_card
from machine.reach import MIN_RANGE_M, reach_m
from machine.spec import MachineSpec
from machine.starts import safe_pose
from runtime.control.control_loop import ControlParams
from runtime.control.policy import PolicyRunner, find_policy
from sim_twin.throws.preview import FRAME_PERIOD_S, PreviewRequest, ThrowPreview, preview
from sim_twin.twin.profile import nominal_profile

RANGE_COUNT = 3
"""Ranges at which a policy's throws are previewed; between them covariances are interpolated."""
PREVIEW_THROW_COUNT = 60


def open_card(policies: Path, policy: Path | None, mode: Mode) -> tuple[Path, PolicyCard]:
    """Folder and card of the policy that a job is thrown with.

    Raises:
        PolicyError: it cannot be used.
        UsageError: it throws in the other mode.
    """
    folder = find_policy(policies, mode) if policy is None else policy
    card = load_card(folder)
    if card.mode is not mode:
        raise UsageError(f"policy {card.policy_id} throws {card.mode.value}, the job {mode.value}")
    return folder, card


def previewed_model(
    folder: Path, card: PolicyCard, spec: MachineSpec, material: Material, height_m: float,
    grab_m3: float,
) -> ThrowModel:  # fmt: skip
    """Model from previews of the policy in the nominal twin, thrown to a height (takes seconds).

    Raises:
        UsageError: no previewed throw lands there.
    """
    params = ControlParams(
        spec=spec,
        calibration=nominal_calibration(spec).for_twin(),
        mode=card.mode,
        policy=PolicyRunner(folder, spec),
    )
    pose = safe_pose(0.0)
    nearest = max(card.target_range_min_m, MIN_RANGE_M[card.mode])
    scatter: list[LandingScatter] = []
    releases: list[GripRelease] = []
    for range_m in np.linspace(nearest, reach_m(card, height_m), RANGE_COUNT + 2)[1:-1].tolist():
        shown = preview(
            PreviewRequest(
                params=params,
                profile=nominal_profile(spec),
                target=Target(x_m=range_m, y_m=0.0, z_m=height_m),
                joint_position_rad_m=(pose[0], pose[1], pose[2], pose[3], pose[4], pose[5]),
                rollout_count=PREVIEW_THROW_COUNT,
            )
        )
        if shown.impact_m is not None and shown.ellipse is not None:
            ellipse = shown.ellipse
            scatter.append(LandingScatter(range_m, ellipse.sd_downrange_m, ellipse.sd_crossrange_m))
            releases.append(release_of(shown, spec))
    if not scatter:
        raise UsageError(f"no previewed throw of {card.policy_id} lands at height {height_m:.2f} m")
    return make_model(card, spec, material, scatter, releases, height_m, grab_m3)


def release_of(shown: ThrowPreview, spec: MachineSpec) -> GripRelease:
    """GripRelease of a previewed throw: flight's first step, and the turning of the grip's velocity."""
    frames = shown.frames_rad_m
    at = min(max(round(shown.release_s / FRAME_PERIOD_S), 2), len(frames) - 3)
    near = frames[at - 2 : at + 3]
    place = grip_centre(spec, near, np.zeros_like(near)).position_m
    velocity = np.diff(place, axis=0) / FRAME_PERIOD_S
    level, up = np.hypot(velocity[:, 0], velocity[:, 1]), velocity[:, 2]
    turn = np.arctan2(up, level)
    start = shown.ball_path_m[0]
    return GripRelease(
        range_m=math.hypot(start[0], start[1]),
        height_m=float(start[2]),
        speed_range_m_per_s=float(level.mean()),
        speed_up_m_per_s=float(up.mean()),
        swing_rad_per_s=float((turn[-1] - turn[0]) / (3.0 * FRAME_PERIOD_S)),
    )
