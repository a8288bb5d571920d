"""Refusals of a predicted throw: each with reason, numbers and remedy."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from machine.messages import RejectReason
from sim_twin.throws.campaign import ThrowOutcome, ThrowResult
from sim_twin.throws.clearances import Clearance

MISS_LIMIT_M = 0.5
"""Largest miss of the nominal throw."""
BAD_THROW_LIMIT_RATIO = 0.05
"""Largest share of failed throws among the scattered ones."""
OTHER_START = "Start from another arm pose or choose another target."


@dataclass(frozen=True, slots=True)
class PreviewRefusal:
    """Reason for refusing a throw; `detail` is text with the numbers and the remedy."""

    reason: RejectReason
    detail: str
    surface_m: float | None = None
    """Height at which the target would lie on a surface, where that is what is wrong."""


def _refusal(text: str) -> PreviewRefusal:
    return PreviewRefusal(RejectReason.PREVIEW_REFUSED, f"Refused: {text}")


def nominal_refusals(
    result: ThrowResult, clearances: Sequence[Clearance]
) -> tuple[PreviewRefusal, ...]:
    """Refusals of the nominal throw."""
    refused = [
        _refusal(
            f"{c.name} {c.value_rad_m:.2f} {c.unit} predicted {c.at_s:.1f} s after the start, at least "
            f"{c.limit_rad_m:.2f} {c.unit} needed. {OTHER_START}"
        )
        for c in clearances
        if c.value_rad_m < c.limit_rad_m
    ]
    match result.outcome:
        case ThrowOutcome.LANDED:
            miss_m = math.hypot(result.downrange_error_m, result.crossrange_error_m)
            if miss_m > MISS_LIMIT_M:
                refused.append(
                    _refusal(
                        f"predicted miss {miss_m:.2f} m ({result.downrange_error_m:+.2f} m downrange, "
                        f"{result.crossrange_error_m:+.2f} m crossrange), at most {MISS_LIMIT_M:.2f} m "
                        "allowed. Start from another arm pose, or use another policy version."
                    )
                )
        case ThrowOutcome.NO_RELEASE:
            refused.append(
                _refusal(
                    f"the policy does not release within {result.simulated_s:.1f} s from this pose. "
                    "Move the arm to the safe pose and preview again."
                )
            )
        case ThrowOutcome.TIMEOUT:
            refused.append(_refusal("the load never comes down. Check the target's height."))
        case ThrowOutcome.COLLISION if not refused:
            refused.append(
                _refusal(
                    "the gripper touches ground or machine "
                    f"{result.simulated_s:.1f} s after the start of the throw. {OTHER_START}"
                )
            )
        case ThrowOutcome.LIMIT if not refused:
            refused.append(
                _refusal(
                    f"a joint or the swing meets its limit {result.simulated_s:.1f} s after the start "
                    f"of the throw. {OTHER_START}"
                )
            )
        case _:
            pass
    return tuple(refused)


def spread_refusals(
    results: Sequence[ThrowResult], astray: Sequence[str] = ()
) -> tuple[PreviewRefusal, ...]:
    """Refusals because of scattered throws that fail.

    Args:
        results: scattered throws.
        astray: descriptions of throws that landed on another surface, one per throw.
    """
    bad = [
        r.outcome.value.replace("_", " ") for r in results if r.outcome is not ThrowOutcome.LANDED
    ]
    bad += astray
    if len(bad) <= BAD_THROW_LIMIT_RATIO * len(results):
        return ()
    kinds = ", ".join(f"{bad.count(kind)} {kind}" for kind in sorted(set(bad)))
    return (
        _refusal(
            f"{len(bad)} of {len(results)} predicted throws end badly ({kinds}), at most "
            f"{BAD_THROW_LIMIT_RATIO:.0%} allowed. {OTHER_START}"
        ),
    )
