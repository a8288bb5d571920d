"""Sets of effects as trials see them, and how their evidence is compared.

A trial is a set about its own sizes; another set may be seen in it. About other sizes slopes and noise are
others, and must be evidence for nobody.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from diagnosis.causes.evidence import (
    Information,
    Priors,
    Screen,
    Set,
    bare,
    members_index,
    screen,
    total,
    weigh,
)
from diagnosis.causes.form_error import ALIKE_ERROR_RATIO, FORM_ERROR_RATIO, RESPONSE_EFFECTS
from diagnosis.causes.parameters import SET_NUISANCES, library
from machine.conventions import Array

PART_LOG_ODDS = 20.0
"""What a part of a set may gain by the slopes about the whole set. They carry nothing back where a joint
stands, or is late by as much as its motion lasts: a dead time beside a dead band of 0.17 (120 ahead of the
dead time alone) and one beside a lag (47 ahead) were lost to the one effect alone. With no gain at all nine
of 83 single effects (seed 1204560035) had a second one; with 15, and with 25, the two pairs are told, and of
the nine those four that shake no other joint are alone again (`Trial.is_shaken` is for the other five)."""


THERE_SD = 2.0
"""Posterior standard deviations of a size: a machine's scatter nearer than that to what was simulated is told
by the slopes there."""
BENT_LEAD_LOG_ODDS = 10.0
"""A bent effect that has less over no effect in its own trial has it by chance: a stranger's slew with a
limit of 0.4 was told by 350 with one of 0.25, 1 ahead of none there, and by 330 with 0.36, 23 ahead."""
LEAST_TOLD_RATIO = 1e-6
"""Of the precision of a size's wide prior: data with less say nothing."""


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """A set of effects, linearised at its sizes."""

    members: Set
    at: Array
    """Sizes of the members' parameters in the simulation: where it is told best, not where it is estimated.

    Slopes by a size at which a joint breaks loose are no guide: with the noise of a version on the way they
    led from 0.05 m/s (499 ahead) in three steps to 0.027 m/s (238), where a telescope broke loose at 0.066;
    and a valve's play from 0.17 (1202 ahead) to 0.07 (404), where it was 0.18."""
    sizes: Array
    """As estimated there."""
    levels: Mapping[str, float]
    """What its set leaves in every block (`leftovers.levels`); not kept of a rough look."""
    information: Sequence[Information]
    """Of every throw, for bootstraps; of a rough look one for all throws together."""
    priors: Priors
    """With the form error of the members."""
    plain: Priors
    """Without it."""
    base: Screen
    """On all throws."""
    bent: Set = ()
    """Members whose slopes at their sizes are no guide to other sizes."""
    is_shaken: bool = False
    """Whether an effect of its set moves other joints, too, in ways that no second effect does."""
    curved: Set = ()
    """Members whose slopes at their sizes guide to sizes nearby, and not back to none."""


def formed(priors: Priors, data: Information, members: Set, sizes: Array) -> Priors:
    """Spikes under a hypothesis: what other parameters can make of its effects' form error.

    A real effect is never quite the library's, in the same way in every throw. Where another parameter's
    slopes lie along the effects' signal, a share of that signal may look like it. Shapes are made of
    what forms are off by, and take more of it than effects with a name; dead times and lags take more of each
    other.

    Args:
        priors: without form error.
        data: on all throws.
        members: the hypothesis.
        sizes: of its parameters, group after group.
    """
    index = members_index(priors, members)
    own = np.diag(data.precision)
    # What the data say nothing about looks like nothing; its products are rounding errors.
    is_told = own * np.square(priors.slab_sd) > LEAST_TOLD_RATIO
    own = np.where(is_told, own, np.inf)
    kinds = np.array(_kinds(own.size))
    variance = np.zeros(own.size)
    # Effects of one kind are off as a whole: alike ones may be large against each other.
    for kind in np.unique(kinds[index]):
        chosen = kinds[index] == kind
        stage = "swing" if kind == "other" else "actuation"
        along = data.precision[:, index[chosen]] @ sizes[chosen] / own
        is_alike = (kinds == "shape") | ((kinds == kind) & (kind == "response"))
        ratio = np.where(is_alike, FORM_ERROR_RATIO[stage], ALIKE_ERROR_RATIO[stage])
        variance += np.square(ratio * along)
    variance[index] = 0.0
    return priors._replace(scatter=priors.scatter + np.diag(variance))


