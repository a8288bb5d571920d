"""The result of a single-stage diagnosis: verdict, causes, upper limits, explained share, evidence.

Results of several joints or balls are combined into one.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np

from diagnosis.single_stage.fit import StructureFit, fit_structure
from diagnosis.single_stage.fit_problem import FitProblem
from diagnosis.single_stage.held_out import measure_held_out_shrink
from diagnosis.single_stage.structure_selection import (
    AMBIGUOUS_RATIO,
    REFINEMENT_EFFECTS,
    ScoredStructure,
    Selection,
    describe_selection,
    find_doubtful_effects,
    reported_intervals,
)
from diagnosis.single_stage.uncertainty import parameter_intervals
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
"""Most causes that are reported."""
MIN_SHOWN_RATIO: Final = 0.01
"""Lower end of the explained share below which held-out data do not show the effects."""
AT_BOUND_RATIO: Final = 0.01
"""Distance from the end of its range, as a share of it, below which a parameter is at its bound."""
AT_BOUND_PROBABILITY: Final = 0.95
"""Probability of "unknown" if a parameter of the best set is at its bound."""
MAX_LIMITS_COUNT: Final = 8
"""Most upper limits that are reported."""
NOISE_LIKE_RATIO: Final = 1.5
"""Residual, in standard deviations of the noise, below which it counts as noise."""
VERDICT_PRIORITY: Final = (
    VerdictKind.UNKNOWN,
    VerdictKind.AMBIGUOUS,
    VerdictKind.EXPLAINED,
    VerdictKind.NONE,
    VerdictKind.BAD_DATA,
)
"""The verdict of the whole is the first of these that a part has."""


class UpperLimit(NamedTuple):
    """Upper end of the 90 % interval of an absent effect's parameter, fitted beside the effects found."""

    effect: str
    parameter: str
    below: float
    unit: str

    def describe(self) -> str:
        """Text for the sentence of a verdict."""
        return f"{self.effect} up to {self.below:.2g} {self.unit}".removesuffix(" 1")


def find_upper_limits(problem: FitProblem, selection: Selection) -> tuple[UpperLimit, ...]:
    """Upper limits of the effects that are not in the best structure, one per parameter."""
    best = selection.best.fit
    taken = {option.place for option in best.options}
    limits: list[UpperLimit] = []
    for option in problem.options:
        if option.place in taken or option.effect in REFINEMENT_EFFECTS:
            continue
        taken.add(option.place)
        found = fit_structure(problem, (*best.options, option), best.as_mapping())
        ranges = parameter_intervals(problem, selection.correlation_samples, found)
        for p in option.parameters:
            name = f"{option.key}.{p.name}"
            low, high = ranges[name]
            upper = max(abs(low), abs(high), _size_within_residual(problem, found, name))
            limits.append(UpperLimit(option.effect, p.name, min(upper, p.high), p.unit))
    return tuple(limits[:MAX_LIMITS_COUNT])


def _size_within_residual(problem: FitProblem, found: StructureFit, name: str) -> float:
    """Magnitude at which the effect alone changes the response as much as the residual; 0 if that is noise.

    Systematic errors of the record, such as lens distortion, may hide as much of the effect.
    """
    residual_rms = math.sqrt(found.mean_square)
    if residual_rms < NOISE_LIKE_RATIO * problem.noise:
        return 0.0
    own = np.array([one == name for one in found.names])
    basis, _ = np.linalg.qr(found.jacobian[:, ~own])
    column = found.jacobian[:, own]
    pattern = math.sqrt(float(np.mean((column - basis @ (basis.T @ column)) ** 2)))
    return residual_rms / max(pattern, 1e-12)


def find_parameters_at_bound(found: StructureFit) -> tuple[str, ...]:
    """Parameters of effects that end at a bound, as ``effect.parameter``: the fit wanted more.

    A magnitude at a lower bound where the effect is absent is no matter: the effect is then small, or acts in
    one direction only.
    """
    values = found.as_mapping()
    at_bound: list[str] = []
    for option in found.options:
        for p in option.parameters:
            value, margin = values[f"{option.key}.{p.name}"], AT_BOUND_RATIO * (p.high - p.low)
            is_high = value > p.high - margin and not p.is_absent_at_high
            counts_low = p.low < 0.0 or not p.is_absent_at_low
            if is_high or (counts_low and value < p.low + margin):
                at_bound.append(f"{option.effect}.{p.name}")
    return tuple(at_bound)


