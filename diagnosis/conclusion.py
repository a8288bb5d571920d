"""The result of a diagnosis: gap, causes with intervals, ambiguity, effects ruled out, and one sentence."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from diagnosis.fitted_causes import causes_of, effect_names, fitted, fitted_jitter
from diagnosis.hypotheses.candidate import no_effect
from diagnosis.hypotheses.gap_problem import GapProblem
from diagnosis.hypotheses.ranking import Hypothesis, Ranked
from diagnosis.hypotheses.search import linear_gains
from diagnosis.loading.throw_data import LoadedSet
from diagnosis.location import named, signature_of, where
from diagnosis.reference_throws import reference_evidence
from diagnosis.report.effect_sentences import effect_sentence
from diagnosis.report.vocabulary import channel_words
from diagnosis.separating_motions import detecting_motion, separating_motion
from diagnosis.stages import Terms, stage_gaps
from diagnosis.tuning import LEAST_GAIN_RATIO, MOST_LOSS_RATIO, PLAIN_PROBABILITY, SOME_PROBABILITY
from diagnosis.verdict import Ambiguity, Cause, Diagnosis, FittedEffect, Gap, Shrink, VerdictKind
from reports.number_format import percent, probability
from sim_twin.effects.effect import Effect

RULED_OUT_COUNT = 12
"""Number of single effects listed as ruled out."""


@dataclass(frozen=True, slots=True)
class Findings:
    """Everything that the verdict depends on."""

    loaded: LoadedSet
    reference: LoadedSet | None
    """Throws of this machine while it was healthy, if it was compared with them."""
    problem: GapProblem
    ranked: Ranked
    terms: Terms
    shrink: tuple[Shrink, str] | None
    """Reduction of the gap, and its measure: ``impact`` or ``channels``."""
    material_m: float | None = None
    """Least displacement of the impact from which an effect is claimed."""
    healthy_gap_m: Mapping[str, float] = field(default_factory=dict[str, float])
    """Impact gap of this machine while it was healthy, by mode (`Health.replay_gap_m`)."""
    health_kept_utc: str | None = None
    """When the model of the healthy machine was estimated, if it was kept from an earlier diagnosis."""


def conclude(found: Findings) -> Diagnosis:
    """The result of a diagnosis."""
    ranked = found.ranked
    stages = stage_gaps(found.terms)
    gap = _gap(found)
    causes = causes_of(found.problem, ranked)
    gain = None if found.shrink is None else found.shrink[0]
    verdict = verdict_of(ranked, gain)
    small = _small_change(found, verdict)
    if small is not None:
        verdict = VerdictKind.NONE
    ambiguity: Ambiguity | None = None
    if verdict is VerdictKind.AMBIGUOUS:
        both = _effects_of_both(found.problem, ranked, gain)
        ambiguity = ambiguity_of(ranked, gain).model_copy(update={"effects": both})
    sentence = sentence_of(verdict, causes, gap, found.shrink, ranked, ambiguity)
    return Diagnosis(
        verdict=verdict,
        sentence=sentence if small is None else _miss_words(gap) + small,
        gap=gap,
        stages=stages,
        causes=causes,
        ambiguity=ambiguity,
        shrink=gain if verdict in (VerdictKind.EXPLAINED, VerdictKind.AMBIGUOUS) else None,
        evidence={
            **found.loaded.evidence(),
            "reference": reference_evidence(found.reference, found.health_kept_utc),
            "twin": {
                "machine_id": found.problem.profile.machine_id,
                "version_count": found.problem.profile.version_count,
            },
            "where": where(verdict, ranked, stages),
            "named": named(verdict, ranked),
            "leftover_sd": {name: round(one.level_sd, 2) for name, one in ranked.left.items()},
            "conflict_ratio": {
                name: round(one.conflict_ratio, 2) for name, one in ranked.left.items()
            },
            "excess_ratio": {name: round(one.excess_ratio, 2) for name, one in ranked.left.items()},
            "log_evidence": {
                effect_names(h.effects) or "none": round(h.log_evidence, 1)
                for h in ranked.hypotheses
            },
            "ruled_out": _ruled_out(found),
            "unknown": signature_of(ranked) if verdict is VerdictKind.UNKNOWN else None,
            "shrink_measure": None if found.shrink is None else found.shrink[1],
            "demoted": _demoted(ranked, gain),
            "material_m": found.material_m,
        },
    )


def verdict_of(ranked: Ranked, gain: Shrink | None) -> VerdictKind:
    """The verdict.

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