@cache
def _kinds(count: int) -> tuple[str, ...]:
    """Of so many parameters of the layout."""
    return tuple(_kind(place) for place in range(count))


def _kind(place: int) -> str:
    """What a parameter is, as far as its form goes."""
    if place >= 2 * len(library()) + len(SET_NUISANCES):
        return "shape"
    parameter = library()[place % len(library())]
    if parameter.effect in RESPONSE_EFFECTS:
        return "response"
    return "drive" if parameter.stage == "actuation" else "other"


def is_ahead(trial: Trial) -> bool:
    """Whether a trial's set beats no effect in the trial itself."""
    return lead(trial) > 0.0


def lead(trial: Trial) -> float:
    """Log odds of a trial's set over no effect in its own noise."""
    own, without = screens(trial, total(trial.information))
    return evidence_in(own, trial.priors, trial.members) - without.log_evidence


def best_of_each(trials: Sequence[Trial]) -> list[Trial]:
    """Of trials of the same set from different sizes the best."""
    found: dict[Set, Trial] = {}
    for trial in trials:
        before = found.get(trial.members)
        found[trial.members] = trial if before is None else better(before, trial, own_evidence)
    return list(found.values())


def better(one: Trial, other: Trial, evidence: Callable[[Trial], float]) -> Trial:
    """Of trials of the same set the one that tells it better; of equals the first.

    Bent effects first have to beat no effect in the trial itself (`BENT_LEAD_LOG_ODDS`): about the size of
    half a slew's speed limit evidence was 20 more than about the whole one, for the slopes there explained
    the rest of it by where the slew stood, with the limit or without.
    """
    ahead = [not t.bent or lead(t) > BENT_LEAD_LOG_ODDS for t in (one, other)]
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


Seen = tuple[int, Set]
"""The place of a trial, and a set as that trial sees it."""


def fair_evidence(
    trials: Sequence[Trial],
    seen: Sequence[Seen],
    data: Sequence[Information],
    *,
    is_last: bool = False,
) -> Array:
    """Log evidence (sets,) of sets, each in its trial, so that noise and slopes are evidence for nobody.

    About another size slopes and noise are others. A set counts if it beats "no effect" in its own trial;
    others lie as far below "no effect" as they do there. "No effect", and every other part of the set that
    leads, may also have the leader's trial; a part by `PART_LOG_ODDS` at most, unless effects shake others.
    "No effect" has it without its effects, and that of every part with a machine that is there by itself
    (`_as_scatter`).

    Args:
        trials: simulated sets.
        seen: the sets, "no effect" among them; more than one may be of a trial.
        data: what all throws, or a bootstrap of them, say in each of the trials.
        is_last: no set will be simulated again: none counts for sizes that it promises elsewhere.
    """
    bases = [screens(t, d) for t, d in zip(trials, data, strict=True)]
    own = np.array([evidence_in(bases[i][0], trials[i].priors, m) for i, m in seen])
    if is_last:
        own -= np.array([promised(trials[i]) for i, _ in seen])
    without = np.array([bases[i][1].log_evidence for i, _ in seen])
    is_none = np.array([not m for _, m in seen])
    counts = (own > without) & ~is_none
    none = float(own[is_none].max()) if is_none.any() else float(without.min())
    if not counts.any():
        return np.where(is_none, none, none + own - without)
    leader = int(np.argmax(np.where(counts, own, -np.inf)))
    place, members = seen[leader]
    inside = [i for i, t in enumerate(trials) if t.members and set(t.members) <= set(members)]
    scatter = max((_as_scatter(trials[i], data[i]) for i in inside), default=-np.inf)
    none = max(none, float(without[leader]), scatter)
    found = np.where(is_none, none, np.where(counts, own, none + own - without))
    for k, (_, part) in enumerate(seen):
        # Slopes do not carry a bent or curved effect back to where it is not.
        if part and set(part) < set(members) and not _carried_badly(trials[place]) - set(part):
            base = _base_of_part(trials[place], data[place], part)
            there = evidence_in(base, trials[place].plain, part)
            most = np.inf if trials[place].is_shaken else found[k] + PART_LOG_ODDS
            found[k] = max(found[k], min(there, most))
    return found


