"""Plants by name (option ``--plant``): the twin, the virtual machine, or a class of another package.

Also finds a plant's valve calibration: from a file, from the cache, or measured.
"""

import hashlib
import importlib
import os
from collections.abc import Callable
from pathlib import Path

from machine.calibration import ValveCalibration, load_calibration, nominal_calibration
from machine.errors import UsageError
from machine.spec import MachineSpec
from runtime.driver import SimulatedDriver
from sim_twin.commissioning.excitation import RESPONSE_COPY_COUNT, identify_profile
from sim_twin.commissioning.valve_calibration import CALIBRATION_STEP_COUNT, calibrate
from sim_twin.twin.profile import TwinProfile, load_profile, nominal_profile
from sim_twin.twin.twin import Twin

TWIN = "twin"
VIRTUAL = "virtual"
VIRTUAL_CLASS = "sim_twin.virtual.virtual_machine:VirtualMachine"

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
        try:
            plant = factory(count=count, unit_seed=unit_seed)
        except TypeError as error:
            raise UsageError(
                f"plant {name} cannot be made ({error}); it must take the keywords count and unit_seed"
            ) from error
        if not isinstance(plant, SimulatedDriver):
            raise UsageError(
                f"plant {name} is no simulated machine: it lacks methods of "
                "runtime.driver.SimulatedDriver (docs/drivers.md)"
            )
        return plant

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


def plant_calibration(
    name: str, make: PlantMaker, *, unit_seed: int, spec: MachineSpec, path: Path | None
) -> ValveCalibration:
    """Valve calibration of a plant's machine: read from a file, or measured on the plant.

    A measurement on the virtual machine is kept in the user's cache folder. Its name contains the unit and a
    hash of the simulator's code, so that changed code measures again.

    Raises:
        UsageError: the file is not a calibration.
        PlantError: the plant's joints do not follow its valves.
    """
    if path is not None:
        return load_calibration(path)
    if name == TWIN:
        return nominal_calibration(spec)
    cached = _cache_path(unit_seed, spec, "calibration") if name == VIRTUAL else None
    if cached is not None and cached.is_file():
        try:
            return load_calibration(cached)
        except UsageError:
            cached.unlink(missing_ok=True)  # Incomplete, from an interrupted run.
    machine_id = f"{name}-{unit_seed}"
    calibration = calibrate(make(CALIBRATION_STEP_COUNT), spec, machine_id)
    if cached is not None:
        _keep(calibration, cached)
    return calibration


def plant_profile(
    make: PlantMaker, *, unit_seed: int, spec: MachineSpec, calibration: ValveCalibration
) -> TwinProfile:
    """Twin profile of a virtual machine, identified once and kept in the cache.

    Raises:
        PlantError: the plant's joints do not follow its valves.
    """
    cached = _cache_path(unit_seed, spec, "profile", calibration.model_dump_json())
    if cached.is_file():
        try:
            return load_profile(cached)
        except UsageError:
            cached.unlink(missing_ok=True)  # Incomplete, from an interrupted run.
    machine_id = f"{VIRTUAL}-{unit_seed}"
    machine = make(RESPONSE_COPY_COUNT)
    try:
        profile, _ = identify_profile(machine, spec, calibration, machine_id)
    finally:
        machine.close()
    _keep(profile, cached)
    return profile


def _cache_path(unit_seed: int, spec: MachineSpec, kind: str, of: str = "") -> Path:
    root = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    digest = hashlib.sha256((spec.sha256 + of).encode())
    for source in sorted(Path(__file__).parents[1].rglob("*.py")):
        digest.update(source.read_bytes())
    return root / "downrange" / kind / f"virtual-{unit_seed}-{digest.hexdigest()[:16]}.json"


def _keep(measured: ValveCalibration | TwinProfile, path: Path) -> None:
    """Write to the cache; errors are ignored, because the next run measures again."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(f".{os.getpid()}.part")
        part.write_text(measured.model_dump_json(), encoding="utf-8")
        part.replace(path)
    except OSError:
        return