class StageLabels(NamedTuple):
    """Labels of a stage, and records that separate its effects."""

    stage: Stage
    joint: str | None
    unit: str
    """Of the residual."""
    separating_records: Mapping[frozenset[str], str]
    """By pair of effects: what to record to distinguish them."""


def build_diagnosis(
    problem: FitProblem,
    selection: Selection,
    noise: float,
    labels: StageLabels,
    evidence: Mapping[str, Any],
    plots: Mapping[str, Any],
) -> Diagnosis:
    """Build the result of one stage.

    Args:
        problem: data and simulation.
        selection: posterior over structures.
        noise: standard deviation of the measurement noise, in the unit of the residual.
        labels: labels of the stage.
        evidence: rates, units, notes and other facts of the record.
        plots: series for the report.
    """
    shrink = measure_held_out_shrink(problem, selection.base.fit, selection.best.fit, noise)
    if at_bound := find_parameters_at_bound(selection.best.fit):
        probability = max(selection.unknown_probability, AT_BOUND_PROBABILITY)
        selection = replace(selection, unknown_probability=probability)
    ambiguity = _find_ambiguity(problem, selection, labels) or _find_ambiguity_with_fewer(
        problem, selection, shrink, labels
    )
    verdict = _choose_verdict(selection, ambiguity)
    causes = _list_causes(problem, selection, labels)
    limits = find_upper_limits(problem, selection) if verdict is VerdictKind.NONE else ()
    ratio = shrink.before_m / max(noise, 1e-12)
    sentence = _write_sentence(verdict, causes, shrink, selection, labels, limits, at_bound)
    if verdict is VerdictKind.AMBIGUOUS and ambiguity is not None:
        sentence += f" It may as well be {ambiguity.members[1]}: {ambiguity.why}."
    return Diagnosis(
        verdict=verdict,
        sentence=sentence,
        gap=Gap(trajectory_rms_ratio=ratio),
        stages=(
            StageGap(
                stage=labels.stage,
                joint=labels.joint,
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
            "selection": describe_selection(selection),
            "limits": [limit._asdict() for limit in limits],
            "at_bound": list(at_bound),
            "residual_unit": labels.unit,
            "shrink_unit": f"rms of the residual in {labels.unit}; held_out_throws counts held-out pieces",
        },
        plots=plots,
    )


def describe_fitted_effects(
    problem: FitProblem, selection: Selection, scored: ScoredStructure, joint: str | None
) -> tuple[FittedEffect, ...]:
    """Effects of a structure with their reported 90 % intervals."""
    ranges = reported_intervals(problem, selection, scored)
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
        if option.key == "valve_dead_time_two_sided":
            ways = list(parameters.values())
            parameters["extra_dead_time_s"] = FittedParameter(
                value=0.5 * sum(p.value for p in ways),
                ci90=(0.5 * sum(p.ci90[0] for p in ways), 0.5 * sum(p.ci90[1] for p in ways)),
                unit="s",
            )
        if option.effect == "valve_gain":
            # Relative to the common gain the two directions differ by +r and -r.
            one = parameters["positive_ratio"]
            low, high = one.ci90
            parameters["negative_ratio"] = FittedParameter(
                value=-one.value, ci90=(-high, -low), unit=one.unit
            )
        effects.append(FittedEffect(effect=option.effect, joint=joint, parameters=parameters))
    return tuple(effects)


def _list_causes(
    problem: FitProblem, selection: Selection, labels: StageLabels
) -> tuple[Cause, ...]:
    known = 1.0 - selection.unknown_probability
    causes: list[Cause] = []
    none = 0.0
    for scored in selection.ranked:
        if not scored.effects:
            none = scored.probability * known
        elif len(causes) < MAX_CAUSES_COUNT:
            causes.append(
                Cause(
                    effects=describe_fitted_effects(problem, selection, scored, labels.joint),
                    probability=scored.probability * known,
                    name=" + ".join(scored.effects),
                )
            )
    causes.append(Cause(effects=(), probability=none, name="none"))
    causes.append(Cause(effects=(), probability=selection.unknown_probability, name="unknown"))
    return tuple(sorted(causes, key=lambda cause: -cause.probability))


def _find_ambiguity(
    problem: FitProblem, selection: Selection, labels: StageLabels
) -> Ambiguity | None:
    """The best structure and one that may be true in its place, if neither contains the other; else None."""
    best = selection.best
    for rival in selection.ranked[1:]:
        ours, theirs = frozenset(best.effects), frozenset(rival.effects)
        if ours <= theirs or theirs <= ours or not selection.is_possible(rival):
            continue
        difference = ours ^ theirs
        motion = next(
            (text for pair, text in labels.separating_records.items() if pair <= difference),
            _recommend_motion(labels.stage),
        )
        lead = selection.lead(rival)
        return Ambiguity(
            members=(" + ".join(best.effects), " + ".join(rival.effects)),
            effects=tuple(
                describe_fitted_effects(problem, selection, one, labels.joint)
                for one in (best, rival)
            ),
            separating_motion={"kind": labels.stage.value, "joint": labels.joint, "words": motion},
            why=(
                f"held-out data do not tell them apart (they leave {math.sqrt(best.held_out):.3g} and "
                f"{math.sqrt(rival.held_out):.3g} {labels.unit}, {abs(lead):.1f} standard errors apart; "
                f"probabilities {best.probability:.2f} and {rival.probability:.2f}); they differ in "
                f"{', '.join(sorted(difference))}"
            ),
        )
    return None


def _find_ambiguity_with_fewer(
    problem: FitProblem, selection: Selection, shrink: Shrink, labels: StageLabels
) -> Ambiguity | None:
    """Ambiguity with fewer effects or none.

    "None" is probable, held-out data do not show the effects, or the interval of some does not exclude none.
    """
    best = selection.best
    if not best.effects:
        return None
    none = next((item.probability for item in selection.ranked if not item.effects), 0.0)
    low, high = shrink.ci90
    doubtful = frozenset(best.effects)
    if none >= AMBIGUOUS_RATIO * best.probability:
        why = f"probabilities {best.probability:.2f} and {none:.2f}"
    elif low < MIN_SHOWN_RATIO:
        why = (
            f"held-out data do not show the effects: they remove {low:.0%} to {high:.0%} of the gap"
        )
    elif doubtful := find_doubtful_effects(problem, selection):
        why = f"the interval of {' and of '.join(sorted(doubtful))} does not exclude that it is absent"
    else:
        return None
    ours = describe_fitted_effects(problem, selection, best, labels.joint)
    fewer = tuple(one for one in ours if one.effect not in doubtful)
    return Ambiguity(
        members=(" + ".join(best.effects), " + ".join(one.effect for one in fewer) or "none"),
        effects=(ours, fewer),
        separating_motion={
            "kind": labels.stage.value,
            "joint": labels.joint,
            "words": _recommend_motion(labels.stage),
        },
        why=why,
    )


def _recommend_motion(stage: Stage) -> str:
    return {
        Stage.ACTUATION: "steps of three sizes and ramps of three slopes in both directions, with 3 s rests",
        Stage.SWING: "a longer free swing from a larger angle, until it has died down",
        Stage.FLIGHT: "throws or drops at two clearly different speeds, tracked from before the release",
    }.get(stage, "a longer and more varied record")


def _choose_verdict(selection: Selection, ambiguity: Ambiguity | None) -> VerdictKind:
    if selection.unknown_probability > 0.5:
        return VerdictKind.UNKNOWN
    if not selection.best.effects:
        return VerdictKind.NONE
    return VerdictKind.EXPLAINED if ambiguity is None else VerdictKind.AMBIGUOUS


def _write_sentence(
    verdict: VerdictKind,
    causes: tuple[Cause, ...],
    shrink: Shrink,
    selection: Selection,
    labels: StageLabels,
    limits: tuple[UpperLimit, ...],
    at_bound: Sequence[str],
) -> str:
    where = f"{labels.stage.value} of {labels.joint}" if labels.joint else labels.stage.value
    unexplained = (
        f"{selection.unexplained_ratio:.0%} of the motion is left unexplained on held-out data"
    )
    named = next((cause for cause in causes if cause.effects), None)
    words = "" if named is None else _describe_cause(named)
    match verdict:
        case VerdictKind.NONE:
            could = f" These data would not show {', '.join(n.describe() for n in limits)}."
            return (
                f"The ideal {where} explains the data; no effect is needed ({unexplained}).{could}"
            )
        case VerdictKind.UNKNOWN:
            best = f" by the best known explanation, {words}" if words else ""
            bound = "".join(f" {one} is at the end of its range." for one in at_bound)
            return (
                f"Something acts on the {where} that no effect of the library explains: {unexplained}{best}."
                f"{bound}"
            )
        case _:
            low, high = shrink.ci90
            shows = "shows" if verdict is VerdictKind.EXPLAINED else "may show"
            return (
                f"The {where} {shows} {words}; on held-out data this removes "
                f"{shrink.ratio:.0%} of the gap ({low:.0%} to {high:.0%}), predicted "
                f"{shrink.predicted_ratio or 0.0:.0%}; {unexplained}."
            )


def _describe_cause(cause: Cause) -> str:
    parts: list[str] = []
    for effect in cause.effects:
        numbers = ", ".join(
            f"{name} {p.value:.3g} ({p.ci90[0]:.3g} to {p.ci90[1]:.3g})"
            for name, p in effect.parameters.items()
        )
        parts.append(f"{effect.effect} [{numbers}]")
    return " + ".join(parts)


def bad_data_diagnosis(reason: str, evidence: Mapping[str, object] | None = None) -> Diagnosis:
    """The result for data that cannot be used."""
    return Diagnosis(
        verdict=VerdictKind.BAD_DATA,
        sentence=reason,
        causes=(),
        evidence={**(evidence or {}), "refused": [{"reason": reason}]},
    )


def combine_diagnoses(parts: Mapping[str, Diagnosis]) -> Diagnosis:
    """Combine results of several parts; each part is stored whole in ``evidence["parts"]``.

    Effects carry the part's name as their joint. The joint probability is the geometric mean of the parts',
    so that it does not fall with their number.
    """
    if len(parts) == 1:
        return next(iter(parts.values()))
    usable = {
        name: part for name, part in parts.items() if part.verdict is not VerdictKind.BAD_DATA
    }
    verdict = next(
        kind for kind in VERDICT_PRIORITY if any(p.verdict is kind for p in parts.values())
    )
    tops = {name: _top(part) for name, part in usable.items()}
    effects = [
        effect for name, cause in tops.items() for effect in _assign_joint(cause.effects, name)
    ]
    causes: list[Cause] = []
    if usable:
        causes.append(
            Cause(
                effects=tuple(effects),
                probability=_geometric_mean([cause.probability for cause in tops.values()]),
                name="; ".join(f"{name}: {cause.name}" for name, cause in tops.items()),
            )
        )
        for name in ("none", "unknown"):
            each = [
                next(c.probability for c in p.causes if c.name == name) for p in usable.values()
            ]
            causes.append(Cause(effects=(), probability=_geometric_mean(each), name=name))
    shrinks = [part.shrink for part in usable.values() if part.shrink is not None]
    ratios = [p.gap.trajectory_rms_ratio or 0.0 for p in usable.values()]
    return Diagnosis(
        verdict=verdict,
        sentence=" ".join(f"{name}: {part.sentence}" for name, part in parts.items()),
        gap=Gap(trajectory_rms_ratio=float(np.max(ratios)) if ratios else None),
        stages=tuple(stage for part in usable.values() for stage in part.stages),
        causes=tuple(causes),
        ambiguity=next((p.ambiguity for p in usable.values() if p.ambiguity is not None), None),
        shrink=_mean_shrink(shrinks),
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
    """The cause that the part's verdict reports."""
    if part.verdict is VerdictKind.UNKNOWN:
        return next(cause for cause in part.causes if cause.name == "unknown")
    return part.causes[0]


def _assign_joint(effects: Sequence[FittedEffect], name: str) -> list[FittedEffect]:
    return [effect.model_copy(update={"joint": effect.joint or name}) for effect in effects]


def _geometric_mean(probabilities: Sequence[float]) -> float:
    logs = [math.log(max(p, 1e-12)) for p in probabilities]
    return float(min(math.exp(float(np.mean(logs))), 1.0))


def _mean_shrink(shrinks: Sequence[Shrink]) -> Shrink | None:
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
