"""All effects of a virtual machine in one value: each part is None where nothing is wrong with it."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from machine.conventions import Array
from machine.spec import MachineSpec
from sim_twin.faults.body import BODY_EFFECTS, BodyEffects, altered_unit, drive_limits
from sim_twin.faults.drive import DRIVE_EFFECTS, DriveEffects
from sim_twin.faults.fault import EffectSizes, PlantEffect
from sim_twin.faults.load import THROW_EFFECTS, LoadEffects
from sim_twin.faults.sensing import SENSING_EFFECTS, SensingEffects
from sim_twin.virtual.units import MachineUnit


class PlantFaults(NamedTuple):
    """What is wrong with N machines."""

    unit: MachineUnit
    """The unit with another tool, load or base."""
    drive: DriveEffects | None = None
    sensing: SensingEffects | None = None
    load: LoadEffects | None = None
    body: BodyEffects | None = None


def make_faults(
    effects: Sequence[PlantEffect],
    place_ratio: Array,
    spec: MachineSpec,
    unit: MachineUnit,
    step_s: float,
) -> PlantFaults:
    """Faults of N copies of a unit.

    Args:
        effects: what is wrong; nothing if empty.
        place_ratio: (N,) each copy's place in the set of throws, 0 first, 1 last.
        spec: machine type.
        unit: the healthy machine.
        step_s: of the physics.

    Raises:
        PlantError: an effect that the virtual machine does not have.
    """
    sizes = EffectSizes(effects, np.asarray(place_ratio, dtype=np.float64))
    unit = altered_unit(sizes, unit)
    return PlantFaults(
        unit=unit,
        drive=DriveEffects(sizes, spec, drive_limits(), step_s)
        if sizes.has(*DRIVE_EFFECTS)
        else None,
        sensing=SensingEffects(sizes, step_s) if sizes.has(*SENSING_EFFECTS) else None,
        load=LoadEffects(sizes, spec, unit) if sizes.has(*THROW_EFFECTS) else None,
        body=BodyEffects(sizes, spec) if sizes.has(*BODY_EFFECTS) else None,
    )
