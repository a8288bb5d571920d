"""From which size on an effect counts: less of it passes for what healthy machines and other effects do."""

from collections.abc import Sequence

import numpy as np

from diagnosis.causes.evidence import SLAB_SCALES_RATIO, Set, members_index, weigh
from diagnosis.causes.problem import Problem
from diagnosis.causes.selection import NORMAL_90
from diagnosis.causes.trials import SWAYING
from diagnosis.causes.weighing import Trial, by_member
from machine.conventions import ACTIVE_JOINTS, Array, BoolArray
from sim_twin.effects.table import EFFECTS

LEAST_OVER_SCATTER_RATIO = 1.5
"""A boom's speed limit scatters by 0.16: it came first, of 0.04 to 0.15, in five of 448 sets, and was in none
of them. An IMU of a healthy stranger that may be off by 11 ms was named for 10 ms: about 15 ms it was 89
ahead."""


def of_some_size(problem: Problem, trials: Sequence[Trial]) -> list[Trial]:
    """Trials all of whose effects are larger than the narrowest prior that they could have.

    A sensor of the slew that is 3 ms late explained how the gripper shook when its gears met, and was named.
    """
    return [
        t
        for t in trials
        if is_some(problem, t.members, t.sizes).all()
        and not _is_hardly_faster(problem, t)
        and not _hardly_sways(problem, t)
    ]


def _hardly_sways(problem: Problem, trial: Trial) -> bool:
    """Whether a trial's chassis may as well stand firm by its own estimate.

    About a sway of another frequency slopes and scatter are others: a twin's own throws were told 3 better
    by a chassis of 0.0009 +- 0.0011 rad.
    """
    swaying = [m for m in trial.members if problem.layout.groups[m][0] in SWAYING]
    if not swaying:
        return False
    covariance = weigh(trial.base, trial.priors, trial.members).covariance
    least = by_member(trial.plain, trial.members, NORMAL_90 * np.sqrt(np.diag(covariance)))
    sizes = by_member(trial.plain, trial.members, trial.sizes)
    return any(bool((sizes[m] < least[m]).all()) for m in swaying)


def _is_hardly_faster(problem: Problem, trial: Trial) -> bool:
    """Whether a joint of a trial answers sooner than its twin, but by less than a response is told to.

    That is how far the measured response of a healthy joint may be from its own, and no slope at the twin
    shows it, where a lag begins as one of the spool: two of 28 healthy machines had a slew of 0.34 s that was
    0.045 s faster, 9 and 13 ahead of no effect; and in three of 16 sets of one (seed 20261126) a slew without
    any effect had a dead time shorter by 0.025 to 0.036 s, up to 36 ahead.
    """
    response = zip(
        problem.profile.damping_ratio, problem.profile.natural_frequency_rad_per_s, strict=True
    )
    mean_lag_s = {j: 2.0 * z / w for j, (z, w) in zip(ACTIVE_JOINTS, response, strict=True)}
    sizes = by_member(trial.plain, trial.members, trial.sizes)
    groups = [(*problem.layout.groups[m], float(size[0])) for m, size in sizes.items()]
    return any(
        -_shortening_ratio(effect) * mean_lag_s.get(str(joint), 0.0) < size < 0.0
        for effect, joint, size in groups
    )


def is_some(problem: Problem, members: Set, sizes: Array) -> BoolArray:
    """Of which groups of a set any size counts, as far as it is possible at all."""
    priors = problem.layout.priors
    index = members_index(priors, members)
    size = np.abs(np.clip(sizes, priors.low[index], priors.high[index]))
    parts = by_member(priors, members, size).items()
    return np.array(
        [(part > _least_sizes(problem, m, len(members))).any() for m, part in parts],
        dtype=np.bool_,
    )


def _least_sizes(problem: Problem, group: int, member_count: int) -> Array:
    """From which sizes on an effect counts, one of so many of a set.

    What lies within the scatter needs no cause, whatever simulations at other sizes make of it. A limit that
    cuts off little beside another effect is that effect's own error at full speed.
    """
    priors, effect = problem.layout.priors, problem.layout.groups[group][0]
    index = priors.groups[group]
    scatter_sd = np.sqrt(np.diag(priors.scatter)[index])
    least = np.maximum(
        SLAB_SCALES_RATIO[-1] * priors.slab_sd[index], LEAST_OVER_SCATTER_RATIO * scatter_sd
    )
    if member_count > 1:
        least = np.maximum(least, _beside_ratio(effect) * priors.slab_sd[index])
    return least


def _beside_ratio(effect: str) -> float:
    """`least_beside_ratio` of a group's effect; 0 for drifts and shapes."""
    return EFFECTS[effect].least_beside_ratio if effect in EFFECTS else 0.0


def _shortening_ratio(effect: str) -> float:
    """`least_shortening_ratio` of a group's effect; 0 for drifts and shapes."""
    return EFFECTS[effect].least_shortening_ratio if effect in EFFECTS else 0.0
