"""From which size on an effect counts: less of it passes for what healthy machines and other effects do."""

from collections.abc import Sequence

import numpy as np

from diagnosis.causes.evidence import SLAB_SCALES_RATIO, Set, members_index, weigh
from diagnosis.causes.problem import Problem
from diagnosis.causes.selection import NORMAL_90
from diagnosis.causes.trials import SWAYING
from diagnosis.causes.weighing import Trial, by_member
from machine.conventions import ACTIVE_JOINTS, Array, BoolArray

LEAST_OVER_SCATTER_RATIO = 1.5
"""A boom's speed limit scatters by 0.16: it came first, of 0.04 to 0.15, in five of 448 sets, and was in none
of them. An IMU of a healthy stranger that may be off by 11 ms was named for 10 ms: about 15 ms it was 89
ahead."""
LEAST_BESIDE_RATIO = {
    "speed_limit": 1.3,
    "valve_hysteresis": 0.35,
    "backlash": 0.15,
    "stiction": 0.85,
}
"""Of its prior's width, beside another effect: less is that one's own error of form. In 340 sets of two
challenges nine of eleven second effects that were not there were speed limits, eight of 0.06 to 0.20 and one
of 0.33, and in 64 development pairs (seed 20261130) one of 0.26; those that were found and were there beside
another effect were of 0.37 on. A hysteresis of 0.008 was named beside a backlash. Of 400 sets (seeds
1741586721, 1344213217) three with a late IMU had stiction of the dipper beside it, 0.038 to 0.041 rad/s; the
least that was there beside another effect was told as 0.065. Backlashes of 0.2 and 0.3 of their width (4 and
6 mrad of a boom, seed 20261201) were there, 110 and 540 ahead of what they were beside alone."""
FASTER_RATIO = {"valve_lag": 0.2, "valve_dead_time": 0.12}
"""Of a joint's mean lag."""


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
        -FASTER_RATIO.get(effect, 0.0) * mean_lag_s.get(str(joint), 0.0) < size < 0.0
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
        least = np.maximum(least, LEAST_BESIDE_RATIO.get(effect, 0.0) * priors.slab_sd[index])
    return least
