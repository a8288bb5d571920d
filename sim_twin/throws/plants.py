"""Plants by name (option ``--plant``): the twin, the virtual machine, or a class of another package."""

import importlib
from collections.abc import Callable
from typing import cast

from machine.calibration import ValveCalibration, nominal_calibration
from machine.errors import UsageError
from machine.spec import MachineSpec
from runtime.driver import SimulatedDriver
from runtime.driver_factory import SIMULATED_PARTS, check_parts, construct
from sim_twin.twin.profile import TwinProfile, nominal_profile
from sim_twin.twin.twin import Twin

TWIN = "twin"
VIRTUAL = "virtual"
VIRTUAL_CLASS = "sim_twin.virtual_machine:VirtualMachine"

PlantMaker = Callable[[int], SimulatedDriver]
"""Makes a plant with a given number of machines."""


def plant_maker(
    name: str,
    *,
    unit_seed: int,
    profile: TwinProfile | None,
    calibration: ValveCalibration | None,
    spec: MachineSpec,
) -> PlantMaker:
    """Find a plant by name.

    Args:
        name: ``twin``, ``virtual`` or ``package.module:Class``.
        unit_seed: seed of the unit's parameters; 0 is the nominal unit.
        profile: profile of the twin; nominal if None.
        calibration: valve tables of the twin; nominal if None.
        spec: machine type.

    Raises:
        UsageError: no such plant, or options that do not go together.
    """
    if name == TWIN:
        return _twin_maker(unit_seed, profile, calibration, spec)
    if profile is not None:
        raise UsageError(
            f"--profile shapes the twin; it has no effect on --plant {name}: leave it out"
        )
    factory = _load(VIRTUAL_CLASS if name == VIRTUAL else name)

    def make(count: int) -> SimulatedDriver:
        plant = construct(factory, {"count": count, "unit_seed": unit_seed}, f"plant {name}")
        check_parts(plant, SIMULATED_PARTS, f"plant {name}")
        return cast("SimulatedDriver", plant)

    return make


def _twin_maker(
    unit_seed: int,
    profile: TwinProfile | None,
    calibration: ValveCalibration | None,
    spec: MachineSpec,
) -> PlantMaker:
    if unit_seed != 0:
        # Raises the twin's error: twins differ by their profiles, not by a unit seed.
        Twin.for_plant(count=1, unit_seed=unit_seed)
    chosen = profile or nominal_profile(spec)
    valves = calibration or nominal_calibration(spec)
    return lambda count: Twin(count=count, profile=chosen, calibration=valves)


def _load(name: str) -> Callable[..., object]:
    module_name, colon, attribute = name.partition(":")
    if not colon or not module_name or not attribute:
        raise UsageError(
            f"no plant '{name}'; use {TWIN}, {VIRTUAL}, or package.module:Class of your own plant"
        )
    try:
        module = importlib.import_module(module_name)
    except ImportError as error:
        raise UsageError(
            f"plant {name}: module {module_name} cannot be imported ({error}); "
            "install it beside downrange or run from its folder"
        ) from error
    factory: object = getattr(module, attribute, None)
    if not callable(factory):
        raise UsageError(f"plant {name}: module {module_name} has no class {attribute}")
    return factory
