"""Machines of a challenge: identified when healthy, and slightly changed since.

A healthy machine differs from the one that was measured by up to 2 % in every parameter. That is nuisance,
not an effect, and a diagnosis must not name it.
"""

import hashlib
import json
import os
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from machine.calibration import ValveCalibration
from machine.conventions import Array
from machine.spec import MachineSpec
from sim_twin.commissioning import valve_calibration as calibrate_module
from sim_twin.commissioning.excitation import RESPONSE_COPY_COUNT, identify_profile
from sim_twin.commissioning.valve_calibration import CALIBRATION_STEP_COUNT, calibrate
from sim_twin.twin.profile import TwinProfile
from sim_twin.virtual.units import UNIT_HALF_WIDTH, MachineUnit, make_unit, nominal_unit
from sim_twin.virtual_machine import Condition, VirtualMachine

IDENTIFIED_FIELDS: Final = (
    "dead_time_s",
    "spool_lag_s",
    "dead_band_positive_ratio",
    "dead_band_negative_ratio",
    "hysteresis_ratio",
    "valve_gain_positive_ratio",
    "valve_gain_negative_ratio",
    "metering_curve_ratio",
    "friction_pressure_pa",
    "viscous_friction_ratio",
)
"""Fields that differ between the machines of a challenge: those that `downrange calibrate` identifies.
Geometry and sensors count as surveyed; the twin has them but for the nuisance."""
NUISANCE_RATIO: Final = 0.02
ZERO_NUISANCE_RATIO: Final = 0.2
"""Of a unit's half width, for what is zero on the drawing: tilt, biases, mounting."""
PLANT_SOURCES: Final = ("virtual_machine.py", "virtual/*.py", "commissioning/*.py")
"""Files of `sim_twin` whose code determines the identified profile; their digest is in the cache's name."""


class HealthyMachine(NamedTuple):
    """A machine as it was measured."""

    unit: MachineUnit
    calibration: ValveCalibration
    profile: TwinProfile


def challenge_unit(spec: MachineSpec, unit_seed: int) -> MachineUnit:
    """The drawing's machine with the drives of machine number `unit_seed`."""
    drives = make_unit(spec, unit_seed)
    taken: dict[str, Any] = {name: getattr(drives, name) for name in IDENTIFIED_FIELDS}
    return replace(nominal_unit(spec), unit_seed=unit_seed, **taken)


def nuisance_unit(unit: MachineUnit, rng: np.random.Generator) -> MachineUnit:
    """The machine some weeks later: parameters up to 2 % off, lengths within survey errors."""
    changed: dict[str, Any] = {}
    for field in fields(MachineUnit)[1:]:
        value: Array = np.asarray(getattr(unit, field.name), dtype=np.float64)
        width = nuisance_width(unit, field.name)
        moved = value + width * rng.uniform(-1.0, 1.0, value.shape)
        changed[field.name] = float(moved) if value.ndim == 0 else tuple(moved.tolist())
    return replace(unit, **changed)


def nuisance_width(unit: MachineUnit, field: str) -> Array:
    """Half widths of the nuisance of one field of a unit, in its unit."""
    value: Array = np.asarray(getattr(unit, field), dtype=np.float64)
    half_width = np.broadcast_to(UNIT_HALF_WIDTH[field], value.shape)
    off = np.minimum(NUISANCE_RATIO * np.abs(value), half_width)
    return np.where(value == 0.0, ZERO_NUISANCE_RATIO * half_width, off)


def healthy_machine(spec: MachineSpec, unit_seed: int, cache: Path | None = None) -> HealthyMachine:
    """Identify a machine as `downrange calibrate` does, or read the cached result of the same code."""
    unit = challenge_unit(spec, unit_seed)
    machine_id = f"challenge-{unit_seed}"
    path = (cache or _cache_folder()) / f"{machine_id}-{_digest(spec, unit)}.json"
    try:
        kept = json.loads(path.read_text(encoding="utf-8"))
        return HealthyMachine(
            unit,
            ValveCalibration.model_validate(kept["calibration"]),
            TwinProfile.model_validate(kept["profile"]),
        )
    except (OSError, ValueError, KeyError, TypeError):
        pass  # not cached yet, or an interrupted write
    condition = Condition(unit=unit)
    calibration = calibrate(
        VirtualMachine(count=CALIBRATION_STEP_COUNT, unit_seed=unit_seed, condition=condition),
        spec,
        machine_id,
    )
    profile, _ = identify_profile(
        VirtualMachine(count=RESPONSE_COPY_COUNT, unit_seed=unit_seed, condition=condition),
        spec,
        calibration,
        machine_id,
    )
    text = json.dumps(
        {
            "calibration": calibration.model_dump(mode="json"),
            "profile": profile.model_dump(mode="json"),
        }
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(f".{os.getpid()}.part")
    part.write_text(text, encoding="utf-8")
    part.replace(path)
    return HealthyMachine(unit, calibration, profile)


def _cache_folder() -> Path:
    root = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return root / "downrange" / "challenge"


def _digest(spec: MachineSpec, unit: MachineUnit) -> str:
    digest = hashlib.sha256(spec.sha256.encode())
    package = Path(calibrate_module.__file__).parents[1]
    for pattern in PLANT_SOURCES:
        for source in sorted(package.glob(pattern)):
            digest.update(source.read_bytes())
    digest.update(json.dumps(asdict(unit)).encode())
    return digest.hexdigest()[:16]
