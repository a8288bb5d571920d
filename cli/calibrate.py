"""`downrange calibrate`: measure what runtime and twin need to know of a machine."""

from functools import partial
from pathlib import Path

from machine.conventions import ACTIVE_JOINTS
from machine.spec import load_spec
from sim_twin.commissioning.machine_measurement import measure_machine, plot_valves
from sim_twin.throws.plants import plant_maker
from sim_twin.twin.profile import save_profile


def run(
    *,
    out: Path,
    plant: str = "virtual",
    unit_seed: int = 0,
    machine_id: str = "m001",
    seed: int = 0,
    policies: Path = Path("policies"),
    drives: bool = False,
) -> int:
    """Commission one simulated machine: valves, response of each joint, mean miss of its policies.

    Valve staircases, then random motion of each joint, then registration throws with the active policy of
    each mode, on the machine and in its twin. The machine then corrects its aim by its mean miss over range
    and height, and previews show the remaining miss.

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
        drives: identify oil springs as well; the profile has them where they explain a joint's motion better.
    """
    spec = load_spec()
    make = plant_maker(plant, unit_seed=unit_seed, profile=None, calibration=None, spec=spec)
    out.mkdir(parents=True, exist_ok=True)
    found = measure_machine(
        make, machine_id, policies, seed, partial(print, flush=True), has_drives=drives
    )
    calibration_path = out / f"{machine_id}.calibration.json"
    profile_path = out / f"{machine_id}.profile.json"
    plot_path = out / f"{machine_id}.valves.png"
    calibration_path.write_text(found.tables.model_dump_json(indent=2) + "\n", encoding="utf-8")
    save_profile(found.profile, profile_path)
    plot_valves(plot_path, found, f"{plant} unit {unit_seed}, seed {seed}")
    print("joint      dead time  frequency  damping   gain  explained")
    for name, fit in zip(ACTIVE_JOINTS, found.fits, strict=True):
        print(
            f"{name:<10} {fit.dead_time_s:6.3f} s  {fit.natural_frequency_rad_per_s:5.1f} rad/s"
            f"  {fit.damping_ratio:6.2f}  {fit.gain_ratio:6.3f}  {fit.r2_ratio:8.1%}"
        )
    for one in found.drives:
        kind = "oil spring" if one.is_oil_spring else "linear"
        print(
            f"{one.joint:<10} {kind}: explains {one.explained_ratio:.1%} of new steps and reversals, "
            f"the linear response {one.linear_explained_ratio:.1%}"
        )
    print(f"wrote {calibration_path}, {profile_path}, {plot_path}")
    return 0
