"""From findings to the verdict: gap, causes with intervals, ambiguity, what was ruled out, one sentence."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from diagnosis.causes.evidence import screen, total, weigh
from diagnosis.causes.problem import Problem
from diagnosis.causes.ranking import Ranked
from diagnosis.fitted_causes import causes_of, effect_names
from diagnosis.healthy.reference import reference_evidence
from diagnosis.loading.throw_data import LoadedSet
from diagnosis.places import named, signature_of, where
from diagnosis.report.report_words import percent
from diagnosis.sentence import sentence_of
from diagnosis.separating import alone_motion, separating_motion
from diagnosis.stages import Terms, stage_gaps
from diagnosis.verdict import Ambiguity, Diagnosis, Gap, Shrink, VerdictKind
from sim_twin.effects.effect import Effect

LEAST_GAIN_RATIO = 0.05
"""An effect that closes less than this of the removable gap, whatever the throws, is no explanation (by
eye)."""
PLAIN_PROBABILITY = 0.01
"""Where "none" is less probable than this, a gain must be possible, and need not be certain (by eye)."""
SOME_PROBABILITY = 0.05
MOST_LOSS_RATIO = 0.1
"""Where "none" is as probable as this, an effect is not claimed that closes less than `LEAST_GAIN_RATIO` of
the gap even at the upper end of its interval, or may widen it by that much at the lower. Nor, where "none" is
as probable as `PLAIN_PROBABILITY`, one that closes less than that on average. Two answers about a healthy
stranger named a joint's sensor ("none" 0.07 and 0.31; no gain); of two healthy machines (seed 713672797) one
had a slew's limit (0.13; -26 to 100 %), one another inertia (0.02; 5 %). Of 303 sets with known effects
(that seed and 20261126) one right answer is lost, a load of 1.5 limits."""
RULED_OUT_COUNT = 12


@dataclass(frozen=True, slots=True)
class Findings:
    """All that the verdict is made of."""

    loaded: LoadedSet
    reference: LoadedSet | None
    """Healthy throws of the machine that it was compared with."""
    problem: Problem
    ranked: Ranked
    terms: Terms
    shrink: tuple[Shrink, str] | None
    """And what it was measured on: ``impact`` or ``channels``."""


def conclude(found: Findings) -> Diagnosis:
    """The result."""
    ranked = found.ranked
    stages = stage_gaps(found.terms)
    gap = _gap(found)
    causes = causes_of(found.problem, ranked)
    shrunk = None if found.shrink is None else found.shrink[0]
    demoted = _demoted(ranked, shrunk)
    verdict = verdict_of(ranked, shrunk)
    ambiguity: Ambiguity | None = None
    if verdict is VerdictKind.AMBIGUOUS:
        ambiguity = ambiguity_of(ranked, shrunk)
    return Diagnosis(
        verdict=verdict,
        sentence=sentence_of(verdict, causes, gap, found.shrink, ranked, ambiguity),
        gap=gap,
        stages=stages,
        causes=causes,
        ambiguity=ambiguity,
        shrink=shrunk if verdict in (VerdictKind.EXPLAINED, VerdictKind.AMBIGUOUS) else None,
        evidence={
            **found.loaded.evidence(),
            "reference": reference_evidence(found.reference),
            "twin": {
                "machine_id": found.problem.profile.machine_id,
                "version_count": found.problem.profile.version_count,
            },
            "where": where(verdict, ranked, stages),
            "named": named(verdict, ranked),
            "leftover_sd": {name: round(value, 2) for name, value in ranked.levels.items()},
            "log_evidence": {
                effect_names(h.effects) or "none": round(float(h.log_evidence[0]), 1)
                for h in ranked.hypotheses
            },
            "ruled_out": _ruled_out(found),
            "unknown": signature_of(ranked) if verdict is VerdictKind.UNKNOWN else None,
            "shrink_measure": None if found.shrink is None else found.shrink[1],
            "demoted": demoted,
        },
    )


def verdict_of(ranked: Ranked, gain: Shrink | None) -> VerdictKind:
    """What is claimed.

    Args:
        ranked: the hypotheses.
        gain: of the best one on held-out throws; None if too few have an impact.
    """
    if ranked.is_unknown:
        return VerdictKind.UNKNOWN
    if not ranked.best.members:
        return VerdictKind.EXPLAINED if ranked.has_jitter else VerdictKind.NONE
    if _is_doubtful(ranked, gain):
        return VerdictKind.AMBIGUOUS if ranked.has_jitter else VerdictKind.NONE
    if ranked.rival is None and _demoted(ranked, gain) is None:
        return VerdictKind.EXPLAINED
    return VerdictKind.AMBIGUOUS


def _is_doubtful(ranked: Ranked, gain: Shrink | None) -> bool:
    """Whether "none" is too probable for a claim, jitter apart."""
    return ranked.is_doubtful or (gain is not None and _is_idle(gain, ranked.none_probability))


def _is_idle(gain: Shrink, none: float) -> bool:
    """Whether a cause that gains so little is no claim while "none" is so probable."""
    if none >= SOME_PROBABILITY:
        low, high = gain.ci90
        if high <= LEAST_GAIN_RATIO or low < -MOST_LOSS_RATIO:
            return True
    return none >= PLAIN_PROBABILITY and gain.ratio <= LEAST_GAIN_RATIO


def _demoted(ranked: Ranked, gain: Shrink | None) -> str | None:
    """Why the best cause may not be called the explanation: it gains nothing on held-out throws."""
    if not ranked.best.members:
        return None
    if gain is None:
        return "too few throws with an impact to show a gain on held-out throws"
    if gain.ratio > LEAST_GAIN_RATIO and gain.ci90[0] > 0.0:
        return None
    if gain.ci90[1] > LEAST_GAIN_RATIO and ranked.none_probability < PLAIN_PROBABILITY:
        return None
    return (
        f"{effect_names(ranked.best.effects)} closes {percent(gain.ratio)} of the removable gap on held-out "
        f"throws ({percent(gain.ci90[0])} to {percent(gain.ci90[1])}): no gain that can be shown"
    )


def _gap(found: Findings) -> Gap:
    gap = found.terms.gap_m[np.isfinite(found.terms.gap_m).all(axis=1)]
    power = [float(w.residual @ w.residual) for w in found.problem.whitened]
    rows = sum(w.residual.size for w in found.problem.whitened)
    ratio = float(np.sqrt(sum(power) / max(rows, 1)))
    if gap.shape[0] == 0:
        return Gap(trajectory_rms_ratio=ratio)
    return Gap(
        impact_rms_m=float(np.sqrt((gap**2).sum(axis=1).mean())),
        downrange_bias_m=float(gap[:, 0].mean()),
        crossrange_bias_m=float(gap[:, 1].mean()),
        trajectory_rms_ratio=ratio,
    )


def ambiguity_of(ranked: Ranked, gain: Shrink | None) -> Ambiguity:
    """What the throws leave open: which cause, or, where that is in doubt, whether it is one at all."""
    # Jitter that is there either way is part of either cause.
    more = (ranked.jitter.effect(),) if ranked.has_jitter else ()
    if ranked.is_doubtful:
        why = f"that there is nothing beside the jitter is {percent(ranked.none_probability)} probable"
        return _or_nothing(ranked, more, why)
    if ranked.rival is None or _is_doubtful(ranked, gain):
        return _or_nothing(ranked, more, _demoted(ranked, gain) or "")
    return _ambiguity(ranked, more)


def _ambiguity(ranked: Ranked, more: tuple[Effect, ...]) -> Ambiguity:
    rival = ranked.rival
    if rival is None:
        raise ValueError("no rival, no ambiguity")
    own = [e for e in ranked.best.effects if e not in rival.effects]
    mine = [
        e
        for e, m in zip(ranked.best.effects, ranked.best.members, strict=True)
        if m not in rival.members
    ]
    other = [
        e for e, m in zip(rival.effects, rival.members, strict=True) if m not in ranked.best.members
    ]
    first = (mine or own or list(ranked.best.effects))[0]
    second = (other or list(rival.effects))[0]
    members = (
        effect_names((*ranked.best.effects, *more)),
        effect_names((*rival.effects, *more)),
    )
    return Ambiguity(
        members=members,
        separating_motion=separating_motion(first, second),
        why=(
            f"these throws leave {members[1]} probable beside {members[0]}; with a perfect library they "
            f"would favour the true one by a factor of "
            f"{np.exp(min(max(ranked.rival_log_odds, 0.0), 20.0)):.1f} on average"
        ),
    )


def _or_nothing(ranked: Ranked, more: tuple[Effect, ...], why: str) -> Ambiguity:
    """A cause that the throws favour, and that gains nothing that can be shown."""
    return Ambiguity(
        members=(effect_names((*ranked.best.effects, *more)), effect_names(more) or "none"),
        separating_motion=alone_motion(ranked.best.effects[0]),
        why=why,
    )


def _ruled_out(found: Findings) -> list[dict[str, Any]]:
    """Single effects that the throws speak against most surely, with how far below "no effect"."""
    problem = found.problem
    base = screen(total(problem.information), problem.layout.priors)
    entries: list[dict[str, Any]] = []
    for group, name in enumerate(problem.layout.groups):
        if problem.layout.is_unheard(group):
            continue
        weighed = weigh(base, problem.layout.priors, (group,))
        entries.append(
            {"effect": name[0], "joint": name[1], "log_odds": round(weighed.log_odds, 2)}
        )
    entries.sort(key=lambda entry: entry["log_odds"])
    return entries[:RULED_OUT_COUNT]
