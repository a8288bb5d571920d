"""Trials settled: at their own estimates, and, in the end, where the machine is beside them."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from diagnosis.causes.evidence import bare, mean_with, members_index, screen, total, weigh
from diagnosis.causes.parameters import index_of
from diagnosis.causes.problem import Problem
from diagnosis.causes.trials import Seed, bending_parameters, try_sets
from diagnosis.causes.weighing import Trial, best_of_each, better, fair_on_all, told
from machine.conventions import Array
from sim_twin.effects.effect import Effect

CLOSE_LOG_ODDS = 300.0
"""Behind the best set, where the machine's own scatter may still matter: on eleven development sets it
moved those within 400 of the best by 41 at most."""
RIVAL_LOG_ODDS = 40.0
"""Behind the best set, where a second look at its machine's scatter may still matter."""
MOST_STEPS_COUNT = 3
"""Simulations of a set that may follow each other in search of its sizes."""


def where_they_are(problem: Problem, trials: Sequence[Trial]) -> list[Trial]:
    """Trials; those close to the best linearised where their machine's scatter is, if that tells them better.

    Scatter bends as effects do: told by slopes at the twin alone a hose of one machine was 64 behind no
    effect, and 22 where the machine was. Slopes of all that swings move sizes, too (a hose of 1.4 1/s2 from
    1.7 to 1.46). So the best set and its rivals, no effect among them, are looked at once more: that was
    worth 17 to a light load and to the drag that was there, and 9 to a dead band beside a spin.
    """
    close = _within(trials, CLOSE_LOG_ODDS)
    found = {t.members: t for t in moved_there(problem, close)}
    rivals = _within(list(found.values()), RIVAL_LOG_ODDS)
    for new in _moved_there(problem, rivals, [t.sizes for t in rivals]):
        found[new.members] = better(found[new.members], new, told)
    return [found.get(t.members, t) for t in trials]


def _within(trials: Sequence[Trial], log_odds: float) -> list[Trial]:
    """Trials whose evidence is so near to that of the best one."""
    fair = fair_on_all(trials)
    return [t for t, own in zip(trials, fair, strict=True) if own > max(fair) - log_odds]


def moved_there(problem: Problem, trials: Sequence[Trial]) -> list[Trial]:
    """Trials, linearised where their machine's scatter is, if that tells them better."""
    there = _moved_there(problem, trials, [t.at for t in trials])
    return [better(old, new, told) for old, new in zip(trials, there, strict=True)]


def _moved_there(problem: Problem, trials: Sequence[Trial], sizes: Sequence[Array]) -> list[Trial]:
    """Sets at some sizes, linearised where their machine's scatter is as these trials tell it."""
    seeds = [(t.members, size) for t, size in zip(trials, sizes, strict=True)]
    return [at_home(t) for t in try_sets(problem, seeds, [_scatter(problem, t) for t in trials])]


def at_home(trial: Trial) -> Trial:
    """A trial in which no effect is not told better by what the twin leaves than by what this machine leaves.

    That residual is another place's than the slopes. A stranger whose drives were off by 0.15 s had no effect
    60 ahead for it, and with that a load that slows its boom by a quarter was none.
    """
    data = total(trial.information)
    carried = screen(data, trial.plain).log_evidence
    if screen(bare(data), trial.plain).log_evidence <= carried:
        return trial
    own = [i._replace(bare_gradient=i.gradient, bare_square=i.square) for i in trial.information]
    return replace(trial, information=own)


def _scatter(problem: Problem, trial: Trial) -> tuple[Effect, ...]:
    """What the machine is off by itself, beside a trial's set, by those effects that bend."""
    data = total(trial.information)
    base = screen(data, trial.plain)
    own = weigh(base, trial.plain, trial.members)
    mean = mean_with(base, data, trial.plain, own).copy()
    mean[members_index(trial.plain, trial.members)] -= own.mean
    middle = problem.model.healthy_mean
    return tuple(
        p.at(p.clip(middle.get(p.key, 0.0) + float(mean[index_of()[p.key]])))
        for p in bending_parameters()
    )


def settle(problem: Problem, seeds: Sequence[Seed], rounds: int) -> list[Trial]:
    """Simulate and estimate again, some rounds; of a set that begins at several sizes the best."""
    return nearer(problem, best_of_each(try_sets(problem, seeds)), rounds - 1)


def refined(problem: Problem, trials: Sequence[Trial]) -> list[Trial]:
    """Simulated once more, at their estimates; the better trial of every set counts."""
    found = try_sets(problem, {t.members: t.sizes for t in trials})
    return [better(new, old, told) for old, new in zip(trials, found, strict=True)]


def nearer(problem: Problem, trials: Sequence[Trial], steps: int = MOST_STEPS_COUNT) -> list[Trial]:
    """Trials; once more, where the estimate is further than its uncertainty from what was simulated.

    As long as that tells them better; slopes of bent effects are no guide, so that those are always tried.
    Behind the best play of a telescope alone a lag beside it came out 3 behind the play alone; with the play
    at 0.034 m (it was 0.035 m) it is 270 ahead.
    """
    found = {t.members: t for t in trials}
    moved = [t for t in trials if t.bent or not _is_near(t)]
    for _ in range(steps):
        tried = refined(problem, moved)
        improved = [t for t, old in zip(tried, moved, strict=True) if t is not old]
        moved = [t for t in improved if t.bent or not _is_near(t)]
        found |= {t.members: t for t in tried}
        if not moved:
            break
    return [found[t.members] for t in trials]


def _is_near(trial: Trial) -> bool:
    variance = np.diag(weigh(trial.base, trial.priors, trial.members).covariance)
    return bool(np.all(np.square(trial.sizes - trial.at) <= variance))
