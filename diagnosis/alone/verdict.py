"""Puts a stage's selection into the result that every diagnosis has: verdict, causes, shrink, evidence."""

from collections.abc import Mapping
from typing import Any, Final, NamedTuple

from diagnosis.alone.held_out import held_out_shrink
from diagnosis.alone.intervals import intervals
from diagnosis.alone.limits import Limit, hidden_limits
from diagnosis.alone.problem import Problem
from diagnosis.alone.selection import SHAPE_EFFECTS, Scored, Selection, describe
from diagnosis.verdict import (
    Ambiguity,
    Cause,
    Diagnosis,
    FittedEffect,
    FittedParameter,
    Gap,
    Miss,
    Shrink,
    Stage,
    StageGap,
    VerdictKind,
)

MAX_CAUSES_COUNT: Final = 6
AMBIGUOUS_RATIO: Final = 0.25
"""A rival set with at least this share of the winner's probability, with other effects, is a draw."""

SHOWN_GAIN_RATIO: Final = 0.01
"""Of the gap: an effect that may remove less of it on held-out data is not shown by them."""
RIVAL_RATIO: Final = 0.05
PARTLY_RATIO: Final = 0.15
"""Of the motion: when more is left unexplained, the sentence says so before the effects."""


class StageNames(NamedTuple):
    """How a stage is called, and what tells its effects apart."""

    stage: Stage
    joint: str | None
    unit: str
    """Of the residual."""
    separating: Mapping[frozenset[str], str]


def diagnosis_of(
    problem: Problem,
    selection: Selection,
    noise: float,
    names: StageNames,
    evidence: Mapping[str, Any],
    plots: Mapping[str, Any],
) -> Diagnosis:
    """The result of one stage alone."""
    shrink = held_out_shrink(problem, selection, noise)
    ambiguity = _ambiguity(selection, names) or _doubt(selection, shrink, names)
    verdict = _verdict(selection, ambiguity)
    causes = _causes(problem, selection, names)
    limits = hidden_limits(problem, selection) if verdict is VerdictKind.NONE else ()
    ratio = shrink.before_m / max(noise, 1e-12)
    sentence = _sentence(verdict, causes, shrink, selection, names, limits)
    if verdict is VerdictKind.AMBIGUOUS and ambiguity is not None:
        sentence += f" It may as well be {ambiguity.members[1]}: {ambiguity.why}."
    return Diagnosis(
        verdict=verdict,
        sentence=sentence,
        gap=Gap(trajectory_rms_ratio=ratio),
        stages=(
            StageGap(
                stage=names.stage,
                joint=names.joint,
                miss_m=Miss(downrange=0.0, crossrange=0.0),
                share_ratio=1.0,
                ci90_m=(0.0, 0.0),
            ),
        ),
        causes=causes,
        ambiguity=ambiguity,
        shrink=shrink if verdict is not VerdictKind.NONE else None,
        evidence={
            **evidence,
            "selection": describe(selection),
            "limits": [limit._asdict() for limit in limits],
            "residual_unit": names.unit,
            "shrink_unit": f"rms of the residual in {names.unit}; held_out_throws counts held-out pieces",
        },
        plots=plots,
    )


def fitted_effects(
    problem: Problem, selection: Selection, scored: Scored, joint: str | None
) -> tuple[FittedEffect, ...]:
    """Effects of a structure with their intervals."""
    ranges = dict(intervals(problem, selection.correlation_samples, scored.fit))
    for rival in selection.ranked:
        # What a nearly as probable set says of the same effect belongs into the interval.
        if rival is scored or rival.probability < RIVAL_RATIO:
            continue
        if "drag_crisis" in set(rival.effects) ^ set(scored.effects):
            continue  # drag then means drag at low speed: another number
        for name, (low, high) in intervals(
            problem, selection.correlation_samples, rival.fit
        ).items():
            if name in ranges and set(rival.effects) >= set(scored.effects) - SHAPE_EFFECTS:
                ranges[name] = (min(ranges[name][0], low), max(ranges[name][1], high))
    values = scored.fit.as_mapping()
    effects: list[FittedEffect] = []
    for option in sorted(scored.fit.options, key=lambda option: option.key):
        parameters = {
            p.name: FittedParameter(
                value=values[f"{option.key}.{p.name}"],
                ci90=ranges[f"{option.key}.{p.name}"],
                unit=p.unit,
            )
            for p in option.parameters
        }
        if option.key == "valve_dead_band_even":
            both = parameters.pop("both_ratio")
            parameters |= {"positive_ratio": both, "negative_ratio": both}
        if option.effect == "valve_gain":
            # The common gain is the unit of the data; the two directions differ from it by +r and -r.
            one = parameters["positive_ratio"]
            low, high = one.ci90
            parameters["negative_ratio"] = FittedParameter(
                value=-one.value, ci90=(-high, -low), unit=one.unit
            )
        effects.append(FittedEffect(effect=option.effect, joint=joint, parameters=parameters))
    return tuple(effects)


