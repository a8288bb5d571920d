"""Candidates, and the comparison of their evidence.

A candidate is a set of effects linearised about its own sizes; other sets may be evaluated in it. Slopes
and noise differ between candidates, and this difference must not count as evidence.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from diagnosis.inference.evidence import (
    Information,
    Priors,
    Screen,
    Set,
    members_index,
    screen,
    total,
    weigh,
    without_effect,
)
from diagnosis.linearisation.model_error import RESPONSE_EFFECTS
from diagnosis.linearisation.parameters import SET_NUISANCES, library
from diagnosis.tuning import (
    JUMP_LOG_ODDS,
    LEAST_INFORMATION_RATIO,
    MODEL_ERROR_RATIO,
    NEARBY_SD,
    PART_LOG_ODDS,
    SHARED_ERROR_RATIO,
)
from machine.conventions import Array


@dataclass(frozen=True, slots=True, eq=False)
class CandidateSet:
    """A set of effects, linearised at its sizes."""

    members: Set
    at: Array
    """Simulated sizes of the members' parameters: those with the highest evidence. Where an effect has
    jumps, the estimates are no guide to better sizes."""
    sizes: Array
    """Estimated sizes in this linearisation."""
    levels: Mapping[str, float]
    """Log residual power of every block (`residual_power.levels`); empty for a preview."""
    information: Sequence[Information]
    """Of every throw, for bootstraps; of a preview one for all throws together."""
    priors: Priors
    """With the model error of the members."""
    plain: Priors
    """Without model error."""
    base: Screen
    """Screen on all throws."""
    jumping: Set = ()
    """Members with jumps: slopes at their sizes are no guide to other sizes."""
    excites_others: bool = False
    """Whether an effect of the set moves other joints in ways that no second effect does."""
    curved: Set = ()
    """Members whose slopes hold for sizes nearby, and not for zero."""


def with_model_error(priors: Priors, data: Information, members: Set, sizes: Array) -> Priors:
    """Priors with the model error of a hypothesis' effects.

    An effect of the library differs from the real one in the same way in every throw. Where another
    parameter's slopes lie along the effects' signal, a share of that signal may look like it. Unmodelled
    effects take a larger share than named ones; dead times and lags take a larger share of each other.

    Args:
        priors: without model error.
        data: of all throws.
        members: the hypothesis.
        sizes: of its parameters, group after group.
    """
    index = members_index(priors, members)
    own = np.diag(data.precision)
    # Products of parameters without information are rounding errors.
    is_informed = own * np.square(priors.slab_sd) > LEAST_INFORMATION_RATIO
    own = np.where(is_informed, own, np.inf)
    kinds = np.array(_kinds(own.size))
    variance = np.zeros(own.size)
    # Effects of one kind share their model error: similar ones may be large with opposite signs.
    for kind in np.unique(kinds[index]):
        chosen = kinds[index] == kind
        stage = "swing" if kind == "other" else "actuation"
        along = data.precision[:, index[chosen]] @ sizes[chosen] / own
        is_alike = (kinds == "shape") | ((kinds == kind) & (kind == "response"))
        ratio = np.where(is_alike, MODEL_ERROR_RATIO[stage], SHARED_ERROR_RATIO[stage])
        variance += np.square(ratio * along)
    variance[index] = 0.0
    return priors._replace(scatter=priors.scatter + np.diag(variance))


@cache
def _kinds(count: int) -> tuple[str, ...]:
    """Kinds of this number of parameters of the layout."""
    return tuple(_kind(place) for place in range(count))


def _kind(place: int) -> str:
    """Kind of a parameter with respect to model error."""
    if place >= 2 * len(library()) + len(SET_NUISANCES):
        return "shape"
    parameter = library()[place % len(library())]
    if parameter.effect in RESPONSE_EFFECTS:
        return "response"
    return "drive" if parameter.stage == "actuation" else "other"


def beats_none(candidate: CandidateSet) -> bool:
    """Whether a candidate's set has positive log odds over no effect in its own linearisation."""
    return log_odds_over_none(candidate) > 0.0


