"""Stage and joint of a cause, or of what no effect explains."""

from collections.abc import Sequence
from typing import Any

from diagnosis.fitted_causes import effect_names
from diagnosis.hypotheses.ranking import Ranked
from diagnosis.linearisation.unmodelled_effects import unmodelled_effect_of
from diagnosis.verdict import (
    StageGap,
    VerdictKind,
)
from sim_twin.effects.effect import Effect, effect_stage


def where(
    verdict: VerdictKind, ranked: Ranked, stages: Sequence[StageGap]
) -> dict[str, str | None] | None:
    """The stage and joint to look at: of the unexplained residual, or of the cause's most probable effect.

    Where nothing is claimed, those of the most probable effect of any hypothesis.
    """
    if verdict is VerdictKind.UNKNOWN:
        signature = signature_of(ranked)
        return {"stage": signature["stage"], "joint": signature["joint"]}
    claimed = verdict in (VerdictKind.EXPLAINED, VerdictKind.AMBIGUOUS)
    looked_at = [ranked.best] if claimed else ranked.hypotheses
    members = {m: e for h in looked_at for m, e in zip(h.members, h.effects, strict=True)}
    possible = [(_inclusion(ranked, member), effect) for member, effect in members.items()]
    if ranked.has_jitter:
        possible.append((ranked.jitter_probability, ranked.jitter.effect()))
    if possible:
        return _place(max(possible, key=lambda one: one[0])[1])
    largest = max(stages, key=lambda s: s.share_ratio, default=None)
    return None if largest is None else {"stage": largest.stage, "joint": largest.joint}


def _place(effect: Effect) -> dict[str, str | None]:
    return {"stage": effect_stage(effect), "joint": effect.joint}


def _inclusion(ranked: Ranked, member: int) -> float:
    """Total probability of the hypotheses that contain an effect."""
    shares = zip(ranked.hypotheses, ranked.probability, strict=True)
    return sum(float(p) for h, p in shares if member in h.members)


def named(verdict: VerdictKind, ranked: Ranked) -> list[dict[str, str | None]]:
    """Stage and joint of every effect of the claimed cause."""
    if verdict not in (VerdictKind.EXPLAINED, VerdictKind.AMBIGUOUS):
        return []
    named = ranked.best.effects or (ranked.jitter.effect(),)
    return [_place(effect) for effect in named]


def signature_of(ranked: Ranked) -> dict[str, Any]:
    """Where an unknown effect shows, and what it resembles."""
    name = max(ranked.left, key=lambda part: ranked.left[part].ratio)
    leftover_sd = ranked.left[name].level_sd
    stage, _, joint = name.partition(".")
    shape = None if ranked.resembles is None else unmodelled_effect_of(ranked.resembles[0])
    if ranked.resembles is not None and shape is not None:
        stage, joint = shape.stage, ranked.resembles[1]
    return {
        "stage": stage,
        "joint": joint or None,
        "channel": name,
        "leftover_sd": round(leftover_sd, 1),
        "looks_like": None if shape is None else shape.description,
        "nearest": effect_names(ranked.best.effects) or "none",
    }
