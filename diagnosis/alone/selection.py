"""Chooses the structure of one stage from its data alone: which effects are there, how sure that is.

Sets of effects grow by beam search from the ideal stage; each is scored on held-out pieces of the record,
with as many independent samples as the residual's correlation leaves, and a penalty for every parameter.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from diagnosis.alone.fit import (
    QUICK_ITERATIONS,
    Fit,
    correlation_length,
    fit,
    held_out_mean_square,
    interval_factor,
    standard_errors,
)
from diagnosis.alone.problem import Option, Problem

BEAM_COUNT: Final = 2
MAX_EFFECTS_COUNT: Final = 6
EFFECT_LOG_PRIOR: Final = math.log(0.25)
"""Per effect: most effects are absent from most machines."""
SHAPE_EFFECTS: Final = frozenset({"valve_curve", "acceleration_limit", "drag_crisis"})
"""Refinements outside the twin's library: they shape an effect and are not taken for one of its own."""
SHAPE_LOG_PRIOR: Final = math.log(0.1)
ENDLESS_EFFECTS: Final = frozenset(
    {"valve_curve", "acceleration_limit", "speed_limit", "drag_crisis"}
)
"""Effects that are absent at another value than zero."""
IDLE_LOG_PRIOR: Final = math.log(1e-3)
"""For a set with an effect whose interval holds "nothing", or that is another one in other words."""
FLOOR_RATIO: Final = 0.005
"""Of the response's own size: differences smaller than this decide nothing, whatever the noise."""
CLEAN_NOISES: Final = 1.2
"""A fit that leaves less than as many standard deviations of the noise leaves noise."""
LEAST_RATIO: Final = 1.3
"""Times the smallest magnitude that is looked for: an effect below it is none."""
RELEVANT_RATIO: Final = 0.002
"""Of the response, by eye: an effect that explains less beyond the others is not named."""
PRUNED_RATIO: Final = 1.5
"""Of the least mean square: sets are taken apart, effect by effect, until the best one leaves more."""
GAIN_RATIO: Final = 0.01
"""Smallest drop of the mean square that makes the search go on."""
UNKNOWN_RATIO: Final = 0.35
"""Share of the response that even the best structure leaves: half odds for "unknown"."""
UNKNOWN_WIDTH_RATIO: Final = 0.03

Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Scored:
    """A structure with its score."""

    fit: Fit
    held_out: float
    """Mean square on held-out blocks."""
    score: float
    """Log of its posterior up to a constant."""
    probability: float = 0.0

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the effects, sorted."""
        return tuple(sorted({option.effect for option in self.fit.options}))


@dataclass(frozen=True, slots=True)
class Selection:
    """The posterior over structures."""

    ranked: tuple[Scored, ...]
    """Best first; probabilities sum to 1 without "unknown"."""
    base: Scored
    """The ideal stage: no effect."""
    correlation_samples: float
    signal: float
    """Root mean square of the response."""
    noise: float
    """Standard deviation of its measurement noise."""
    unknown_probability: float

    @property
    def best(self) -> Scored:
        """The most probable structure."""
        return self.ranked[0]

    @property
    def left_ratio(self) -> float:
        """Share of the response that the best structure leaves on held-out data, beyond the noise."""
        left = max(self.best.held_out - self.noise**2, 0.0)
        return math.sqrt(left) / max(self.signal, 1e-12)

    def inclusion(self) -> dict[str, float]:
        """Probability that each effect is part of the truth."""
        names = sorted({name for scored in self.ranked for name in scored.effects})
        return {
            name: float(sum(s.probability for s in self.ranked if name in s.effects))
            for name in names
        }


def select(
    problem: Problem,
    signal: float,
    noise: float,
    progress: Progress | None = None,
    unknown_ratio: float = UNKNOWN_RATIO,
    relevant_ratio: float = RELEVANT_RATIO,
) -> Selection:
    """Search the structures.

    Args:
        problem: data and simulated response.
        signal: root mean square of the measured response, unit of the residual.
        noise: standard deviation of its measurement noise, same unit.
        progress: told what was found at each level.
        unknown_ratio: share of the response left unexplained at which "unknown" has half odds.
        relevant_ratio: share of the response that an effect must explain beyond the others to be named.
    """
    base = fit(problem, (), {})
    visited: dict[frozenset[str], Fit] = {frozenset(): base}
    beam = [base]
    for level in range(1, MAX_EFFECTS_COUNT + 1):
        grown: dict[frozenset[str], Fit] = {}
        for parent in beam:
            taken = {option.effect for option in parent.options}
            for option in problem.options:
                options = (*parent.options, option)
                key = frozenset(o.key for o in options)
                if option.effect in taken or key in visited or key in grown:
                    continue
                grown[key] = fit(problem, options, parent.as_mapping(), QUICK_ITERATIONS)
        if not grown:
            break
        leaders = sorted(grown, key=lambda key: grown[key].mean_square)
        for key in leaders[: 2 * BEAM_COUNT]:
            found = grown[key]
            grown[key] = fit(problem, found.options, found.as_mapping())
        leaders = sorted(grown, key=lambda key: grown[key].mean_square)[:BEAM_COUNT]
        visited |= grown
        best = grown[leaders[0]].mean_square
        before = min(parent.mean_square for parent in beam)
        beam = [grown[key] for key in leaders]
        if progress is not None:
            names = " + ".join(option.effect for option in beam[0].options)
            progress(f"{level} effects: {names}, rms {math.sqrt(best):.4g}")
        if best > before * (1.0 - GAIN_RATIO) or math.sqrt(best) < 0.3 * FLOOR_RATIO * signal:
            break
    _come_down(problem, visited)
    _prune(problem, visited)
    ranked, base_scored, length = _posterior(problem, visited, signal, relevant_ratio * signal)
    # Of held-out data, as the sentence says it: what is fitted away and does not come back is not explained.
    left = math.sqrt(max(ranked[0].held_out - noise**2, 0.0)) / max(signal, 1e-12)
    unknown = 1.0 / (1.0 + math.exp(-(left - unknown_ratio) / UNKNOWN_WIDTH_RATIO))
    return Selection(tuple(ranked), base_scored, length, signal, noise, unknown)


def _come_down(problem: Problem, visited: dict[frozenset[str], Fit]) -> None:
    """Backward elimination from the rich structure: effects that only show together are found there."""
    options = tuple(option for option in problem.options if option.key in problem.rich)
    if not options:
        return
    best = _visit(problem, visited, visited[frozenset()], options)
    while len(best.options) > 1:
        shorter = [
            _visit(problem, visited, best, tuple(o for o in best.options if o.key != option.key))
            for option in best.options
        ]
        best = min(shorter, key=lambda found: found.mean_square)


def _prune(problem: Problem, visited: dict[frozenset[str], Fit]) -> None:
    """Try what the search may have passed by: one effect less, and other variants of each effect."""
    best = min(visited.values(), key=lambda found: found.mean_square)
    enough = PRUNED_RATIO * best.mean_square
    while best.options and best.mean_square <= enough:
        shorter: list[Fit] = []
        for option in best.options:
            rest = tuple(o for o in best.options if o.key != option.key)
            shorter.append(_visit(problem, visited, best, rest))
            for variant in problem.options:
                if variant.effect == option.effect and variant.key != option.key:
                    _visit(problem, visited, best, (*rest, variant))
        best = min(shorter, key=lambda found: found.mean_square)


def _visit(
    problem: Problem,
    visited: dict[frozenset[str], Fit],
    near: Fit,
    options: tuple[Option, ...],
) -> Fit:
    """The fit of a structure, from the parameters that it shares with a fit near it."""
    key = frozenset(option.key for option in options)
    known = visited.get(key)
    names = {p.name for p in problem.nuisance}
    names |= {f"{o.key}.{p.name}" for o in options for p in o.parameters}
    start = {name: value for name, value in near.as_mapping().items() if name in names}
    if known is None:
        visited[key] = fit(problem, options, start)
        return visited[key]
    # The search from nothing may have ended elsewhere: short runs, kinks of delays.
    if len(start) == len(names):
        here = float(np.mean(problem.residuals([start])[0] ** 2))
        if here < known.mean_square:
            visited[key] = fit(problem, options, start)
            return visited[key]
    if not known.is_settled:
        visited[key] = fit(problem, options, known.as_mapping())
    return visited[key]


def _posterior(
    problem: Problem, visited: Mapping[frozenset[str], Fit], signal: float, relevant: float
) -> tuple[list[Scored], Scored, float]:
    """Structures, best first, the ideal stage among them, and the residual's correlation length."""
    richest = min(visited.values(), key=lambda found: found.mean_square)
    length = correlation_length(richest.residual, problem.block)
    independent = len(problem.block) / length
    # Where only noise is left its likelihood on all data counts; held-out pieces are for errors of the model.
    is_clean = math.sqrt(richest.mean_square) < CLEAN_NOISES * problem.noise
    floor = 0.0 if is_clean else (FLOOR_RATIO * signal) ** 2
    # Held-out scores cost simulations; structures far behind in-sample are out of the race anyway.
    limit = 12.0 + 0.5 * independent * math.log(richest.mean_square + floor)
    scored: dict[frozenset[str], Scored] = {}
    for key in sorted(visited, key=len):
        found = visited[key]
        size = len(found.values) - len(problem.nuisance)
        penalty = 0.5 * size * math.log(max(independent, 2.0))
        prior = sum(
            SHAPE_LOG_PRIOR if option.effect in SHAPE_EFFECTS else EFFECT_LOG_PRIOR
            for option in found.options
        )
        optimistic = -0.5 * independent * math.log(found.mean_square + floor) - penalty + prior
        if found.options and optimistic < -limit - 40.0:
            continue
        held_out = max(held_out_mean_square(problem, found), found.mean_square)
        judged = found.mean_square if is_clean else held_out
        score = -0.5 * independent * math.log(judged + floor) - penalty + prior
        if {"valve_dead_band_plain", "valve_gain"} <= key or _has_idle_effect(
            problem, found, length
        ):
            score += IDLE_LOG_PRIOR
        for option in found.options:
            rest = tuple(sorted({o.effect for o in found.options if o.key != option.key}))
            for less in [item for item in scored.values() if item.effects == rest]:
                gain = less.fit.mean_square - found.mean_square
                # At the least size that is looked for it is what the search fell back on.
                if _is_least(found, option) or gain < relevant**2:
                    score = min(score, less.score + IDLE_LOG_PRIOR)
        scored[key] = Scored(found, held_out, score)
    top = max(item.score for item in scored.values())
    weights = {key: math.exp(item.score - top) for key, item in scored.items()}
    total = sum(weights.values())
    ranked = [
        replace(item, probability=weights[key] / total)
        for key, item in sorted(scored.items(), key=lambda pair: -pair[1].score)
    ]
    return _merge(ranked), scored[frozenset()], length


