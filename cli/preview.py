"""`downrange preview`: predict one throw in the twin, with its landing ellipse or the reasons against it."""

import json as json_text
import math
import sys
from pathlib import Path
from typing import Literal

from evaluation.campaigns import open_policy
from machine.calibration import load_calibration, nominal_calibration
from machine.conventions import DEFAULT_PACE_RATIO, Mode
from machine.errors import UsageError
from machine.messages import Target
from machine.reach import check_pace
from machine.site.files import load_site
from machine.spec import load_spec
from machine.starts import safe_pose
from runtime.control.control_loop import ControlParams
from sim_twin.throws.preview import PreviewRequest, ThrowPreview, preview
from sim_twin.twin.profile import load_profile, nominal_profile


def run(
    *,
    mode: Literal["2d", "3d"],
    target: str,
    rollouts: int = 200,
    json: bool = False,
    height: float = 0.0,
    slew: float = 0.0,
    seed: int = 0,
    pace: float = DEFAULT_PACE_RATIO,
    policies: Path = Path("policies"),
    policy: Path | None = None,
    calibration: Path | None = None,
    profile: Path | None = None,
    site: Path | None = None,
) -> int:
    """Predict one throw from the safe pose: where it lands, how far landings scatter, why not to throw.

    Example: downrange preview --mode 3d --target 9,-1.5 --rollouts 200 --json

    Exit code 0 if the throw may go ahead, 2 if it is refused, 1 on an error.

    Args:
        mode: 2d throws within the arm's plane, 3d turns the cabin as well.
        target: R or R,C in metres: R forward of the slew axis at zero slew, C to the left.
        rollouts: throws behind the landing ellipse; 0 for the nominal throw alone.
        json: print the result as JSON.
        height: of the target surface above ground, metres.
        slew: where the cabin stands now, radians.
        seed: of the scatter behind the ellipse.
        pace: 0 careful .. 1 fast, for policies that were trained with a pace.
        policies: folder of policy versions; its active.json names the one of each mode.
        policy: folder of one policy version (policy.onnx and card.json), instead of the active one.
        calibration: valve calibration of the machine; nominal if left out.
        profile: twin profile of the machine; nominal if left out.
        site: what stands around the machine (docs/site.md), as JSON; nothing if left out.
    """
    point = parse_target(target, height)
    if rollouts < 0 or seed < 0 or not math.isfinite(slew):
        raise UsageError(
            f"--rollouts {rollouts} --seed {seed} --slew {slew}: rollouts and seed are 0 or more, "
            "the slew angle is finite"
        )
    check_pace(pace)
    spec = load_spec()
    runner = open_policy(Mode(mode), policies, policy, spec)
    valves = nominal_calibration(spec) if calibration is None else load_calibration(calibration)
    pose = safe_pose(slew)
    shown = preview(
        PreviewRequest(
            params=ControlParams(
                spec=spec, calibration=valves.for_twin(), mode=Mode(mode), policy=runner
            ),
            profile=nominal_profile(spec) if profile is None else load_profile(profile),
            target=point,
            joint_position_rad_m=(pose[0], pose[1], pose[2], pose[3], pose[4], pose[5]),
            rollout_count=rollouts,
            seed=seed,
            pace_ratio=pace,
            site=() if site is None else load_site(site),
        ),
        _show_progress if sys.stderr.isatty() else None,
    )
    print(_json(shown) if json else _words(shown))
    return 2 if shown.refused else 0


def parse_target(text: str, height_m: float = 0.0) -> Target:
    """Target from ``R`` or ``R,C`` in metres.

    Raises:
        UsageError: anything else, with what was wrong.
    """
    form = "use R or R,C in metres, such as 9 or 9,-1.5"
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        raise UsageError(f"--target '{text}' holds something that is no number; {form}") from None
    if len(numbers) > 2:
        raise UsageError(f"--target '{text}' has {len(numbers)} numbers; {form}")
    if not all(math.isfinite(number) for number in (*numbers, height_m)):
        raise UsageError(f"--target '{text}' --height {height_m}: not finite; {form}")
    try:
        return Target(x_m=numbers[0], y_m=numbers[1] if len(numbers) == 2 else 0.0, z_m=height_m)
    except ValueError as error:
        raise UsageError(
            f"--target '{text}' --height {height_m:g}: targets lie within 60 m, heights -5..10 m"
        ) from error


def _show_progress(shown: ThrowPreview) -> None:
    done = 0 if shown.ellipse is None else shown.ellipse.rollout_count
    print(f"\rpreview: nominal throw, {done} scattered throws", end="", file=sys.stderr, flush=True)


def _json(shown: ThrowPreview) -> str:
    impact = shown.impact_m
    return json_text.dumps(
        {
            "impact": None
            if impact is None
            else {"x_m": impact[0], "y_m": impact[1], "z_m": impact[2]},
            "ellipse": None if shown.ellipse is None else shown.ellipse.model_dump(mode="json"),
            "seconds": shown.wall_s,
            "lands_on": shown.lands_on,
            "refused": [refusal.detail for refusal in shown.refused],
        },
        indent=2,
        allow_nan=False,
    )


def _words(shown: ThrowPreview) -> str:
    lines = [refusal.detail for refusal in shown.refused]
    if shown.impact_m is not None:
        x, y, z = shown.impact_m
        lines.append(
            f"impact on {shown.lands_on} at x {x:.2f} m, y {y:.2f} m, z {z:.2f} m; release "
            f"{shown.release_s:.2f} s after the start at {shown.release_speed_m_per_s:.2f} m/s, "
            f"{shown.flight_s:.2f} s in the air"
        )
    if shown.ellipse is not None:
        e = shown.ellipse
        lines.append(
            f"{e.landed_count} of {e.rollout_count} throws land; mean {e.mean_downrange_error_m:+.3f} m "
            f"downrange, {e.mean_crossrange_error_m:+.3f} m crossrange; sd {e.sd_downrange_m:.3f} and "
            f"{e.sd_crossrange_m:.3f} m"
        )
    lines.extend(
        f"{c.name}: {c.value_rad_m:.2f} {c.unit} at {c.at_s:.1f} s" for c in shown.clearances
    )
    lines.append(f"computed in {shown.wall_s:.2f} s")
    return "\n".join(lines)
