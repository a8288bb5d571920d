"""Why a predicted throw is refused: each reason with its numbers and what to do about it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from machine.messages import RejectReason
from sim_twin.throws.campaign import Outcome, ThrowResult
from sim_twin.throws.clearances import Clearance

MISS_LIMIT_M = 0.5
"""A nominal throw that lands farther from its target than this is refused."""
BAD_THROW_LIMIT_RATIO = 0.05
"""Share of the ellipse's throws that may end badly."""
OTHER_START = "Start from another arm pose or choose another target."


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why a throw is refused; `detail` has the numbers and the remedy, for people."""

    reason: RejectReason
    detail: str


def _refusal(text: str) -> Refusal:
    return Refusal(RejectReason.PREVIEW_REFUSED, f"Refused: {text}")


def nominal_refusals(result: ThrowResult, clearances: Sequence[Clearance]) -> tuple[Refusal, ...]:
    """What speaks against the nominal throw."""
    refused = [
        _refusal(
            f"{c.name} {c.value_rad_m:.2f} {c.unit} predicted {c.at_s:.1f} s after the start, at least "
            f"{c.limit_rad_m:.2f} {c.unit} needed. {OTHER_START}"
        )
        for c in clearances
        if c.value_rad_m < c.limit_rad_m
    ]
    match result.outcome:
        case Outcome.LANDED:
            miss_m = math.hypot(result.downrange_error_m, result.crossrange_error_m)
            if miss_m > MISS_LIMIT_M:
                refused.append(
                    _refusal(
                        f"predicted miss {miss_m:.2f} m ({result.downrange_error_m:+.2f} m downrange, "
                        f"{result.crossrange_error_m:+.2f} m crossrange), at most {MISS_LIMIT_M:.2f} m "
                        "allowed. Start from another arm pose, or use another policy version."
                    )
                )
        case Outcome.NO_RELEASE:
            refused.append(
                _refusal(
                    f"the policy does not release within {result.simulated_s:.1f} s from this pose. "
                    "Move the arm to the safe pose and preview again."
                )
            )
        case Outcome.TIMEOUT:
            refused.append(_refusal("the load never comes down. Check the target's height."))
        case Outcome.COLLISION if not refused:
            refused.append(
                _refusal(
                    "the gripper touches ground or machine "
                    f"{result.simulated_s:.1f} s after the start of the throw. {OTHER_START}"
                )
            )
        case Outcome.LIMIT if not refused:
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
) -> tuple[Refusal, ...]:
    """What speaks against the throw once it is repeated with everything that scatters.

    Args:
        results: the scattered throws.
        astray: how those ended that landed, but on something else; one entry a throw.
    """
    bad = [r.outcome.value.replace("_", " ") for r in results if r.outcome is not Outcome.LANDED]
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
