"""Model structure selection for one stage: which effects are present, and with which probability.

Structures grow by beam search from the ideal stage and shrink by backward elimination. Each is scored by
its held-out error, with as many independent samples as the residual's correlation allows, a penalty per
parameter (BIC) and a prior per effect.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from scipy.special import softmax

from diagnosis.hypotheses.unknown_check import Left, unknown_probability
from diagnosis.single_stage.fit import QUICK_ITERATIONS, StructureFit, fit_structure
from diagnosis.single_stage.fit_problem import EffectOption, FitProblem
from diagnosis.single_stage.held_out import estimate_held_out_squares
from diagnosis.single_stage.uncertainty import (
    estimate_correlation_samples,
    estimate_standard_errors,
    interval_half_width_factor,
    parameter_intervals,
)
from machine.conventions import Array

BEAM_COUNT: Final = 2
"""Structures kept per level of the beam search."""
MAX_EFFECTS_COUNT: Final = 6
"""Most effects of a structure."""
EFFECT_LOG_PRIOR: Final = math.log(0.25)
"""Log prior per effect; most effects are absent from most machines."""
REFINEMENT_EFFECTS: Final = frozenset(
    {"valve_curve", "acceleration_limit", "speed_by_position", "speed_drift", "drag_crisis"}
)
"""Effects that refine another one; the twin's library does not have them."""
REFINEMENT_LOG_PRIOR: Final = math.log(0.1)
"""Log prior per refinement."""
NONZERO_NULL_EFFECTS: Final = frozenset(
    {"valve_curve", "acceleration_limit", "speed_limit", "drag_crisis"}
)
"""Effects that are absent at a parameter value other than zero."""
INSIGNIFICANT_LOG_PRIOR: Final = math.log(1e-3)
"""Log prior of a structure with an insignificant or redundant effect."""
FLOOR_RATIO: Final = 0.005
"""Residual, as a share of the response, below which differences between structures do not count."""
WHITE_RESIDUAL_RATIO: Final = 1.2
"""Residual, in standard deviations of the noise, below which a fit leaves only noise."""
AT_BOUND_RATIO: Final = 1.3
"""A magnitude below this multiple of its lower bound counts as at the bound."""
RELEVANT_RATIO: Final = 0.002
"""Share of the response that an effect must explain beyond the others to be named."""
ELIMINATION_RATIO: Final = 1.5
"""Backward elimination stops when the best structure exceeds this multiple of the least mean square."""
MIN_GAIN_RATIO: Final = 0.01
"""Smallest relative reduction of the mean square that continues the beam search."""
UNKNOWN_RATIO: Final = 0.1
"""Unexplained share of the response above which no set of effects counts as an explanation."""
AMBIGUOUS_RATIO: Final = 0.25
"""Probability of a rival with other effects, relative to the best, from which the result is ambiguous."""
RIVAL_RATIO: Final = 0.05
"""Probability from which a rival structure widens the intervals of the best."""
MIN_LEAD_SD: Final = 2.0
"""Lead of the best structure on held-out blocks, in standard errors, below which another may be true: the
95 % interval of the difference holds zero."""

Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class ScoredStructure:
    """A fitted structure with its score."""

    fit: StructureFit
    held_out: float
    """Mean square on held-out blocks."""
    squares: Array
    """Sum of squares on each held-out block, (blocks,)."""
    score: float
    """Log posterior up to a constant."""
    probability: float = 0.0

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the effects, sorted."""
        return tuple(sorted({option.effect for option in self.fit.options}))


@dataclass(frozen=True, slots=True)
class Selection:
    """Posterior over structures."""

    ranked: tuple[ScoredStructure, ...]
    """Most probable first; probabilities sum to 1 without "unknown"."""
    base: ScoredStructure
    """The ideal stage, without effects."""
    correlation_samples: float
    signal: float
    """Root mean square of the response, in the unit of the residual."""
    noise: float
    """Standard deviation of the measurement noise, in the unit of the residual."""
    unknown_probability: float

    @property
    def best(self) -> ScoredStructure:
        """The most probable structure."""
        return self.ranked[0]

    @property
    def unexplained_ratio(self) -> float:
        """Share of the response that the best structure leaves on held-out data, beyond the noise."""
        unexplained_power = max(self.best.held_out - self.noise**2, 0.0)
        return math.sqrt(unexplained_power) / max(self.signal, 1e-12)

    @property
    def is_noise_like(self) -> bool:
        """Whether the best structure leaves no more than noise."""
        return math.sqrt(self.best.fit.mean_square) < WHITE_RESIDUAL_RATIO * self.noise

    def lead(self, rival: ScoredStructure) -> float:
        """By how much the best structure is better than another on held-out blocks, in standard errors.

        The standard error is that of the sum of the blocks' paired differences; one block has none: 0.
        """
        difference = rival.squares - self.best.squares
        if len(difference) < 2:
            return 0.0
        spread = math.sqrt(len(difference) * float(np.var(difference, ddof=1)))
        return float(np.sum(difference)) / max(spread, 1e-300)

    def is_possible(self, rival: ScoredStructure) -> bool:
        """Whether a structure may be true in place of the best.

        The held-out blocks have to agree with the likelihood. Where effects leave more than noise, it is too
        sure of itself: errors of the best structure last longer than the residual's correlation. Where only
        noise is left, structures that predict it equally well may differ in their number of parameters alone.
        """
        if rival.probability >= AMBIGUOUS_RATIO * self.best.probability:
            return True
        is_padded = any(
            set(one.effects) < set(rival.effects) and one.score >= rival.score
            for one in self.ranked
        )
        return not is_padded and self.lead(rival) < (0.0 if self.is_noise_like else MIN_LEAD_SD)

    def inclusion(self) -> dict[str, float]:
        """Posterior inclusion probability of each effect."""
        names = sorted({name for scored in self.ranked for name in scored.effects})
        return {
            name: float(sum(s.probability for s in self.ranked if name in s.effects))
            for name in names
        }


def select_structure(
    problem: FitProblem,
    signal: float,
    noise: float,
    progress: Progress | None = None,
    relevant_ratio: float = RELEVANT_RATIO,
) -> Selection:
    """Search the structures of one stage.

    Args:
        problem: data and simulation.
        signal: root mean square of the measured response, in the unit of the residual.
        noise: standard deviation of the measurement noise, in the same unit.
        progress: called with a line of text at each level.
        relevant_ratio: share of the response that an effect must explain beyond the others to be named.
    """
    base = fit_structure(problem, (), {})
    visited: dict[frozenset[str], StructureFit] = {frozenset(): base}
    beam = [base]
    for level in range(1, MAX_EFFECTS_COUNT + 1):
        grown: dict[frozenset[str], StructureFit] = {}
        for parent in beam:
            taken = {option.place for option in parent.options}
            for option in problem.options:
                options = (*parent.options, option)
                key = frozenset(o.key for o in options)
                if option.place in taken or key in visited or key in grown:
                    continue
                grown[key] = fit_structure(problem, options, parent.as_mapping(), QUICK_ITERATIONS)
        if not grown:
            break
        leaders = sorted(grown, key=lambda key: grown[key].mean_square)
        for key in leaders[: 2 * BEAM_COUNT]:
            found = grown[key]
            grown[key] = fit_structure(problem, found.options, found.as_mapping())
        leaders = sorted(grown, key=lambda key: grown[key].mean_square)[:BEAM_COUNT]
        visited |= grown
        best = grown[leaders[0]].mean_square
        before = min(parent.mean_square for parent in beam)
        beam = [grown[key] for key in leaders]
        if progress is not None:
            names = " + ".join(option.effect for option in beam[0].options)
            progress(f"{level} effects: {names}, rms {math.sqrt(best):.4g}")
        if best > before * (1.0 - MIN_GAIN_RATIO) or math.sqrt(best) < 0.3 * FLOOR_RATIO * signal:
            break
    _eliminate_backward(problem, visited)
    _visit_neighbours(problem, visited)
    ranked, base_scored, correlation = _rank_structures(
        problem, visited, signal, relevant_ratio * signal
    )
    # On held-out data: what is fitted but not reproduced there is not explained.
    unexplained = math.sqrt(max(ranked[0].held_out - noise**2, 0.0)) / max(signal, 1e-12)
    unknown = unknown_probability({"response": Left(0.0, unexplained / UNKNOWN_RATIO)})
    return Selection(tuple(ranked), base_scored, correlation, signal, noise, unknown)


def _eliminate_backward(problem: FitProblem, visited: dict[frozenset[str], StructureFit]) -> None:
    """Backward elimination from the full structure; finds effects that only show together."""
    options = tuple(option for option in problem.options if option.key in problem.full_structure)
    if not options:
        return
    best = _fit_visited(problem, visited, visited[frozenset()], options)
    while len(best.options) > 1:
        shorter = [
            _fit_visited(
                problem, visited, best, tuple(o for o in best.options if o.key != option.key)
            )
            for option in best.options
        ]
        best = min(shorter, key=lambda found: found.mean_square)


def _visit_neighbours(problem: FitProblem, visited: dict[frozenset[str], StructureFit]) -> None:
    """Fit structures near the best: with one effect fewer, and with other options of each effect."""
    best = min(visited.values(), key=lambda found: found.mean_square)
    enough = ELIMINATION_RATIO * best.mean_square
    while best.options and best.mean_square <= enough:
        shorter: list[StructureFit] = []
        for option in best.options:
            rest = tuple(o for o in best.options if o.key != option.key)
            shorter.append(_fit_visited(problem, visited, best, rest))
            for variant in problem.options:
                if variant.place == option.place and variant.key != option.key:
                    _fit_visited(problem, visited, best, (*rest, variant))
        best = min(shorter, key=lambda found: found.mean_square)


def _fit_visited(
    problem: FitProblem,
    visited: dict[frozenset[str], StructureFit],
    near: StructureFit,
    options: tuple[EffectOption, ...],
) -> StructureFit:
    """Fit a structure from the parameters that it shares with a similar fit, and store the fit."""
    key = frozenset(option.key for option in options)
    known = visited.get(key)
    names = {p.name for p in problem.nuisance}
    names |= {f"{o.key}.{p.name}" for o in options for p in o.parameters}
    start = {name: value for name, value in near.as_mapping().items() if name in names}
    if known is None:
        visited[key] = fit_structure(problem, options, start)
        return visited[key]
    # A fit that began elsewhere may have ended in another local minimum.
    if len(start) == len(names):
        here_mean_square = float(np.mean(problem.residuals([start])[0] ** 2))
        if here_mean_square < known.mean_square:
            visited[key] = fit_structure(problem, options, start)
            return visited[key]
    if not known.is_converged:
        visited[key] = fit_structure(problem, options, known.as_mapping())
    return visited[key]


def _rank_structures(
    problem: FitProblem,
    visited: Mapping[frozenset[str], StructureFit],
    signal: float,
    relevant: float,
) -> tuple[list[ScoredStructure], ScoredStructure, float]:
    """Scored structures, best first, the ideal stage, and the residual's correlation length in samples."""
    richest = min(visited.values(), key=lambda found: found.mean_square)
    correlation = estimate_correlation_samples(richest.residual, problem.block)
    independent = len(problem.block) / correlation
    # If only noise is left, its likelihood on all data counts; held-out blocks guard against model errors.
    is_noise_like = math.sqrt(richest.mean_square) < WHITE_RESIDUAL_RATIO * problem.noise
    floor = 0.0 if is_noise_like else (FLOOR_RATIO * signal) ** 2
    # Held-out scores need simulations; structures with a far larger residual on all data are skipped.
    limit = 12.0 + 0.5 * independent * math.log(richest.mean_square + floor)
    scored: dict[frozenset[str], ScoredStructure] = {}
    for key in sorted(visited, key=len):
        found = visited[key]
        size = len(found.values) - len(problem.nuisance)
        penalty = 0.5 * size * math.log(max(independent, 2.0))
        prior = sum(
            REFINEMENT_LOG_PRIOR if option.effect in REFINEMENT_EFFECTS else EFFECT_LOG_PRIOR
            for option in found.options
        )
        optimistic = -0.5 * independent * math.log(found.mean_square + floor) - penalty + prior
        is_far = found.mean_square - richest.mean_square >= relevant**2
        if found.options and is_far and optimistic < -limit - 40.0:
            continue
        squares = estimate_held_out_squares(problem, found)
        held_out = max(float(np.sum(squares)) / len(found.residual), found.mean_square)
        scored_mean_square = found.mean_square if is_noise_like else held_out
        score = -0.5 * independent * math.log(scored_mean_square + floor) - penalty + prior
        if {"valve_dead_band_plain", "valve_gain"} <= key or _has_insignificant_effect(
            problem, found, correlation
        ):
            score += INSIGNIFICANT_LOG_PRIOR
        effects = {option.effect for option in found.options}
        for simpler in [item for item in scored.values() if set(item.effects) < effects]:
            more = [option for option in found.options if option.effect not in simpler.effects]
            is_alike = simpler.fit.mean_square - found.mean_square < relevant**2
            # Effects may cancel each other: those without a relevant gain together, or at their smallest
            # magnitudes, are not better than none.
            if is_alike or all(_is_at_lower_bound(found, option) for option in more):
                score = min(score, simpler.score + INSIGNIFICANT_LOG_PRIOR)
        scored[key] = ScoredStructure(found, held_out, squares, score)
    items = sorted(scored.values(), key=lambda item: -item.score)
    probabilities = softmax([item.score for item in items])
    ranked = [
        replace(item, probability=float(p)) for item, p in zip(items, probabilities, strict=True)
    ]
    return _merge_variants(ranked), scored[frozenset()], correlation


