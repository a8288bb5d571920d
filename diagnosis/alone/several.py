"""One result out of several joints, balls or bodies that were diagnosed one by one."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from diagnosis.verdict import (
    Cause,
    Diagnosis,
    FittedEffect,
    Gap,
    Shrink,
    VerdictKind,
)

_ORDER = (
    VerdictKind.UNKNOWN,
    VerdictKind.AMBIGUOUS,
    VerdictKind.EXPLAINED,
    VerdictKind.NONE,
    VerdictKind.BAD_DATA,
)
"""The verdict of the whole is the first of these that a part has."""


def refused(reason: str, evidence: Mapping[str, object] | None = None) -> Diagnosis:
    """The verdict on data that cannot be used."""
    return Diagnosis(
        verdict=VerdictKind.BAD_DATA,
        sentence=reason,
        causes=(),
        evidence={**(evidence or {}), "refused": [{"reason": reason}]},
    )


def combined(parts: Mapping[str, Diagnosis]) -> Diagnosis:
    """Put the parts' results side by side; each part is whole in ``evidence["parts"]``.

    Effects carry the part's name as their joint. The probability of the joint explanation is the geometric
    mean of the parts' own, so that it does not shrink with their number.
    """
    if len(parts) == 1:
        return next(iter(parts.values()))
    usable = {
        name: part for name, part in parts.items() if part.verdict is not VerdictKind.BAD_DATA
    }
    verdict = next(kind for kind in _ORDER if any(p.verdict is kind for p in parts.values()))
    tops = {name: _top(part) for name, part in usable.items()}
    effects = [effect for name, cause in tops.items() for effect in _named(cause.effects, name)]
    causes: list[Cause] = []
    if usable:
        causes.append(
            Cause(
                effects=tuple(effects),
                probability=_mean([cause.probability for cause in tops.values()]),
                name="; ".join(f"{name}: {cause.name}" for name, cause in tops.items()),
            )
        )
        for name in ("none", "unknown"):
            each = [
                next(c.probability for c in p.causes if c.name == name) for p in usable.values()
            ]
            causes.append(Cause(effects=(), probability=_mean(each), name=name))
    shrinks = [part.shrink for part in usable.values() if part.shrink is not None]
    ratios = [p.gap.trajectory_rms_ratio or 0.0 for p in usable.values()]
    return Diagnosis(
        verdict=verdict,
        sentence=" ".join(f"{name}: {part.sentence}" for name, part in parts.items()),
        gap=Gap(trajectory_rms_ratio=float(np.max(ratios)) if ratios else None),
        stages=tuple(stage for part in usable.values() for stage in part.stages),
        causes=tuple(causes),
        ambiguity=next((p.ambiguity for p in usable.values() if p.ambiguity is not None), None),
        shrink=_shrink(shrinks),
        evidence={
            "parts": {
                name: part.model_dump(mode="json", exclude={"plots"})
                for name, part in parts.items()
            }
        },
        plots={
            f"{name} {key}": plot
            for name, part in usable.items()
            for key, plot in part.plots.items()
        },
    )


def _top(part: Diagnosis) -> Cause:
    """The cause that the part's verdict stands for."""
    if part.verdict is VerdictKind.UNKNOWN:
        return next(cause for cause in part.causes if cause.name == "unknown")
    return part.causes[0]


def _named(effects: Sequence[FittedEffect], name: str) -> list[FittedEffect]:
    return [effect.model_copy(update={"joint": effect.joint or name}) for effect in effects]


def _mean(probabilities: Sequence[float]) -> float:
    logs = [math.log(max(p, 1e-12)) for p in probabilities]
    return float(min(math.exp(float(np.mean(logs))), 1.0))


def _shrink(shrinks: Sequence[Shrink]) -> Shrink | None:
    """Root mean squares and means over the parts."""
    if not shrinks:
        return None
    predicted = [s.predicted_ratio for s in shrinks if s.predicted_ratio is not None]
    return Shrink(
        predicted_ratio=float(np.mean(predicted)) if predicted else None,
        before_m=math.sqrt(float(np.mean([s.before_m**2 for s in shrinks]))),
        after_m=math.sqrt(float(np.mean([s.after_m**2 for s in shrinks]))),
        ratio=float(np.mean([s.ratio for s in shrinks])),
        ci90=(
            float(np.mean([s.ci90[0] for s in shrinks])),
            float(np.mean([s.ci90[1] for s in shrinks])),
        ),
        held_out_throws=sum(s.held_out_throws for s in shrinks),
        removable_ratio=float(np.mean([s.removable_ratio for s in shrinks])),
    )
