"""Stage and joint of a cause, or of what no effect explains."""

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from diagnosis.fitted_causes import effect_names
from diagnosis.hypotheses.ranking import Ranked, unknown_log_odds
from diagnosis.linearisation.unmodelled_effects import unmodelled_effect_of
from diagnosis.tuning import QUIET_SD
from diagnosis.verdict import (
    Stage,
    StageGap,
    VerdictKind,
)
from sim_twin.effects.effect import Effect, effect_stage

SIDEWAYS: Final = {"swing.gyro.x": "slew", "swing.gyro.y": None}
"""Rates about the axes of the two passive joints, and the driven joint that alone moves the pin that way."""


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


def _is_of_one_axis(name: str, levels: Mapping[str, float]) -> bool:
    """Whether the swing deviates about one of the gripper's axes alone.

    Friction, length and inertia act about both axes. Motion of the pin that the joint sensors do not show
    acts on one.
    """
    others = [other for other in SIDEWAYS if other != name]
    return name in SIDEWAYS and all(levels.get(other, np.inf) < QUIET_SD for other in others)


def signature_of(ranked: Ranked) -> dict[str, Any]:
    """Where an unknown effect shows, and what it resembles."""
    best, ahead = ranked.best, ranked.ahead
    name = max(ranked.levels, key=lambda b: unknown_log_odds(best, ahead, b, ranked.levels[b]))
    stage, _, channel = name.partition(".")
    joint = channel if stage == Stage.ACTUATION else None
    if _is_of_one_axis(name, ranked.levels):
        stage, joint = Stage.AIM.value, SIDEWAYS[name]
    shape = None if ranked.shape is None else unmodelled_effect_of(ranked.shape[0])
    if ranked.shape is not None and shape is not None:
        stage, joint = shape.stage, ranked.shape[1]
        name = stage if joint is None else f"{stage}.{joint}"
    return {
        "stage": stage,
        "joint": joint,
        "channel": name,
        "leftover_sd": round(ranked.levels.get(name, 0.0), 1),
        "looks_like": None if shape is None else shape.description,
        "nearest": effect_names(ranked.best.effects) or "none",
    }