def log_odds_over_none(candidate: CandidateSet) -> float:
    """Log odds of a candidate's set over no effect in its own noise."""
    own, without = screens(candidate, total(candidate.information))
    return evidence_in(own, candidate.priors, candidate.members) - without.log_evidence


def best_of_each(candidates: Sequence[CandidateSet]) -> list[CandidateSet]:
    """The best of the candidates of each set."""
    found: dict[Set, CandidateSet] = {}
    for candidate in candidates:
        before = found.get(candidate.members)
        found[candidate.members] = (
            candidate if before is None else better(before, candidate, local_evidence)
        )
    return list(found.values())


def better(
    one: CandidateSet, other: CandidateSet, evidence: Callable[[CandidateSet], float]
) -> CandidateSet:
    """The candidate of the same set with the higher evidence; the first if equal.

    Candidates with jumps must first beat no effect in their own linearisation (`JUMP_LOG_ODDS`):
    slopes at a wrong size can explain the rest of an effect with or without it.
    """
    ahead = [not t.jumping or log_odds_over_none(t) > JUMP_LOG_ODDS for t in (one, other)]
    if ahead[0] != ahead[1]:
        return one if ahead[0] else other
    return other if evidence(other) > evidence(one) else one


def by_member(priors: Priors, members: Set, sizes: Array) -> dict[int, Array]:
    """Sizes of every group of a set."""
    found: dict[int, Array] = {}
    at = 0
    for member in members:
        width = priors.groups[member].size
        found[member] = sizes[at : at + width]
        at += width
    return found


EvaluatedSet = tuple[int, Set]
"""Index of a candidate, and a set evaluated in its linearisation."""


def comparable_evidence(
    candidates: Sequence[CandidateSet],
    evaluated: Sequence[EvaluatedSet],
    data: Sequence[Information],
    *,
    is_last: bool = False,
) -> Array:
    """Comparable log evidence (sets,) of sets, each in its candidate.

    Slopes and noise differ between candidates. A set counts if it beats "no effect" in its own candidate;
    others lie as far below "no effect" as they do there. "No effect", and every other subset of the leading
    set, may also be evaluated in the leader's linearisation; a subset gains at most `PART_LOG_ODDS`, unless
    effects excite other joints. "No effect" is evaluated there without its effects, and in every subset as
    scatter of a healthy machine (`_as_scatter`).

    Args:
        candidates: evaluated candidates.
        evaluated: the sets, "no effect" among them; several may share a candidate.
        data: information of all throws, or a bootstrap of them, in each candidate.
        is_last: no set will be evaluated again: evidence at sizes that were not simulated does not count.
    """
    bases = [screens(t, d) for t, d in zip(candidates, data, strict=True)]
    own = np.array([evidence_in(bases[i][0], candidates[i].priors, m) for i, m in evaluated])
    if is_last:
        own -= np.array([extrapolated_gain(candidates[i]) for i, _ in evaluated])
    without = np.array([bases[i][1].log_evidence for i, _ in evaluated])
    is_none = np.array([not m for _, m in evaluated])
    counts = (own > without) & ~is_none
    none = float(own[is_none].max()) if is_none.any() else float(without.min())
    if not counts.any():
        return np.where(is_none, none, none + own - without)
    leader = int(np.argmax(np.where(counts, own, -np.inf)))
    place, members = evaluated[leader]
    inside = [i for i, t in enumerate(candidates) if t.members and set(t.members) <= set(members)]
    scatter = max((_as_scatter(candidates[i], data[i]) for i in inside), default=-np.inf)
    none = max(none, float(without[leader]), scatter)
    found = np.where(is_none, none, np.where(counts, own, none + own - without))
    for k, (_, part) in enumerate(evaluated):
        # Slopes of effects with jumps or curves do not extrapolate to zero.
        if (
            part
            and set(part) < set(members)
            and not _not_extrapolated(candidates[place]) - set(part)
        ):
            base = _base_of_part(candidates[place], data[place], part)
            there = evidence_in(base, candidates[place].plain, part)
            most = np.inf if candidates[place].excites_others else found[k] + PART_LOG_ODDS
            found[k] = max(found[k], min(there, most))
    return found


