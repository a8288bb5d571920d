"""Ranked causes with fitted parameters and intervals, and their names for people."""

from collections.abc import Sequence

import numpy as np

from diagnosis.hypotheses.gap_problem import GapProblem
from diagnosis.hypotheses.ranking import Hypothesis, Ranked
from diagnosis.hypotheses.release_jitter import JITTER, PARAMETER
from diagnosis.linearisation.information import NORMAL_90, members_index
from diagnosis.linearisation.parameters import library
from diagnosis.tuning import SIZE_ERROR_RATIO
from diagnosis.verdict import Cause, FittedEffect, FittedParameter
from sim_twin.effects.effect import Effect, acting_effect
from sim_twin.effects.schema import parameter_unit

CAUSE_COUNT = 8
"""Number of causes in a result, beside "none" and "unknown"."""


def words(effect: str, joint: str | None) -> str:
    """Name of an effect for people."""
    name = effect.replace("_", " ")
    return name if joint is None else f"{name} of the {joint}"


def effect_names(effects: Sequence[Effect]) -> str:
    """Names of a set of effects for people; empty for none."""

    def one(effect: Effect) -> str:
        acting = acting_effect(effect)
        return words(acting, effect.joint) + (" drifting" if acting != effect.effect else "")

    return " and ".join(one(effect) for effect in effects)


def causes_of(problem: GapProblem, ranked: Ranked) -> tuple[Cause, ...]:
    """Causes, most probable first, with and without jitter; "none" and "unknown" are always among them."""
    both: list[Cause] = []
    for hypothesis, of_hypothesis in zip(ranked.hypotheses, ranked.probability, strict=True):
        effects = fitted(problem, hypothesis)
        name = effect_names(hypothesis.effects)
        for jitter, share in (
            (True, ranked.jitter_probability),
            (False, 1.0 - ranked.jitter_probability),
        ):
            part = float(of_hypothesis) * share
            kept = (*effects, fitted_jitter(ranked)) if jitter else effects
            parts = [text for text in (name, words(JITTER, None) if jitter else "") if text]
            is_none = not kept
            if part > 1e-3 or is_none:
                text = "none" if is_none else " and ".join(parts)
                both.append(Cause(effects=kept, probability=min(part, 1.0), name=text))
    both.append(Cause(effects=(), probability=ranked.unknown, name="unknown"))
    both.sort(key=lambda cause: -cause.probability)
    needed = [cause for cause in both[CAUSE_COUNT:] if not cause.effects]
    return (*both[:CAUSE_COUNT], *needed)


def fitted_jitter(ranked: Ranked) -> FittedEffect:
    """Additional release jitter with its interval."""
    return FittedEffect(
        effect=JITTER,
        parameters={
            PARAMETER: FittedParameter(
                value=ranked.jitter.size_s, ci90=ranked.jitter.ci90_s, unit="s"
            )
        },
    )


def fitted(problem: GapProblem, hypothesis: Hypothesis) -> tuple[FittedEffect, ...]:
    """Fitted parameters with 90 % intervals, clipped to their bounds.

    The posterior excludes the machine's own scatter; the model error of the effect (`SIZE_ERROR_RATIO`)
    widens it.
    """
    priors = problem.layout.priors
    index = members_index(priors, hypothesis.members)
    variance = np.maximum(np.diag(hypothesis.candidate.covariance), 0.0)
    form = SIZE_ERROR_RATIO * np.abs(hypothesis.candidate.sizes)
    sd = np.sqrt(variance + form**2)
    effects: list[FittedEffect] = []
    at = 0
    for effect, group in zip(hypothesis.effects, hypothesis.members, strict=True):
        parameters: dict[str, FittedParameter] = {}
        for name, place in zip(
            _ordered(effect, problem, group), range(at, at + priors.groups[group].size), strict=True
        ):
            mean, low, high = (
                hypothesis.candidate.sizes[place],
                *_bounds(problem, int(index[place])),
            )
            value = float(np.clip(mean, low, high))
            ends = np.clip([mean - NORMAL_90 * sd[place], mean + NORMAL_90 * sd[place]], low, high)
            parameters[name] = FittedParameter(
                value=value,
                ci90=(float(ends[0]), float(ends[1])),
                unit=parameter_unit(name, effect.joint),
            )
        at += priors.groups[group].size
        effects.append(
            FittedEffect(effect=effect.effect, joint=effect.joint, parameters=parameters)
        )
    return tuple(effects)


def _ordered(effect: Effect, problem: GapProblem, group: int) -> list[str]:
    """Parameter names of an effect in the order of the vector."""
    index = problem.layout.priors.groups[group]
    if int(index[0]) >= problem.layout.parameter_count:
        return list(effect.parameters)
    return [library()[int(i)].name for i in index]


def _bounds(problem: GapProblem, place: int) -> tuple[float, float]:
    return float(problem.layout.priors.low[place]), float(problem.layout.priors.high[place])