def _small_change(found: Findings, verdict: VerdictKind) -> str | None:
    """What was seen, where the effect found moves the impact by less than what matters; else None."""
    moved_m = None if found.shrink is None else found.shrink[0].moved_m
    is_claimed = verdict in (VerdictKind.EXPLAINED, VerdictKind.AMBIGUOUS)
    if not is_claimed or moved_m is None or found.material_m is None or moved_m >= found.material_m:
        return None
    return (
        f"No effect that matters. Small change seen: {effect_names(found.ranked.best.effects)} moves the "
        f"impact by {moved_m:.3f} m, less than the {found.material_m:g} m asked for."
    )


def _is_doubtful(ranked: Ranked, gain: Shrink | None) -> bool:
    """Whether "none" is too probable for a claim; jitter is judged separately."""
    return ranked.is_doubtful or (gain is not None and _is_idle(gain, ranked.none_probability))


def _is_idle(gain: Shrink, none: float) -> bool:
    """Whether the gain is too small for a claim at this probability of "none"."""
    if none >= SOME_PROBABILITY:
        low, high = gain.ci90
        if high <= LEAST_GAIN_RATIO or low < -MOST_LOSS_RATIO:
            return True
    return none >= PLAIN_PROBABILITY and gain.ratio <= LEAST_GAIN_RATIO


def _demoted(ranked: Ranked, gain: Shrink | None) -> str | None:
    """Why the best cause may not be called the explanation; None if it may."""
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
    healthy = [found.healthy_gap_m.get(p.throw.mode) for p in found.problem.prepared]
    floor = [value for value in healthy if value is not None]
    return Gap(
        impact_rms_m=float(np.sqrt((gap**2).sum(axis=1).mean())),
        healthy_rms_m=float(np.sqrt(np.mean(np.square(floor)))) if floor else None,
        downrange_bias_m=float(gap[:, 0].mean()),
        crossrange_bias_m=float(gap[:, 1].mean()),
        trajectory_rms_ratio=ratio,
    )


def rival_of(ranked: Ranked, gain: Shrink | None) -> Hypothesis | None:
    """The other side of an open choice; None for no cause."""
    return None if ranked.is_doubtful or _is_doubtful(ranked, gain) else ranked.rival


def ambiguity_of(ranked: Ranked, gain: Shrink | None) -> Ambiguity:
    """What the throws leave open, in words: which of two causes, or whether there is a cause at all."""
    # Jitter is part of either cause.
    more = (ranked.jitter.effect(),) if ranked.has_jitter else ()
    if ranked.is_doubtful:
        why = f"that there is nothing beside the jitter is {percent(ranked.none_probability)} probable"
        return _or_nothing(ranked, more, why)
    rival = rival_of(ranked, gain)
    if rival is None:
        return _or_nothing(ranked, more, _demoted(ranked, gain) or "")
    return _ambiguity(ranked, rival, more)


def _effects_of_both(
    problem: GapProblem, ranked: Ranked, gain: Shrink | None
) -> tuple[tuple[FittedEffect, ...], ...]:
    """The effects of both sides of an open choice."""
    more = (fitted_jitter(ranked),) if ranked.has_jitter else ()
    rival = rival_of(ranked, gain)
    return (
        (*fitted(problem, ranked.best), *more),
        (*(() if rival is None else fitted(problem, rival)), *more),
    )