def _has_insignificant_effect(problem: FitProblem, found: StructureFit, correlation: float) -> bool:
    """Whether an effect may be absent: zero is within its interval, or it is at a bound where it vanishes."""
    half = estimate_standard_errors(problem, found, correlation) * interval_half_width_factor(
        problem
    )
    is_nonzero = dict(zip(found.names, np.abs(found.values) > half, strict=True))
    values = found.as_mapping()
    for option in found.options:
        names = [f"{option.key}.{p.name}" for p in option.parameters]
        if option.effect not in NONZERO_NULL_EFFECTS:
            is_sure = any(is_nonzero[f"{option.key}.{p.name}"] for p in option.magnitudes)
            if not is_sure or _is_at_lower_bound(found, option):
                return True
            if abs(values[names[0]] - values[names[-1]]) < option.least_difference:
                return True
        if max(abs(values[name] - option.null) for name in names) < option.least:
            return True
        for p, name in zip(option.parameters, names, strict=True):
            if p.is_absent_at_high and values[name] > 0.98 * p.high:
                return True
    return False


def reported_intervals(
    problem: FitProblem, selection: Selection, scored: ScoredStructure
) -> dict[str, tuple[float, float]]:
    """90 % interval of each parameter by name; covers the values of nearly as probable structures."""
    ranges = dict(parameter_intervals(problem, selection.correlation_samples, scored.fit))
    for rival in selection.ranked:
        if rival is scored or rival.probability < RIVAL_RATIO:
            continue
        if "drag_crisis" in set(rival.effects) ^ set(scored.effects):
            continue  # with a drag crisis the coefficient is that at low speed
        if not set(rival.effects) >= set(scored.effects) - REFINEMENT_EFFECTS:
            continue
        for name, (low, high) in parameter_intervals(
            problem, selection.correlation_samples, rival.fit
        ).items():
            if name in ranges:
                ranges[name] = (min(ranges[name][0], low), max(ranges[name][1], high))
    return ranges


