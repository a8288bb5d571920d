"""Throws of policies with a material: releases by range from previews in the nominal twin."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from bulk.footprint import GripRelease
from bulk.material import Material
from bulk.throw_model import LandingScatter, PolicyFolder, ThrowModel, load_miss_m, make_model
from machine.calibration import nominal_calibration
from machine.conventions import DEFAULT_PACE_RATIO, Mode
from machine.errors import UsageError
from machine.kinematics import grip_centre
from machine.messages import Target
from machine.policy_card import load_card
from machine.reach import MIN_RANGE_M, reach_m
from machine.spec import MachineSpec
from machine.starts import safe_pose
from runtime.control.control_loop import ControlParams
from runtime.control.policy import PolicyRunner, find_policy, is_paced
from sim_twin.throws.preview import FRAME_PERIOD_S, PreviewRequest, ThrowPreview, nominal_throw
from sim_twin.twin.profile import nominal_profile

RANGE_COUNT = 3
"""Ranges at which a policy's throws are previewed; between them covariances are interpolated."""
PACES = (0.0, 1.0)
"""Paces that the planner chooses from."""


def open_policies(policies: Path, policy: Path | None, mode: Mode | None) -> list[PolicyFolder]:
    """Policies that a job may be thrown with: the active ones of a mode, or of every mode.

    Args:
        policies: folder of policy versions.
        policy: the only version, instead of the active ones.
        mode: of the job; None: any.

    Raises:
        PolicyError: one cannot be used.
        UsageError: the version throws in the other mode.
    """
    if policy is None:
        folders = [find_policy(policies, one) for one in Mode if mode in (None, one)]
        return [PolicyFolder(folder, load_card(folder)) for folder in folders]
    card = load_card(policy)
    if mode not in (None, card.mode):
        raise UsageError(f"policy {card.policy_id} throws {card.mode.value}, the job {mode}")
    return [PolicyFolder(policy, card)]


def previewed_models(
    among: Sequence[PolicyFolder], spec: MachineSpec, material: Material, height_m: float,
    grab_m3: float, pace_ratio: float | None = None,
) -> tuple[ThrowModel, ...]:  # fmt: skip
    """Models of policies from previews in the nominal twin, thrown to a height (about 1 s each).

    Args:
        among: policies.
        spec: machine type.
        material: of the loads.
        height_m: of the target.
        grab_m3: volume of a full grab.
        pace_ratio: the only pace; None: each of several.

    Returns:
        One for each policy and pace whose throws land.

    Raises:
        UsageError: no previewed throw lands there.
    """
    models: list[ThrowModel] = []
    for policy in among:
        paces = PACES if is_paced(policy.card) else (DEFAULT_PACE_RATIO,)
        for pace in paces if pace_ratio is None else (pace_ratio,):
            model = _previewed(policy, spec, material, height_m, grab_m3, pace)
            models += [] if model is None else [model]
    if not models:
        names = " and ".join(policy.card.policy_id for policy in among)
        raise UsageError(f"no previewed throw of {names} lands at height {height_m:.2f} m")
    return tuple(models)


def _previewed(
    policy: PolicyFolder, spec: MachineSpec, material: Material, height_m: float, grab_m3: float,
    pace_ratio: float,
) -> ThrowModel | None:  # fmt: skip
    folder, card = policy
    params = ControlParams(
        spec=spec,
        calibration=nominal_calibration(spec).for_twin(),
        mode=card.mode,
        policy=PolicyRunner(folder, spec),
    )
    pose = safe_pose(0.0)
    nearest = max(card.target_range_min_m, MIN_RANGE_M[card.mode])
    miss_m = load_miss_m(card.mode, pace_ratio, material.mass_kg(grab_m3))
    scatter: list[LandingScatter] = []
    releases: list[GripRelease] = []
    release_s: list[float] = []
    for range_m in np.linspace(nearest, reach_m(card, height_m), RANGE_COUNT + 2)[1:-1].tolist():
        shown = nominal_throw(
            PreviewRequest(
                params=params,
                profile=nominal_profile(spec),
                target=Target(x_m=range_m, y_m=0.0, z_m=height_m),
                joint_position_rad_m=(pose[0], pose[1], pose[2], pose[3], pose[4], pose[5]),
                rollout_count=0,
                pace_ratio=pace_ratio,
            )
        )
        if shown.impact_m is not None:
            scatter.append(LandingScatter(range_m, *miss_m))
            releases.append(release_of(shown, spec))
            release_s.append(shown.release_s)
    if not scatter:
        return None
    timing = pace_ratio, float(np.mean(release_s))
    return make_model(card, spec, material, scatter, releases, height_m, grab_m3, timing)


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
