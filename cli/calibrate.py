"""`downrange calibrate`: measure a machine's valves and response; what runtime and twin need of it."""

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from machine.calibration import ValveCalibration
from machine.conventions import ACTIVE_JOINTS, Mode
from machine.registration import Registration
from machine.spec import load_spec
from runtime.control.control_loop import ControlParams
from runtime.control.policy import PolicyRunner, find_policy
from sim_twin.commissioning.excitation import RESPONSE_COPY_COUNT, identify_profile
from sim_twin.commissioning.registration_throws import register_machine, registration_throw_count
from sim_twin.commissioning.response_fit import ResponseFit
from sim_twin.commissioning.valve_calibration import CALIBRATION_STEP_COUNT, calibrate
from sim_twin.throws.plants import PlantMaker, plant_maker
from sim_twin.twin.profile import save_profile


def run(
    *,
    out: Path,
    plant: str = "virtual",
    unit_seed: int = 0,
    machine_id: str = "m001",
    seed: int = 0,
    policies: Path = Path("policies"),
) -> int:
    """Measure one simulated machine by itself: valves, response of each joint, mean miss of its policies.

    Valve staircases, then random motion of each joint, then registration throws with the active policy of
    each mode, on the machine and in its twin: the machine aims by its mean miss from then on, over range
    and height, and previews show what that leaves.

    Writes OUT/MACHINE.calibration.json (valve tables for the runtime's feed-forward, registrations),
    OUT/MACHINE.profile.json (dead time, natural frequency, damping and gain for the twin) and
    OUT/MACHINE.valves.png. Only what the machine's own sensors show is used.

    Example: downrange calibrate --plant virtual --unit-seed 7 --machine-id m001 --out data/machines

    Args:
        out: folder for the three files.
        plant: virtual, or package.module:Class of your own simulated machine.
        unit_seed: which machine of its kind; 0 is the nominal one.
        machine_id: names the files.
        seed: of the random motion, the throws and the sensors' noise.
        policies: folder of policy versions; its active.json names the one of each mode.
    """
    spec = load_spec()
    make = plant_maker(plant, unit_seed=unit_seed, profile=None, calibration=None, spec=spec)
    out.mkdir(parents=True, exist_ok=True)
    print(f"valve staircases: {CALIBRATION_STEP_COUNT} steps ...", flush=True)
    machine = make(CALIBRATION_STEP_COUNT)
    try:
        tables = calibrate(machine, spec, machine_id, seed)
    finally:
        machine.close()
    print(f"response: {RESPONSE_COPY_COUNT} random motions ...", flush=True)
    machine = make(RESPONSE_COPY_COUNT)
    try:
        profile, fits = identify_profile(machine, spec, tables, machine_id, seed)
    finally:
        machine.close()
    twin = plant_maker("twin", unit_seed=0, profile=profile, calibration=tables, spec=spec)
    tables = _registered(make, twin, tables, policies, seed)
    calibration_path = out / f"{machine_id}.calibration.json"
    profile_path = out / f"{machine_id}.profile.json"
    calibration_path.write_text(tables.model_dump_json(indent=2) + "\n", encoding="utf-8")
    save_profile(profile, profile_path)
    plot_path = out / f"{machine_id}.valves.png"
    _plot(plot_path, tables, fits, f"{plant} unit {unit_seed}, seed {seed}")
    print("joint      dead time  frequency  damping   gain  explained")
    for name, fit in zip(ACTIVE_JOINTS, fits, strict=True):
        print(
            f"{name:<10} {fit.dead_time_s:6.3f} s  {fit.natural_frequency_rad_per_s:5.1f} rad/s"
            f"  {fit.damping_ratio:6.2f}  {fit.gain_ratio:6.3f}  {fit.r2_ratio:8.1%}"
        )
    print(f"wrote {calibration_path}, {profile_path}, {plot_path}")
    return 0


def _registered(
    make: PlantMaker, twin: PlantMaker, tables: ValveCalibration, policies: Path, seed: int
) -> ValveCalibration:
    """The tables with a registration of the active policy of each mode, of the machine and of its twin."""
    spec = load_spec()
    found: dict[PlantMaker, list[Registration]] = {make: [], twin: []}
    for mode in Mode:
        runner = PolicyRunner(find_policy(policies, mode), spec)
        count = registration_throw_count(runner.card)
        print(f"registration: {count} throws with {runner.card.policy_id} ...", flush=True)
        for maker, registrations in found.items():
            plant = maker(count)
            try:
                params = ControlParams(spec, tables, mode, runner)
                registrations.append(register_machine(plant, params, spec, seed))
            finally:
                plant.close()
    return tables.model_copy(
        update={
            "registrations": tuple(found[make]),
            "twin_registrations": tuple(found[twin]),
        }
    )


def _plot(path: Path, tables: ValveCalibration, fits: tuple[ResponseFit, ...], title: str) -> None:
    figure = Figure(figsize=(10.0, 6.4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, 2).ravel()
    for index, (axis, name, table, fit) in enumerate(
        zip(axes, ACTIVE_JOINTS, tables.tables, fits, strict=True)
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
