"""Commissioning of one machine: valve tables, twin profile, and a registration with each policy."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from machine.calibration import ValveCalibration
from machine.conventions import ACTIVE_JOINTS, Mode
from machine.registration import Registration
from machine.spec import load_spec
from runtime.control.control_loop import ControlParams
from runtime.control.policy import PolicyRunner, find_policy
from sim_twin.commissioning.drive_identification import (
    JointExplanation,
    identify_drives,
    with_drives,
)
from sim_twin.commissioning.drive_motion import DRIVE_COPY_COUNT, record_drives
from sim_twin.commissioning.excitation import RESPONSE_COPY_COUNT, identify_profile
from sim_twin.commissioning.registration_throws import register_machine, registration_throw_count
from sim_twin.commissioning.response_fit import ResponseFit
from sim_twin.commissioning.valve_calibration import CALIBRATION_STEP_COUNT, calibrate
from sim_twin.throws.plant_abilities import HasSurface
from sim_twin.throws.plants import PlantMaker, plant_maker
from sim_twin.twin.profile import TwinProfile


class MachineMeasurement(NamedTuple):
    """Measured data of a machine for runtime and twin."""

    tables: ValveCalibration
    """With the registrations of the machine and of its twin."""
    profile: TwinProfile
    fits: tuple[ResponseFit, ...]
    """One per driven joint."""
    drives: tuple[JointExplanation, ...] = ()
    """One per driven joint where oil springs were asked for."""


def measure_machine(
    make: PlantMaker,
    machine_id: str,
    policies: Path,
    seed: int,
    show: Callable[[str], None],
    *,
    has_drives: bool = False,
) -> MachineMeasurement:
    """Measure valves and responses, then register the active policy of each mode.

    Only the machine's own sensors and the survey are used.

    Args:
        make: of the machine.
        machine_id: written into calibration and profile.
        policies: folder of policy versions with its active.json.
        seed: of motions, throws and the sensors' noise.
        show: called with a line about the next measurement.
        has_drives: identify oil springs too; the profile has them where they explain a joint better.
    """
    spec = load_spec()
    show(f"valve staircases: {CALIBRATION_STEP_COUNT} steps ...")
    machine = make(CALIBRATION_STEP_COUNT)
    try:
        tables = calibrate(machine, spec, machine_id, seed)
    finally:
        machine.close()
    found = identify_machine(make, tables, machine_id, seed, show, has_drives=has_drives)
    tables = register_policies(make, found.profile, tables, policies, seed, show)
    return found._replace(tables=tables)


def identify_machine(
    make: PlantMaker,
    tables: ValveCalibration,
    machine_id: str,
    seed: int,
    show: Callable[[str], None],
    *,
    has_drives: bool,
) -> MachineMeasurement:
    """Twin profile from random motion, with oil springs if asked for; `tables` stay as they are."""
    spec = load_spec()
    show(f"response: {RESPONSE_COPY_COUNT} random motions ...")
    machine = make(RESPONSE_COPY_COUNT)
    try:
        profile, fits = identify_profile(machine, spec, tables, machine_id, seed)
    finally:
        machine.close()
    if not has_drives:
        return MachineMeasurement(tables, profile, fits)
    show(f"drives: {DRIVE_COPY_COUNT} motions of steps, stops and reversals ...")
    machine = make(DRIVE_COPY_COUNT)
    try:
        records = record_drives(machine, spec, tables, seed)
    finally:
        machine.close()
    drives = identify_drives(records, fits, show)
    return MachineMeasurement(tables, with_drives(profile, drives), fits, drives)


def register_policies(
    make: PlantMaker,
    profile: TwinProfile,
    tables: ValveCalibration,
    policies: Path,
    seed: int,
    show: Callable[[str], None],
) -> ValveCalibration:
    """The tables with registrations of the machine and of its twin, for the active policy of each mode."""
    spec = load_spec()
    twin = plant_maker("twin", unit_seed=0, profile=profile, calibration=tables, spec=spec)
    found: dict[PlantMaker, list[Registration]] = {make: [], twin: []}
    for mode in Mode:
        runner = PolicyRunner(find_policy(policies, mode), spec)
        count = registration_throw_count(runner.card)
        show(f"registration: {count} throws with {runner.card.policy_id} ...")
        has_heights = True
        # The machine first: its twin is registered with the same throws.
        for maker, registrations in found.items():
            plant = maker(count)
            has_heights = has_heights and isinstance(plant, HasSurface)
            try:
                params = ControlParams(spec, tables, mode, runner)
                registrations.append(
                    register_machine(plant, params, spec, seed, on_ground_only=not has_heights)
                )
            finally:
                plant.close()
        if not has_heights:
            show("  at ground level only: the driver has no set_surface_height (docs/plants.md)")
    return tables.model_copy(
        update={
            "registrations": tuple(found[make]),
            "twin_registrations": tuple(found[twin]),
        }
    )


def plot_valves(path: Path, found: MachineMeasurement, title: str) -> None:
    """Draw the steady valve curve of each driven joint into a file."""
    figure = Figure(figsize=(10.0, 6.4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, 2).ravel()
    for index, (axis, name, table, fit) in enumerate(
        zip(axes, ACTIVE_JOINTS, found.tables.tables, found.fits, strict=True)
    ):
        unit = "rad/s" if index == 0 else "m/s"
        axis.axhline(0.0, color="0.6", linewidth=0.8)
        axis.axvline(0.0, color="0.6", linewidth=0.8)
        axis.plot(np.asarray(table.valve_ratio), table.actuator_speed_rad_m_per_s, marker=".")
        axis.set_title(f"{name}: dead time {1e3 * fit.dead_time_s:.0f} ms, R² {fit.r2_ratio:.3f}")
        axis.set_xlabel("valve command")
        axis.set_ylabel(f"steady actuator speed, {unit}")
    figure.suptitle(title)
    figure.savefig(path, dpi=110)
