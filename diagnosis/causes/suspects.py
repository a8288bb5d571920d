"""Suspects: effects that slopes may not show, at which joints they are looked for, and from which sizes."""

from collections.abc import Collection, Sequence

import numpy as np

from diagnosis.causes.evidence import SetEvidence
from diagnosis.causes.problem import Problem
from diagnosis.causes.shapes import UNHEARD
from diagnosis.causes.weighing import Trial
from machine.conventions import ACTIVE_JOINTS, Array
from sim_twin.effects.schema import DRIFT
from sim_twin.effects.table import effects_where

LOUD_SD = 3.0
"""A joint's leftover power that calls for a look at everything that could act on it."""
LOUD_COUNT = 2
NEARLY_AS_LOUD_RATIO = 0.5
"""A joint that a neighbour shakes may be louder than the neighbour (0.6 with a late dipper sensor)."""
PLAIN_LOG_ODDS = 10.0
"""An effect that slopes at "no effect" show so plainly makes its joint suspect, loud or not."""
HIDDEN_FROM_SLOPES = effects_where(lambda effect: effect.growth not in ("linear", "curved"))
"""Effects that are unlike a multiple of their slope at size 0."""
FAR_RATIO = 3.0
"""Suspects start from this multiple of it, too: from 0.05 s the estimate of a latency of 0.135 s moves on by
0.012 s a simulation only, and from 0.068 rad/s that of a breakaway speed of 0.135 rad/s by 0.006 rad/s."""
BETWEEN_RATIO = (1.75,)
STICTION_BETWEEN_RATIO = (1.35, 1.75, 2.15, 2.55)
"""And from these: a dipper that broke loose at 0.11 rad/s was told by neither 0.05 nor 0.15 rad/s, and one of
0.135 rad/s between 0.1 and 0.14 rad/s alone."""


def of_library(problem: Problem) -> list[int]:
    """Groups of effects of the library."""
    return [g for g in range(len(problem.layout.groups)) if not problem.layout.is_unheard(g)]


def suspected(problem: Problem, none: Trial, alone: Sequence[SetEvidence]) -> list[int]:
    """Groups that could act on joints that are loud, or where slopes show an effect plainly.

    What hides from slopes may drift, too, where a drift shows plainly. The pump, a late IMU and a chassis
    that sways are always looked at: no joint is loud for them, and of a stranger's machine the noise of the
    swing is scaled to what they leave.
    """
    groups = problem.layout.groups
    plain = [groups[e.members[0]] for e in alone if e.log_odds > PLAIN_LOG_ODDS]
    shown = [joint for _, joint in plain if joint is not None]
    loud = loud_joints(problem, none, LOUD_COUNT)
    joints = list(dict.fromkeys([*shown[:LOUD_COUNT], *loud]))
    drifts = any(effect.startswith(DRIFT) for effect, _ in plain[:LOUD_COUNT])
    hidden = [
        g
        for g, (effect, joint) in enumerate(groups)
        if (joint is None or joint in joints)
        and (drifts or not effect.startswith(DRIFT))
        and sizes_beyond_slopes(problem, g)
    ]
    return list(dict.fromkeys([*of_joints(problem, joints), *hidden]))


def sizes_beyond_slopes(problem: Problem, group: int) -> list[Array]:
    """A typical size and large ones of an effect, or drift, that is unlike a multiple of its slope at 0."""
    priors = problem.layout.priors
    effect = problem.layout.groups[group][0].removeprefix(f"{DRIFT}:").partition(".")[0]
    if effect not in HIDDEN_FROM_SLOPES:
        return []
    typical = priors.slab_sd[priors.groups[group]]
    # Of two directions, one would hide the other.
    far = [FAR_RATIO * typical * way for way in np.eye(typical.size)]
    between = STICTION_BETWEEN_RATIO if effect == "stiction" else BETWEEN_RATIO
    return [typical, *far, *(ratio * typical for ratio in between)]


def loud_joints(problem: Problem, trial: Trial, count: int) -> list[str]:
    """The driven joints that a trial's set leaves furthest above healthy ones, loudest first."""
    names = [f"actuation.{joint}" for joint in ACTIVE_JOINTS]
    above = _above_healthy(problem, trial, names)
    loud: dict[str, float] = dict(zip(ACTIVE_JOINTS, above, strict=True))
    least = max(LOUD_SD, NEARLY_AS_LOUD_RATIO * max(loud.values(), default=0.0))
    return sorted((j for j in loud if loud[j] >= least), key=lambda j: -loud[j])[:count]


def _above_healthy(problem: Problem, trial: Trial, blocks: Sequence[str]) -> list[float]:
    """Power that a trial's set leaves in blocks, in sd of healthy sets; -inf of what is not there."""
    left, healthy = trial.levels, problem.model.unknown_level
    return [
        (left[name] - healthy[name][0]) / healthy[name][1]
        if name in left and name in healthy
        else -np.inf
        for name in blocks
    ]


def of_joints(problem: Problem, joints: Collection[str]) -> list[int]:
    """Groups of constant effects at some joints."""
    return [
        g
        for g, (effect, joint) in enumerate(problem.layout.groups)
        if joint in joints and not effect.startswith((DRIFT, UNHEARD))
    ]
