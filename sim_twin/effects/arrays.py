"""Sizes of the effects of N machines, one array for each parameter.

A parameter that no machine has is None, so that the code of that effect is skipped.
"""

from collections.abc import Sequence

import numpy as np

from machine.conventions import ACTIVE_COUNT, ACTIVE_JOINTS, Array
from sim_twin.effects.effect import Effect, Sizes, resolve
from sim_twin.effects.schema import PartName, StageName
from sim_twin.effects.table import effects_where


class EffectArrays:
    """Effects of N machines: those of the profile, and a set for each machine on top."""

    def __init__(self, sizes: Sequence[Sizes]) -> None:
        """Take one resolved set (sim_twin.effects.effect.resolve) per machine."""
        self.count = len(sizes)
        self._arrays: dict[tuple[str, str], Array] = {}
        for row, of_one in enumerate(sizes):
            for (effect, joint, parameter), size in of_one.items():
                array = self._arrays.get((effect, parameter))
                if array is None:
                    shape = (self.count,) if joint is None else (self.count, ACTIVE_COUNT)
                    array = self._arrays[effect, parameter] = np.zeros(shape)
                if joint is None:
                    array[row] = size
                else:
                    array[row, ACTIVE_JOINTS.index(joint)] = size

    def get(self, effect: str, parameter: str) -> Array | None:
        """Sizes (N,), per joint (N, 4); None where no machine has any."""
        array = self._arrays.get((effect, parameter))
        return array if array is not None and array.any() else None

    def filled(self, effect: str, parameter: str) -> Array:
        """The same with 0 for None; for effects of the whole machine."""
        array = self.get(effect, parameter)
        return np.zeros(self.count) if array is None else array

    def has(self, *effects: str) -> bool:
        """Whether any machine has any of these effects at another size than 0."""
        return any(array.any() for (name, _), array in self._arrays.items() if name in effects)

    def acts_in(self, stage: StageName) -> bool:
        """Whether any machine has any effect of a stage."""
        return self.has(*effects_where(lambda effect: effect.stage == stage))

    def acts_on(self, *parts: PartName) -> bool:
        """Whether any machine has any effect on these parts."""
        return self.has(*effects_where(lambda effect: effect.part in parts))


def effect_arrays(
    count: int,
    of_all: Sequence[Effect],
    of_each: Sequence[Sequence[Effect]] | None,
    progress_ratio: Array | float,
) -> EffectArrays | None:
    """Effects of `count` machines; None when there are none.

    Args:
        count: N.
        of_all: the profile's.
        of_each: N sets, or None.
        progress_ratio: (N,) places of the throws in their set (drifts).
    """
    if not of_all and not any(of_each or ()):
        return None
    sets = of_each if of_each is not None else ((),) * count
    progress = np.broadcast_to(np.asarray(progress_ratio, dtype=np.float64), (count,))
    known: dict[tuple[tuple[Effect, ...], float], Sizes] = {}
    sizes: list[Sizes] = []
    for of_one, place in zip(sets, progress.tolist(), strict=True):
        key = (tuple(of_one), place)
        if key not in known:
            known[key] = resolve((*of_all, *of_one), place)
        sizes.append(known[key])
    return EffectArrays(sizes)
