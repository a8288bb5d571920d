"""`downrange record`: write the throw logs of a campaign, as a machine would have written them."""

from pathlib import Path
from typing import Literal

from evaluation.campaigns import Campaign, open_campaign
from evaluation.log_campaign import RecordedMachine, record_campaign
from machine.conventions import DEFAULT_PACE_RATIO, Mode
from machine.errors import UsageError
from runtime.link.zenoh_config import NAME_PATTERN
from sim_twin.commissioning.motions import TestKind
from sim_twin.throws.accuracy import outcome_counts


def run(
    *,
    out: Path,
    mode: Literal["2d", "3d", "both"] | None = None,
    test: TestKind | None = None,
    plant: str = "virtual",
    machine_id: str | None = None,
    throws: int = 12,
    targets: str = "7.5:10:0.5",
    seed: int = 0,
    unit_seed: int = 0,
    pace: float = DEFAULT_PACE_RATIO,
    policies: Path = Path("policies"),
    policy: Path | None = None,
    calibration: Path | None = None,
    profile: Path | None = None,
) -> int:
    """Throw on a simulated plant and write one throw log (MCAP) a throw.

    The throws go round the targets, each from a random start pose. The logs hold sensor and survey data and
    the machine's twin profile, and no hidden state of the simulator; `downrange diagnose` reads them. Throws
    follow each other on the machine's clock, a minute apart, after those that are in the folder already.

    Examples: downrange record --plant virtual --unit-seed 7 --mode both --throws 12 --out logs
    downrange record --test release --plant virtual --unit-seed 7 --out logs

    Args:
        out: folder for the logs; made if it is missing.
        mode: 2d throws within the arm's plane, 3d turns the cabin too, both takes turns; ignored by a test.
        test: record a test for `downrange identify` instead of throws: valve steps of each joint (response),
            39 openings at rest (release), free swings after a push (swing).
        plant: twin, virtual, or package.module:Class of your own simulated machine.
        machine_id: name of the machine in the logs; the plant's name and unit if left out.
        throws: throws in all.
        targets: ranges in metres from the slew axis, FIRST:LAST:STEP with both ends, or 8,8.5,9.
        seed: of start poses and of everything random in the plant.
        unit_seed: which machine of its kind the plant is; 0 is the nominal one.
        pace: 0 careful .. 1 fast.
        policies: folder of policy versions; its active.json names the one of each mode.
        policy: folder of one policy version, instead of the active one.
        calibration: valve calibration of the machine; measured on the plant if left out.
        profile: twin profile, for --plant twin; nominal if left out.
    """
    if mode is None and test is None:
        raise UsageError("give --mode 2d, 3d or both, or --test response, release or swing")
    modes = tuple(Mode) if mode == "both" and test is None else (Mode(mode or "2d"),)
    if len(modes) > 1 and policy is not None:
        raise UsageError("--policy is of one mode; --mode both takes the active ones of --policies")
    if machine_id is not None and NAME_PATTERN.match(machine_id) is None:
        raise UsageError(f"--machine-id {machine_id!r}: use 1 to 32 of a-z 0-9 _ -")
    campaigns: list[Campaign] = []
    for one in modes:
        campaigns.append(
            open_campaign(
                mode=one,
                plant=plant,
                targets=targets,
                throws=throws,
                seed=seed,
                unit_seed=unit_seed,
                policies=policies,
                policy=policy,
                calibration=calibration,
                profile=profile,
                pace_ratio=pace,
                # Measured once; the modes share the machine.
                tables=campaigns[0].params.calibration if campaigns else None,
            )
        )
    machine = RecordedMachine(plant, unit_seed, profile, machine_id)
    found = record_campaign(campaigns, machine, test, throws, seed, out)
    for path in found.paths:
        print(path)
    kinds = ", ".join(f"{count} {kind}" for kind, count in outcome_counts(found.results).items())
    print(f"{len(found.paths)} logs, {found.size_bytes / 1e6:.1f} MB; throws: {kinds}")
    return 0
