"""What the twin misses on one machine in every throw, learned on its reference throws.

The filters of the type (healthy/filters.py) hold what all its machines have in common. One machine has more:
its pump, its loads and its oil make a joint slower or later in a way that repeats whenever it moves alike. A
filter of the same inputs holds that. What such filters leave is measured on throws that they were not
learned from.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from diagnosis.healthy.filters import HealthyModel, correction, inputs, learn, sum_of
from diagnosis.linearisation.sensitivities import LinearThrow
from diagnosis.loading.prepared import PreparedThrow
from machine.conventions import ACTIVE_JOINTS, Array

FOLD_COUNT = 4
"""Parts of the reference throws; those of a part are spread over all days."""
RIDGE = 100.0
"""Prior precision of a weight (`filters.RIDGE`). Throws of another day than those learned from are predicted
equally well from 30 to 300."""


class MachineFilters(NamedTuple):
    """Filters of a machine, of its type's misfit and its own together."""

    all: HealthyModel
    """Learned from all throws."""
    without: tuple[HealthyModel, ...]
    """Learned without the throws of each part."""

    def of_others(self, throw: int) -> HealthyModel:
        """Filters learned without a throw's part."""
        return self.without[throw % FOLD_COUNT]


def machine_filters(
    prepared: Sequence[PreparedThrow], linear: Sequence[LinearThrow], of_type: HealthyModel
) -> MachineFilters:
    """Filters of a machine from throws while it was healthy.

    Args:
        prepared: the throws.
        linear: their residual under the filters of the type.
        of_type: filters of the type.
    """
    values = [
        [_inputs(p, one, joint) for p, one in zip(prepared, linear, strict=True)]
        for joint in range(len(ACTIVE_JOINTS))
    ]
    residuals = [
        [one.residual[_rows(p, joint)] for p, one in zip(prepared, linear, strict=True)]
        for joint in range(len(ACTIVE_JOINTS))
    ]

    def without(part: int | None) -> HealthyModel:
        chosen = [i for i in range(len(prepared)) if i % FOLD_COUNT != part]
        own = tuple(
            learn([x[i] for i in chosen], [y[i] for i in chosen], RIDGE)
            for x, y in zip(values, residuals, strict=True)
        )
        return sum_of(of_type, HealthyModel(note="reference throws", joints=own))

    return MachineFilters(without(None), tuple(without(part) for part in range(FOLD_COUNT)))


def as_unseen(
    prepared: Sequence[PreparedThrow],
    linear: Sequence[LinearThrow],
    under: HealthyModel,
    filters: MachineFilters,
) -> list[LinearThrow]:
    """Throws with their residual under filters that were learned without them.

    Args:
        prepared: the throws.
        linear: them, linearised.
        under: filters with which they were linearised.
        filters: of the machine.
    """
    found: list[LinearThrow] = []
    for i, (p, one) in enumerate(zip(prepared, linear, strict=True)):
        residual = one.residual.copy()
        for joint in range(len(ACTIVE_JOINTS)):
            track = one.predicted_velocity[:, joint]
            seen = correction(under, p.motion, joint, track)
            unseen = correction(filters.of_others(i), p.motion, joint, track)
            residual[_rows(p, joint)] += p.joint_pair @ _at_sensors(p, seen - unseen)
        found.append(replace(one, residual=residual))
    return found


def filters_help(
    prepared: Sequence[PreparedThrow], linear: Sequence[LinearThrow], filters: HealthyModel
) -> bool:
    """Whether the filters of the type reduce the residual of this machine, averaged over its joints.

    Args:
        prepared: the throws.
        linear: at "no effect", with the filters.
        filters: of the type.
    """
    gains: list[float] = []
    for joint in range(len(ACTIVE_JOINTS)):
        before, after = 0.0, 0.0
        for p, one in zip(prepared, linear, strict=True):
            track = correction(filters, p.motion, joint, one.predicted_velocity[:, joint])
            moved = p.joint_pair @ _at_sensors(p, track)
            rest = one.residual[_rows(p, joint)]
            after += float(np.nansum(rest**2))
            before += float(np.nansum((rest + moved) ** 2))
        if before > 0.0 and after > 0.0:
            gains.append(float(np.log(before / after)))
    return not gains or float(np.mean(gains)) >= 0.0


def _rows(p: PreparedThrow, joint: int) -> slice:
    block = p.block(f"actuation.{ACTIVE_JOINTS[joint]}")
    return slice(0) if block is None else block.rows


def _inputs(p: PreparedThrow, linear: LinearThrow, joint: int) -> Array:
    """Inputs (n, k) of a joint's filter, averaged as the compared samples are."""
    ticks = inputs(p.motion, joint, linear.predicted_velocity[:, joint])
    return p.joint_pair @ np.stack([_at_sensors(p, one) for one in ticks.T], axis=1)


def _at_sensors(p: PreparedThrow, track: Array) -> Array:
    """A track (T,) of control ticks at the joint sensors' times."""
    return np.interp(p.joint_at_s, p.motion.t_s, track)