def find_doubtful_effects(problem: FitProblem, selection: Selection) -> frozenset[str]:
    """Effects of the best structure that may be absent.

    The reported intervals of all their magnitudes reach zero, or the least size worth naming.
    """
    ranges = reported_intervals(problem, selection, selection.best)
    doubtful: set[str] = set()
    for option in selection.best.fit.options:
        ends = [(p, *ranges[f"{option.key}.{p.name}"]) for p in option.magnitudes]
        if option.effect not in NONZERO_NULL_EFFECTS and all(
            low <= max(option.null, p.low) <= high for p, low, high in ends
        ):
            doubtful.add(option.effect)
    return frozenset(doubtful)


def _is_at_lower_bound(found: StructureFit, option: EffectOption) -> bool:
    """Whether an effect was fitted at its smallest magnitude."""
    first = option.parameters[0]
    size = found.as_mapping()[f"{option.key}.{first.name}"]
    return option.effect not in NONZERO_NULL_EFFECTS and 0.0 < size < AT_BOUND_RATIO * first.low


def _merge_variants(ranked: Sequence[ScoredStructure]) -> list[ScoredStructure]:
    """One entry per set of effects; probabilities of different options of an effect add up."""
    merged: dict[tuple[str, ...], ScoredStructure] = {}
    for item in ranked:
        if item.effects not in merged:
            merged[item.effects] = item
        else:
            first = merged[item.effects]
            both = min(first.probability + item.probability, 1.0)  # rounding may exceed 1
            merged[item.effects] = replace(first, probability=both)
    return sorted(merged.values(), key=lambda item: -item.probability)


def describe_selection(selection: Selection) -> dict[str, Any]:
    """The compared structures, for `Diagnosis.evidence`."""
    return {
        "inclusion_probability": selection.inclusion(),
        "left_ratio": selection.unexplained_ratio,
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