def _ambiguity(ranked: Ranked, rival: Hypothesis, more: tuple[Effect, ...]) -> Ambiguity:
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
    """The choice between a cause that the throws favour, and no cause."""
    return Ambiguity(
        members=(effect_names((*ranked.best.effects, *more)), effect_names(more) or "none"),
        separating_motion=detecting_motion(ranked.best.effects[0]),
        why=why,
    )


def _ruled_out(found: Findings) -> list[dict[str, Any]]:
    """Single effects with the lowest log odds against "no effect"."""
    layout = found.problem.layout
    likelihood = found.ranked.likelihood
    groups = [g for g in range(len(layout.groups)) if not layout.is_unmodelled(g)]
    log_odds = {
        g: gain for g, (gain, _) in linear_gains(likelihood, no_effect(likelihood), groups).items()
    }
    return [
        {
            "effect": layout.groups[g][0],
            "joint": layout.groups[g][1],
            "log_odds": round(log_odds[g], 2),
        }
        for g in sorted(groups, key=lambda g: log_odds[g])[:RULED_OUT_COUNT]
    ]


def _miss_words(gap: Gap) -> str:
    if gap.impact_rms_m is None:
        return ""
    healthy = (
        ""
        if gap.healthy_rms_m is None
        else f" (while the machine was healthy: {gap.healthy_rms_m:.2f} m)"
    )
    return f"The twin's replay misses by {gap.impact_rms_m:.2f} m{healthy}. "


def sentence_of(
    verdict: VerdictKind,
    causes: Sequence[Cause],
    gap: Gap,
    found: tuple[Shrink, str] | None,
    ranked: Ranked,
    ambiguity: Ambiguity | None,
) -> str:
    """The verdict for people: the miss, its cause, and how much of it the cause closes.

    Args:
        verdict: the verdict.
        causes: with their probabilities, best first.
        gap: between twin and machine.
        found: reduction of the gap, and its measure; None if nothing was tested.
        ranked: the hypotheses behind the causes.
        ambiguity: what these throws leave open.
    """
    size = _miss_words(gap)
    top, sure = causes[0], probability(causes[0].probability)
    if verdict is VerdictKind.NONE:
        if ranked.best.members:
            return f"{size}No effect that can be claimed; {top.name} ({sure}) comes nearest."
        return f"{size}No effect: a healthy machine scatters as much ({sure} sure)."
    if verdict is VerdictKind.UNKNOWN:
        signature = signature_of(ranked)
        joint = "" if signature["joint"] is None else f" of the {signature['joint']}"
        if signature["looks_like"] is not None:
            return f"{size}Something unknown in {signature['stage']}{joint}: {signature['looks_like']}."
        leaves = "the best known cause leaves" if ranked.best.members else "no known cause explains"
        beyond = (
            "above the twin; only reference throws tell whether this machine was ever otherwise."
            if gap.healthy_rms_m is None
            else "above a healthy machine."
        )
        return (
            f"{size}Something unknown in {signature['stage']}{joint}: {leaves} "
            f"{channel_words(signature['channel'])} {signature['leftover_sd']:.0f} standard deviations "
            f"{beyond}"
        )
    closes = ""
    if found is not None:
        shrink, measure = found
        metres = (
            f" ({shrink.before_m:.2f} m to {shrink.after_m:.2f} m)" if measure == "impact" else ""
        )
        what = "miss" if measure == "impact" else "gap in its channels"
        share = percent(shrink.ratio)
        closes = f" Adding it closes {share} of the removable {what} on held-out throws{metres}."
    if ambiguity is not None:
        return f"{size}Either {ambiguity.members[0]} or {ambiguity.members[1]}.{closes}"
    does = "; ".join(effect_sentence(effect) for effect in top.effects)
    return f"{size}Cause: {top.name} ({sure} sure): {does}.{closes}"
