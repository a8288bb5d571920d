"""The effect library as one parameter vector, and the simulations that each parameter moves."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cache

import numpy as np

from diagnosis.healthy.noise import NoiseModel
from diagnosis.linearisation.information import Priors
from diagnosis.linearisation.unmodelled_effects import (
    UNMODELLED,
    unmodelled_groups,
    unmodelled_names,
    unmodelled_slab_sd,
)
from diagnosis.tuning import (
    GROUP_LOG_PRIOR,
    RARE_LOG_PRIOR,
    SCATTER_WIDENING_RATIO,
)
from machine.conventions import ACTIVE_JOINTS, Array
from sim_twin.effects.effect import Effect
from sim_twin.effects.schema import DRIFT
from sim_twin.effects.table import EFFECTS, effects_where


class ReplayKind(StrEnum):
    """Which links of the chain are taken as measured in a simulation, so that one part is under test."""

    ACTUATION = "actuation"
    """No link: joints move as their valves are commanded."""
    SWING = "swing"
    """The driven joints."""
    FLIGHT = "flight"
    """The driven joints, the swing and the moment of opening."""


SET_NUISANCES = (
    "gyro_bias_x_rad_per_s",
    "gyro_bias_y_rad_per_s",
    "gyro_bias_z_rad_per_s",
    "accel_bias_x_m_per_s2",
    "accel_bias_y_m_per_s2",
    "accel_bias_z_m_per_s2",
    "switch_lag_s",
    "grip_radial_m",
    "grip_lateral_m",
    "grip_vertical_m",
)
"""Sensor offsets of a set of throws: behind the parameters in the vector, never a cause."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter of one effect at one joint."""

    effect: str
    joint: str | None
    name: str
    stage: str
    low: float
    high: float
    tolerance: float
    prior_sd: float
    step: float
    views: tuple[ReplayKind, ...]

    @property
    def key(self) -> str:
        """Name as in the intervals of a profile."""
        parts = (self.effect, self.joint, self.name)
        return ".".join(part for part in parts if part is not None)

    @property
    def group(self) -> tuple[str, str | None]:
        """Effect and joint: selected as a whole."""
        return self.effect, self.joint

    def at(self, size: float) -> Effect:
        """The effect with this parameter alone."""
        return Effect(effect=self.effect, joint=self.joint, parameters={self.name: size})

    def clip(self, size: float) -> float:
        """A size within the bounds."""
        return float(min(max(size, self.low), self.high))


@cache
def library() -> tuple[Parameter, ...]:
    """All constant parameters that move a mean, in the order of the chain."""
    return tuple(
        Parameter(
            effect=spec.name,
            joint=joint,
            name=p.name,
            stage=spec.stage,
            low=p.low,
            high=p.high,
            tolerance=p.tolerance,
            prior_sd=p.prior_sd,
            step=p.step,
            views=tuple(ReplayKind(replay) for replay in spec.replays),
        )
        for spec in EFFECTS.values()
        if spec.name != DRIFT and not spec.is_random
        for joint in (spec.joints or (None,))
        for p in spec.parameters
    )


@cache
def index_of() -> Mapping[str, int]:
    """Index of a parameter in the vector, by key."""
    return {p.key: i for i, p in enumerate(library())}


Group = tuple[str, str | None]
"""Effect and joint; ``warm_up_drift:<effect>.<parameter>`` for a drift, ``unmodelled:<name>`` for an
unmodelled effect."""


def joint_index(joint: str | None) -> int:
    """Index of a driven joint."""
    return ACTIVE_JOINTS.index(str(joint))


@dataclass(frozen=True, slots=True)
class ParameterLayout:
    """Parameter vector of the selection: constants, drifts, nuisances of the set, unmodelled effects."""

    groups: tuple[Group, ...]
    """Names of the groups of `priors`."""
    priors: Priors
    parameter_count: int
    drift_count: int

    def is_unmodelled(self, group: int) -> bool:
        """Whether a group is an unmodelled effect rather than an effect of the library."""
        return self.groups[group][0].startswith(UNMODELLED)

    @property
    def size_count(self) -> int:
        """Length of the vector."""
        return int(self.priors.slab_sd.size)


NONSMOOTH_EFFECTS = effects_where(lambda effect: effect.stops_joint)
"""Effects under which a joint stands while its valve is open, breaks loose, and meets its drive again by
forces that the twin lacks."""


