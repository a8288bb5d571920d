"""`downrange record`: write the throw logs of a campaign, as a machine would have written them."""

import re
from itertools import cycle, islice
from pathlib import Path
from typing import Literal

import numpy as np

from cli.campaigns import Campaign, open_campaign, progress_line
from machine.conventions import DEFAULT_PACE_RATIO, Mode
from machine.errors import UsageError
from machine.starts import sample_starts
from runtime.control.control_loop import ControlParams
from sim_twin.commissioning.motions import TestKind, motion_program
from sim_twin.commissioning.recording import record_test
from sim_twin.throws.accuracy import outcome_counts
from sim_twin.throws.campaign import ThrowResult, run_throws
from sim_twin.throws.plants import TWIN, VIRTUAL, plant_profile
from sim_twin.throws.throw_logs import CampaignRecorder, LogContext
from sim_twin.twin.profile import TwinProfile, load_profile, nominal_profile

MAX_RECORDED_COUNT = 64
"""Throws kept in memory side by side (a throw is about 1 MB of rows)."""


def run(
    *,
    out: Path,
    mode: Literal["2d", "3d"] | None = None,
    test: TestKind | None = None,
    plant: str = "virtual",
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

    The throws go round the targets, each from a random start pose. The logs hold what sensors and survey
    say, no truth of the simulator, and the machine's twin profile; `downrange diagnose` reads them.

    Examples: downrange record --plant virtual --unit-seed 7 --mode 3d --throws 12 --out logs
    downrange record --test release --plant virtual --unit-seed 7 --out logs

    Args:
        out: folder for the logs; made if it is missing.
        mode: 2d throws within the arm's plane, 3d turns the cabin as well; of no account to a test.
        test: record a test for `downrange identify` instead of throws: valve steps of each joint (response),
            39 openings at rest (release), free swings after a push (swing).
        plant: twin, virtual, or package.module:Class of your own simulated machine.
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
        raise UsageError("give --mode 2d or 3d, or --test response, release or swing")
    campaign = open_campaign(
        mode=Mode(mode or "2d"),
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
    )
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"cannot make the folder {out}: {error.strerror}") from error
    own, name = _twin_profile(plant, campaign, unit_seed, profile), _slug(plant)
    context = LogContext(
        machine_id=f"{name}-{unit_seed}",
        throw_prefix=f"{name}-{unit_seed}-{test or mode}-s{seed}",
        twin_profile_version_count=0 if own is None else own.version_count,
        out_dir=out,
        twin_profile=own,
        pace_ratio=pace,
        test=test or "",
    )
    recorder = CampaignRecorder(campaign.params, context)
    if test is None:
        results = _throw(campaign, throws, seed, recorder)
    else:
        results = _run_test(campaign, test, seed, recorder)
    for stored in recorder.stored:
        print(stored.path)
    kinds = ", ".join(f"{count} {kind}" for kind, count in outcome_counts(results).items())
    size = sum(stored.size_bytes for stored in recorder.stored) / 1e6
    print(f"{len(recorder.stored)} logs, {size:.1f} MB; throws: {kinds}")
    return 0


def _slug(plant: str) -> str:
    """A plant's name as ids may hold it."""
    return re.sub(r"[^a-z0-9]+", "-", plant.lower()).strip("-")


def _twin_profile(
    plant: str, campaign: Campaign, unit_seed: int, path: Path | None
) -> TwinProfile | None:
    """The profile that belongs into the logs: the twin's own, or the virtual machine's, identified on it."""
    if path is not None:
        return load_profile(path)
    if plant == TWIN:
        return nominal_profile(campaign.spec)
    if plant != VIRTUAL:
        return None
    return plant_profile(
        campaign.make,
        unit_seed=unit_seed,
        spec=campaign.spec,
        calibration=campaign.params.calibration,
    )


def _run_test(
    campaign: Campaign, test: TestKind, seed: int, recorder: CampaignRecorder
) -> list[ThrowResult]:
    """Carry out a test's program."""
    params = ControlParams(
        campaign.spec, campaign.params.calibration, campaign.params.mode, policy=None
    )
    program = motion_program(test, seed)
    machines = campaign.make(program.start_rad_m.shape[0])
    try:
        return record_test(machines, params, program, seed, recorder)
    finally:
        machines.close()


def _throw(
    campaign: Campaign, throws: int, seed: int, recorder: CampaignRecorder
) -> list[ThrowResult]:
    """Throw round the targets, from random starts."""
    target_m = np.zeros((throws, 3))
    target_m[:, 0] = list(islice(cycle(campaign.ranges_m), throws))
    rng = np.random.default_rng(seed)
    starts = sample_starts(campaign.spec, campaign.params.mode, target_m, rng)
    machines = campaign.make(min(throws, MAX_RECORDED_COUNT))
    try:
        return run_throws(
            machines,
            campaign.params,
            target_m,
            starts,
            seed,
            record=recorder,
            progress=progress_line("record"),
            pace_ratio=campaign.pace_ratio,
        )
    finally:
        machines.close()