def _as_scatter(trial: Trial, data: Information) -> float:
    """Log evidence of no effect where a trial's set was simulated, if the machine may be there by itself.

    A healthy machine that looked like 8.5 % less inertia, two standard deviations of healthy ones, was told
    by 33 better with that inertia simulated than by slopes about none. That is no evidence for an effect:
    told by the slopes there its scatter is as good. Slopes of bent and curved effects tell nothing of a
    machine without them.
    """
    if _carried_badly(trial) or trial.is_shaken:
        return -np.inf
    sd = np.sqrt(np.diag(weigh(trial.base, trial.priors, trial.members).covariance))
    away = trial.base.mean[members_index(trial.plain, trial.members)] - trial.at
    is_there = bool(np.all(np.abs(away) <= THERE_SD * sd))
    return screen(data, trial.plain).log_evidence if is_there else -np.inf


def _carried_badly(trial: Trial) -> set[int]:
    """Members that slopes about a trial do not carry back to none.

    Lift grows little beyond 6 rad/s: about a spin of 20 rad/s, of 17, a dipper's dead band alone was told 20
    better than about itself, for slopes there make the spin cost nothing.
    """
    return {*trial.bent, *trial.curved}


def fair_on_all(trials: Sequence[Trial]) -> list[float]:
    """Fair evidence of every trial's own set, on all throws."""
    seen = [(i, t.members) for i, t in enumerate(trials)]
    return fair_evidence(trials, seen, [total(t.information) for t in trials]).tolist()


def screens(trial: Trial, data: Information) -> tuple[Screen, Screen]:
    """A trial's screens of these data (all throws or a bootstrap): with its effects, and without them.

    Where its effects are not, neither is their form error.
    """
    return screen(data, trial.priors), screen(bare(data), trial.plain)


def _base_of_part(trial: Trial, data: Information, part: Set) -> Screen:
    """A trial's screen for a part of its set: nothing may look like effects that the part does not have."""
    sizes = by_member(trial.plain, trial.members, trial.at)
    own = {m: size for m, size in sizes.items() if m in part}
    if not own:
        return screen(bare(data), trial.plain)
    kept = np.concatenate(list(own.values()))
    return screen(data, formed(trial.plain, total(trial.information), tuple(own), kept))


def evidence_in(base: Screen, priors: Priors, members: Set) -> float:
    """Log evidence of a set in a trial's screen."""
    return base.log_evidence + weigh(base, priors, members).log_odds


def own_evidence(trial: Trial) -> float:
    """Log evidence of a trial's set in the trial itself."""
    return evidence_in(trial.base, trial.priors, trial.members)


def promised(trial: Trial) -> float:
    """How much of a trial's own evidence lies in sizes beside those that were simulated.

    Slopes promise it, and nobody has seen it. Throws with 2.3 times the drag were simulated with a load that
    was lighter by 0.5 of 0.6 kg; there, where drag is over a sixth of the mass, slopes promised that 0.1 kg
    were as good. Of bent effects slopes are no guide anyway: those stay as they are.
    """
    if not trial.members:
        return 0.0
    index = members_index(trial.plain, trial.members)
    estimate = np.clip(trial.sizes, trial.plain.low[index], trial.plain.high[index])
    parts = by_member(trial.plain, trial.members, estimate - trial.at)
    away = np.concatenate([part * (m not in trial.bent) for m, part in parts.items()])
    covariance = weigh(trial.base, trial.priors, trial.members).covariance
    return 0.5 * float(away @ np.linalg.solve(covariance, away))


def told(trial: Trial) -> float:
    """A trial's own evidence at the sizes that were simulated."""
    return own_evidence(trial) - promised(trial)