def _as_scatter(candidate: CandidateSet, data: Information) -> float:
    """Log evidence of no effect in a candidate's linearisation, if a healthy machine may deviate by as much.

    Simulating a size raises the evidence for a healthy machine's scatter as well as for an effect. Slopes
    of effects with jumps or curves say nothing about a machine without them.
    """
    if _not_extrapolated(candidate) or candidate.excites_others:
        return -np.inf
    sd = np.sqrt(np.diag(weigh(candidate.base, candidate.priors, candidate.members).covariance))
    away = candidate.base.mean[members_index(candidate.plain, candidate.members)] - candidate.at
    is_there = bool(np.all(np.abs(away) <= NEARBY_SD * sd))
    return screen(data, candidate.plain).log_evidence if is_there else -np.inf


def _not_extrapolated(candidate: CandidateSet) -> set[int]:
    """Members whose slopes do not extrapolate to zero."""
    return {*candidate.jumping, *candidate.curved}


def comparable_on_all(candidates: Sequence[CandidateSet]) -> list[float]:
    """Comparable evidence of every candidate's own set, on all throws."""
    evaluated = [(i, t.members) for i, t in enumerate(candidates)]
    return comparable_evidence(
        candidates, evaluated, [total(t.information) for t in candidates]
    ).tolist()


def screens(candidate: CandidateSet, data: Information) -> tuple[Screen, Screen]:
    """Screens of these data in a candidate: with its effects, and without them and their model error."""
    return screen(data, candidate.priors), screen(without_effect(data), candidate.plain)


def _base_of_part(candidate: CandidateSet, data: Information, part: Set) -> Screen:
    """A candidate's screen for a subset: without the model error of effects that the subset lacks."""
    sizes = by_member(candidate.plain, candidate.members, candidate.at)
    own = {m: size for m, size in sizes.items() if m in part}
    if not own:
        return screen(without_effect(data), candidate.plain)
    kept = np.concatenate(list(own.values()))
    return screen(
        data, with_model_error(candidate.plain, total(candidate.information), tuple(own), kept)
    )


def evidence_in(base: Screen, priors: Priors, members: Set) -> float:
    """Log evidence of a set in a screen."""
    return base.log_evidence + weigh(base, priors, members).log_odds


def local_evidence(candidate: CandidateSet) -> float:
    """Log evidence of a candidate's set in its own linearisation."""
    return evidence_in(candidate.base, candidate.priors, candidate.members)


def extrapolated_gain(candidate: CandidateSet) -> float:
    """Part of a candidate's evidence that lies in sizes other than those simulated.

    It is extrapolated along slopes. Effects with jumps are excluded: their estimates are not used.
    """
    if not candidate.members:
        return 0.0
    index = members_index(candidate.plain, candidate.members)
    estimate = np.clip(candidate.sizes, candidate.plain.low[index], candidate.plain.high[index])
    parts = by_member(candidate.plain, candidate.members, estimate - candidate.at)
    away = np.concatenate([part * (m not in candidate.jumping) for m, part in parts.items()])
    covariance = weigh(candidate.base, candidate.priors, candidate.members).covariance
    return 0.5 * float(away @ np.linalg.solve(covariance, away))


def evidence_at_simulated(candidate: CandidateSet) -> float:
    """A candidate's evidence at the simulated sizes."""
    return local_evidence(candidate) - extrapolated_gain(candidate)