def _has_idle_effect(problem: Problem, found: Fit, length: float) -> bool:
    """Whether an effect may be nothing: zero within its interval, or at an end where it fades out."""
    half = standard_errors(problem, found, length) * interval_factor(problem)
    far = dict(zip(found.names, np.abs(found.values) > half, strict=True))
    values = found.as_mapping()
    for option in found.options:
        names = [f"{option.key}.{p.name}" for p in option.parameters]
        first = option.parameters[0]
        if option.effect not in ENDLESS_EFFECTS:
            asked = names if first.low <= 0.0 else names[:1]
            if not any(far[name] for name in asked) or _is_least(found, option):
                return True
            if max(abs(values[name]) for name in names) < option.least:
                return True
        for p, name in zip(option.parameters, names, strict=True):
            if p.is_void_at_high and values[name] > 0.98 * p.high:
                return True
    return False


def _is_least(found: Fit, option: Option) -> bool:
    """Whether an effect came out at the smallest magnitude that is looked for."""
    first = option.parameters[0]
    size = found.as_mapping()[f"{option.key}.{first.name}"]
    return option.effect not in ENDLESS_EFFECTS and 0.0 < size < LEAST_RATIO * first.low


def _merge(ranked: Sequence[Scored]) -> list[Scored]:
    """One entry a set of effects: variants of an effect (orders of a lag) count together."""
    merged: dict[tuple[str, ...], Scored] = {}
    for item in ranked:
        if item.effects not in merged:
            merged[item.effects] = item
        else:
            first = merged[item.effects]
            merged[item.effects] = Scored(
                first.fit, first.held_out, first.score, first.probability + item.probability
            )
    return sorted(merged.values(), key=lambda item: -item.probability)


def describe(selection: Selection) -> dict[str, Any]:
    """What was compared, for `Diagnosis.evidence`."""
    return {
        "inclusion_probability": selection.inclusion(),
        "left_ratio": selection.left_ratio,
        "correlation_samples": selection.correlation_samples,
        "compared": [
            {
                "effects": list(item.effects),
                "probability": item.probability,
                "held_out_rms": math.sqrt(item.held_out),
            }
            for item in selection.ranked[:12]
        ],
    }
