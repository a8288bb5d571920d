"""Faults that a virtual machine can have beyond its unit: what a diagnosis is asked to find.

They act on pressures, spools, sensors, body and load of the virtual machine. Only the table of effects is
shared with the twin (names, joints, parameters, units); the physics is not.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from machine.conventions import ACTIVE_COUNT, ACTIVE_JOINTS, Array
from machine.errors import PlantError
from sim_twin.effects.schema import DRIFT, PartName
from sim_twin.faults.fault_tables import FAULTS


class Fault(NamedTuple):
    """One effect at its size."""

    effect: str
    joint: str | None
    parameters: Mapping[str, float]


class EffectSizes:
    """Sizes of all parameters on each of N machines: constant, plus drift times place in the set."""

    def __init__(self, effects: Sequence[Fault], place_ratio: Array) -> None:
        """Add up the effects.

        Args:
            effects: any number, of any kind.
            place_ratio: (N,) 0 at the first throw of a set, 1 at the last.

        Raises:
            PlantError: an effect, a joint or a parameter that does not exist.
        """
        self.count = place_ratio.size
        self._sizes: dict[tuple[str, int, str], Array] = {}
        for item in effects:
            _check(item)
            for name, value in item.parameters.items():
                if item.effect == DRIFT:
                    effect, _, parameter = name.partition(".")
                    size = value * place_ratio
                else:
                    effect, parameter = item.effect, name
                    size = np.full(self.count, value)
                key = effect, _joint_index(effect, item.joint), parameter
                known = tuple(FAULTS[effect].bounds)
                if parameter not in known:
                    raise PlantError(
                        f"effect {effect} has no parameter {parameter}; it has {known}"
                    )
                self._sizes[key] = self._sizes.get(key, np.zeros(self.count)) + size

    def has(self, *effects: str) -> bool:
        """Whether any of these effects is there."""
        return any(key[0] in effects for key in self._sizes)

    def acts_on(self, *parts: PartName) -> bool:
        """Whether any effect acts on these parts."""
        return any(FAULTS[key[0]].part in parts for key in self._sizes)

    def joints(self, effect: str, parameter: str) -> Array:
        """Sizes (N, 4) of an effect of the joints, 0 where it is not."""
        sizes = np.zeros((self.count, ACTIVE_COUNT))
        for joint in range(ACTIVE_COUNT):
            size = self._sizes.get((effect, joint, parameter))
            if size is not None:
                sizes[:, joint] = size
        return sizes

    def machine(self, effect: str, parameter: str) -> Array:
        """Sizes (N,) of an effect of the whole machine."""
        return self._sizes.get((effect, -1, parameter), np.zeros(self.count))

    def built_in(self, effect: str, parameter: str) -> float:
        """Size of an effect that is part of the machine's body and cannot drift.

        Raises:
            PlantError: it drifts.
        """
        size = self.machine(effect, parameter)
        if np.ptp(size) > 0.0:
            raise PlantError(f"{effect} is part of the machine's body: it cannot drift in a set")
        return float(size[0])


def _check(item: Fault) -> None:
    if item.effect not in (DRIFT, *FAULTS):
        raise PlantError(
            f"the virtual machine has no effect '{item.effect}'; it has {[DRIFT, *FAULTS]}"
        )


def _joint_index(effect: str, joint: str | None) -> int:
    if effect not in FAULTS:
        raise PlantError(f"the virtual machine has no effect '{effect}'; it has {list(FAULTS)}")
    joints = FAULTS[effect].joints
    if joint not in (joints or (None,)):
        wanted = f"one of {joints}" if joints else "no joint"
        raise PlantError(f"effect {effect} needs {wanted}, not {joint}")
    return ACTIVE_JOINTS.index(joint) if joint is not None else -1
