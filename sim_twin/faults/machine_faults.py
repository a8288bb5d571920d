"""All effects of a virtual machine in one value: each part is None where nothing is wrong with it."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from machine.conventions import Array
from machine.spec import MachineSpec
from sim_twin.faults.body_faults import FaultyBody, altered_unit, drive_limits
from sim_twin.faults.drive_faults import FaultyDrive
from sim_twin.faults.fault import EffectSizes, Fault
from sim_twin.faults.load_faults import FaultyLoad
from sim_twin.faults.sensing_faults import FaultySensing
from sim_twin.virtual.units import MachineUnit


class PlantFaults(NamedTuple):
    """What is wrong with N machines."""

    unit: MachineUnit
    """The unit with another tool, load or base."""
    drive: FaultyDrive | None = None
    sensing: FaultySensing | None = None
    load: FaultyLoad | None = None
    body: FaultyBody | None = None


def make_faults(
    effects: Sequence[Fault],
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
    unit, acts = altered_unit(sizes, unit), sizes.acts_on
    return PlantFaults(
        unit=unit,
        drive=FaultyDrive(sizes, spec, drive_limits(), step_s) if acts("drive") else None,
        sensing=FaultySensing(sizes, step_s) if acts("joint_sensor", "imu") else None,
        load=FaultyLoad(sizes, spec, unit) if acts("grasp", "air") else None,
        body=FaultyBody(sizes, spec) if acts("free_joint", "base") else None,
    )
