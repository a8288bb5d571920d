"""Valve calibration and twin profile of a plant: from a file, from the user's cache, or measured."""

import hashlib
import os
from pathlib import Path

from machine.calibration import ValveCalibration, load_calibration, nominal_calibration
from machine.errors import UsageError
from machine.spec import MachineSpec
from sim_twin.commissioning.excitation import RESPONSE_COPY_COUNT, identify_profile
from sim_twin.commissioning.valve_calibration import CALIBRATION_STEP_COUNT, calibrate
from sim_twin.throws.plants import TWIN, VIRTUAL, PlantMaker
from sim_twin.twin.profile import TwinProfile, load_profile


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
