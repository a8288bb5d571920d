"""`downrange commission`: everything that a machine's twin and baseline need, in one command."""

import re
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

from cli.commissioning.steps import CommissioningJob
from cli.machine_folder import MachineFolder
from diagnosis.loading.kept_reference import LEAST_REFERENCE_COUNT, advice, words_of_days
from machine.errors import UsageError
from runtime.link.zenoh_config import NAME_PATTERN


def run(
    *,
    out: Path,
    plant: str = "virtual",
    unit_seed: int = 0,
    machine_id: str = "m001",
    reference_throws: int = 12,
    day: str | None = None,
    again: bool = False,
    seed: int = 0,
    policies: Path = Path("policies"),
) -> int:
    """Commission a machine: valves, drives, release, swing, registration, reference throws; one report.

    Each step is kept when it is done: a command that was stopped goes on where it was. Run it again on
    another day and it adds that day's reference throws, which `downrange diagnose throws` compares with by
    default.

    Writes OUT/MACHINE.calibration.json, .profile.json, .valves.png, .reference/DAY/ (throw logs),
    .commissioning.json and .commissioning.html, the report: what the twin explains of each joint and what
    not, parameters at a bound, registrations, reference throws.

    Example: downrange commission --plant virtual --unit-seed 7 --machine-id m001 --out data/machines

    Args:
        out: folder of machines.
        plant: virtual, or package.module:Class of your own simulated machine (docs/plants.md).
        unit_seed: which machine of its kind; 0 is the nominal one.
        machine_id: names the files, and the machine in the logs.
        reference_throws: throws that this day should have, half in each mode; 12 in all are the least for a
            baseline, 24 over two days are recommended.
        day: YYYY-MM-DD of the reference throws; today's if left out.
        again: measure everything anew; reference throws are kept.
        seed: of the motions, the throws and the sensors' noise.
        policies: folder of policy versions; its active.json names the one of each mode.
    """
    if NAME_PATTERN.match(machine_id) is None:
        raise UsageError(f"--machine-id {machine_id!r}: use 1 to 32 of a-z 0-9 _ -")
    if reference_throws < 1:
        raise UsageError(
            f"--reference-throws {reference_throws}: at least 1, better {LEAST_REFERENCE_COUNT}"
        )
    on = datetime.now(UTC).strftime("%Y-%m-%d") if day is None else day
    if re.fullmatch(r"\d{4}-\d{2}-\d{2}", on) is None:
        raise UsageError(f"--day {on}: give it as YYYY-MM-DD")
    files = MachineFolder(out, machine_id)
    job = CommissioningJob(plant, unit_seed, files, seed, policies, partial(print, flush=True))
    found = job.commission(reference_throws, on, again=again)
    print("joint      model       explained  linear  most of the rest lies in")
    for fit in found.joints:
        most = max(fit.unexplained_by_phase_ratio, key=fit.unexplained_by_phase_ratio.__getitem__)
        kind = "oil spring" if fit.is_oil_spring else "linear"
        print(
            f"{fit.joint:<10} {kind:<10}  {fit.explained_ratio:9.1%} {fit.linear_explained_ratio:7.1%}"
            f"  {most}, {fit.unexplained_by_phase_ratio[most]:.0%}"
        )
    for flag in found.flags():
        print(f"look at: {flag}")
    print(
        f"{words_of_days(found.reference_day_count)}. {advice(found.reference_day_count)}".strip()
    )
    print(f"wrote {files.calibration}, {files.profile}, {files.file('commissioning.html')}")
    return 0
