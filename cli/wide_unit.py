"""Throws of the machine that is widest in an evaluation, one of its properties at a time as drawn."""

from collections.abc import Sequence
from functools import partial

from cli.campaigns import CampaignOptions, open_with, throw_campaign
from cli.registration import registered
from cli.side_by_side import side_by_side
from diagnosis.evaluation.wide_unit import Widest, WideUnit, wide_unit
from machine.spec import load_spec
from sim_twin.commissioning.valve_calibration import CALIBRATION_STEP_COUNT, calibrate
from sim_twin.throws.campaign import ThrowResult
from sim_twin.virtual.properties import PROPERTIES, as_drawn
from sim_twin.virtual.units import MachineUnit, make_unit
from sim_twin.virtual.virtual_machine import Condition, VirtualMachine

WIDE_THROWS = 200


def examine(mode: str, options: CampaignOptions, chosen: Widest, jobs: int = 1) -> WideUnit | None:
    """Throw as built, with everything as drawn, and with each property as drawn: some 10 s a run.

    Only virtual machines can be changed so.
    """
    at = f"{chosen.range_m}"
    here = options._replace(
        unit_seed=chosen.unit_seed, targets=at, calibration=None, tables=None, heights="0"
    )
    runs = ((), tuple(PROPERTIES), *((name,) for name in PROPERTIES))
    tasks = [partial(_throw, mode, here, run) for run in runs]
    built, drawn, *single = side_by_side(tasks, jobs, f"widest machine, {mode}")
    return wide_unit(chosen, built, drawn, dict(zip(PROPERTIES, single, strict=True)))


def _throw(mode: str, options: CampaignOptions, properties: Sequence[str]) -> list[ThrowResult]:
    """The machine with these properties as drawn: measured, registered, thrown with."""
    spec = load_spec()
    unit = as_drawn(spec, make_unit(spec, options.unit_seed), properties)
    machine = _machine(unit, CALIBRATION_STEP_COUNT)
    try:
        tables = calibrate(machine, spec, "virtual")
    finally:
        machine.close()
    own = open_with(options._replace(tables=tables), mode, "")._replace(
        make=lambda count: _machine(unit, count)
    )
    # Other throws than those that made it the widest.
    results = throw_campaign(
        registered(own, options.seed), min(options.throws, WIDE_THROWS), options.seed + 1
    )
    return results[0]


def _machine(unit: MachineUnit, count: int) -> VirtualMachine:
    return VirtualMachine(count=count, unit_seed=unit.unit_seed, condition=Condition(unit=unit))