def _causes(problem: Problem, selection: Selection, names: StageNames) -> tuple[Cause, ...]:
    known = 1.0 - selection.unknown_probability
    causes: list[Cause] = []
    none = 0.0
    for scored in selection.ranked:
        if not scored.effects:
            none = scored.probability * known
        elif len(causes) < MAX_CAUSES_COUNT:
            causes.append(
                Cause(
                    effects=fitted_effects(problem, selection, scored, names.joint),
                    probability=scored.probability * known,
                    name=" + ".join(scored.effects),
                )
            )
    causes.append(Cause(effects=(), probability=none, name="none"))
    causes.append(Cause(effects=(), probability=selection.unknown_probability, name="unknown"))
    return tuple(sorted(causes, key=lambda cause: -cause.probability))


def _ambiguity(selection: Selection, names: StageNames) -> Ambiguity | None:
    """Two sets of which neither holds the other, nearly as probable."""
    best = selection.best
    mine = set(best.effects) - SHAPE_EFFECTS
    for rival in selection.ranked[1:]:
        theirs = set(rival.effects) - SHAPE_EFFECTS
        if rival.probability < AMBIGUOUS_RATIO * best.probability:
            return None
        if mine <= theirs or theirs <= mine:
            continue
        difference = frozenset(mine ^ theirs)
        motion = next(
            (text for pair, text in names.separating.items() if pair <= difference),
            _general_motion(names.stage),
        )
        return Ambiguity(
            members=(" + ".join(best.effects), " + ".join(rival.effects)),
            separating_motion={"kind": names.stage.value, "joint": names.joint, "words": motion},
            why=(
                f"held-out residuals of both are alike (probabilities {best.probability:.2f} and "
                f"{rival.probability:.2f}); they differ in {', '.join(sorted(difference))}"
            ),
        )
    return None


def _doubt(selection: Selection, shrink: Shrink, names: StageNames) -> Ambiguity | None:
    """Between effects and none: "none" is nearly as probable, or held-out data do not show the effects."""
    best = selection.best
    if not best.effects:
        return None
    none = next((item.probability for item in selection.ranked if not item.effects), 0.0)
    low, high = shrink.ci90
    if none >= AMBIGUOUS_RATIO * best.probability:
        why = f"probabilities {best.probability:.2f} and {none:.2f}"
    elif low < SHOWN_GAIN_RATIO:
        why = (
            f"held-out data do not show the effects: they remove {low:.0%} to {high:.0%} of the gap"
        )
    else:
        return None
    return Ambiguity(
        members=(" + ".join(best.effects), "none"),
        separating_motion={
            "kind": names.stage.value,
            "joint": names.joint,
            "words": _general_motion(names.stage),
        },
        why=why,
    )


def _general_motion(stage: Stage) -> str:
    return {
        Stage.ACTUATION: "steps of three sizes and ramps of three slopes in both directions, with 3 s rests",
        Stage.SWING: "a longer free swing from a larger angle, until it has died down",
        Stage.FLIGHT: "throws or drops at two clearly different speeds, tracked from before the release",
    }.get(stage, "a longer and more varied record")


def _verdict(selection: Selection, ambiguity: Ambiguity | None) -> VerdictKind:
    if selection.unknown_probability > 0.5:
        return VerdictKind.UNKNOWN
    if not selection.best.effects:
        return VerdictKind.NONE
    return VerdictKind.EXPLAINED if ambiguity is None else VerdictKind.AMBIGUOUS


def _sentence(
    verdict: VerdictKind,
    causes: tuple[Cause, ...],
    shrink: Shrink,
    selection: Selection,
    names: StageNames,
    limits: tuple[Limit, ...],
) -> str:
    where = f"{names.stage.value} of {names.joint}" if names.joint else names.stage.value
    left = f"{selection.left_ratio:.0%} of the motion is left unexplained on held-out data"
    named = next((cause for cause in causes if cause.effects), None)
    words = "" if named is None else _in_words(named)
    match verdict:
        case VerdictKind.NONE:
            could = f" These data would not show {', '.join(n.in_words() for n in limits)}."
            if selection.left_ratio > PARTLY_RATIO:
                return (
                    f"No effect shows surely in the {where}, yet {left}: the record is too short, too noisy "
                    f"or too much alike to tell what.{could} Record more: {_general_motion(names.stage)}."
                )
            return f"The ideal {where} explains the data; no effect is needed ({left}).{could}"
        case VerdictKind.UNKNOWN:
            best = f" The best known explanation is {words}." if words else ""
            return f"Something acts on the {where} that no effect of the library explains: {left}.{best}"
        case _:
            low, high = shrink.ci90
            shows = "shows" if verdict is VerdictKind.EXPLAINED else "may show"
            share = "in part " if selection.left_ratio > PARTLY_RATIO else ""
            return (
                f"The {where} {shows} {share}{words}; on held-out data this removes "
                f"{shrink.ratio:.0%} of the gap ({low:.0%} to {high:.0%}), predicted "
                f"{shrink.predicted_ratio or 0.0:.0%}; {left}."
            )


def _in_words(cause: Cause) -> str:
    parts: list[str] = []
    for effect in cause.effects:
        numbers = ", ".join(
            f"{name} {p.value:.3g} ({p.ci90[0]:.3g} to {p.ci90[1]:.3g})"
            for name, p in effect.parameters.items()
        )
        parts.append(f"{effect.effect} [{numbers}]")
    return " + ".join(parts)
