"""Throws of the machine that is widest in an evaluation, one of its properties at a time as drawn."""

from collections.abc import Sequence

from cli.campaigns import CampaignOptions, open_with, progress_line, throw_campaign
from cli.registration import registered
from diagnosis.evaluation.wide_unit import Widest, WideUnit, wide_unit
from machine.spec import load_spec
from sim_twin.identify.calibrate import CALIBRATION_STEP_COUNT, calibrate
from sim_twin.throws.campaign import ThrowResult
from sim_twin.virtual.properties import PROPERTIES, as_drawn
from sim_twin.virtual.units import MachineUnit, make_unit
from sim_twin.virtual.virtual_machine import Condition, VirtualMachine

WIDE_THROWS = 200


def examine(mode: str, options: CampaignOptions, chosen: Widest) -> WideUnit | None:
    """Throw as built, with everything as drawn, and with each property as drawn: some 10 s a run.

    Only virtual machines can be changed so.
    """
    spec = load_spec()
    built = make_unit(spec, chosen.unit_seed)
    at = f"{chosen.range_m}"
    here = options._replace(unit_seed=chosen.unit_seed, targets=at, calibration=None, heights="0")
    campaign = open_with(here, mode, at)
    show = progress_line("widest machine", "runs")
    done = 0

    def throw(properties: Sequence[str]) -> list[ThrowResult]:
        nonlocal done
        unit = as_drawn(spec, built, properties)
        machine = _machine(unit, CALIBRATION_STEP_COUNT)
        try:
            tables = calibrate(machine, spec, "virtual")
        finally:
            machine.close()
        own = campaign._replace(
            make=lambda count: _machine(unit, count),
            params=campaign.params.with_calibration(tables),
        )
        # Other throws than those that made it the widest.
        results = throw_campaign(
            registered(own, options.seed), min(options.throws, WIDE_THROWS), options.seed + 1
        )
        done += 1
        show(done, len(PROPERTIES) + 2)
        return results[0]

    return wide_unit(
        chosen, throw(()), throw(tuple(PROPERTIES)), {name: throw((name,)) for name in PROPERTIES}
    )


def _machine(unit: MachineUnit, count: int) -> VirtualMachine:
    return VirtualMachine(count=count, unit_seed=unit.unit_seed, condition=Condition(unit=unit))