def set_names() -> tuple[str, ...]:
    """Names of the set's nuisances and unmodelled effects, in the order of the vector."""
    return (*SET_NUISANCES, *unmodelled_names())


def scatter_names() -> tuple[str, ...]:
    """Names of the deviations of a healthy machine: parameters, nuisances of the set, unmodelled effects."""
    return (*(p.key for p in library()), *set_names())


def layout(model: NoiseModel) -> ParameterLayout:
    """Priors of the whole vector, with the scatter of healthy machines."""
    constants = library()
    groups: dict[Group, list[int]] = {}
    for i, p in enumerate(constants):
        groups.setdefault(p.group, []).append(i)
    logs = [RARE_LOG_PRIOR if e in NONSMOOTH_EFFECTS else GROUP_LOG_PRIOR for e, _ in groups]
    for i, p in enumerate(constants):
        if not EFFECTS[p.effect].can_drift:
            continue
        groups[(f"{DRIFT}:{p.effect}.{p.name}", p.joint)] = [len(constants) + i]
        logs.append(RARE_LOG_PRIOR)
    slab = np.array([p.prior_sd for p in constants])
    low, high = np.array([p.low for p in constants]), np.array([p.high for p in constants])
    first = 2 * len(constants) + len(SET_NUISANCES)
    for group, places in unmodelled_groups().items():
        groups[group] = [first + place for place in places]
        logs.append(RARE_LOG_PRIOR)
    nuisances = np.concatenate([np.ones(len(SET_NUISANCES)), unmodelled_slab_sd()])
    free = np.full(nuisances.size, np.inf)
    # A drift has half the size of its effect, in either direction.
    reach = high - low
    return ParameterLayout(
        groups=tuple(groups),
        priors=Priors(
            scatter=SCATTER_WIDENING_RATIO**2 * _scatter(model),
            slab_sd=np.concatenate([slab, 0.5 * slab, nuisances]),
            low=np.concatenate([low, -reach, -free]),
            high=np.concatenate([high, reach, free]),
            groups=tuple(np.asarray(g, dtype=np.int64) for g in groups.values()),
            log_prior=np.asarray(logs),
        ),
        parameter_count=len(constants),
        drift_count=len(constants),
    )


def beside(plan: ParameterLayout, effects: Sequence[Effect]) -> ParameterLayout:
    """The layout for sizes in addition to constant effects that a twin has: their sums keep the bounds."""
    low, high = plan.priors.low.copy(), plan.priors.high.copy()
    for effect in effects:
        for name, size in effect.parameters.items() if effect.effect != DRIFT else ():
            key = ".".join(part for part in (effect.effect, effect.joint, name) if part is not None)
            if key in index_of():
                place = index_of()[key]
                low[place] = min(max(low[place], low[place] - size), 0.0)
                high[place] = max(min(high[place], high[place] - size), 0.0)
    return replace(plan, priors=plan.priors._replace(low=low, high=high))


def _scatter(model: NoiseModel) -> Array:
    """Covariance of the whole vector; drifts are independent of each other and of the rest."""
    count = len(library())
    shared = model.scatter(scatter_names())
    size = shared.shape[0] + count
    whole = np.zeros((size, size))
    fixed = np.r_[:count, 2 * count : size]
    whole[np.ix_(fixed, fixed)] = shared
    drifts = np.arange(count, 2 * count)
    whole[drifts, drifts] = np.square([model.drift_sd[p.key] for p in library()])
    return whole


def effects_of(found: ParameterLayout, group: int, sizes: Array) -> Effect:
    """A group of the layout as an effect of the library, clipped to its bounds."""
    index = found.priors.groups[group]
    constants = library()
    first = int(index[0])
    if first >= found.parameter_count:
        p = constants[first - found.parameter_count]
        reach = p.high - p.low
        size = float(np.clip(sizes[0], -reach, reach))
        return Effect(effect=DRIFT, joint=p.joint, parameters={f"{p.effect}.{p.name}": size})
    chosen = [constants[int(i)] for i in index]
    return Effect(
        effect=chosen[0].effect,
        joint=chosen[0].joint,
        parameters={p.name: p.clip(float(s)) for p, s in zip(chosen, sizes, strict=True)},
    )
