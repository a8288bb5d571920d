"""Campaigns whose throws or identification tests are written as throw logs."""

import re
from collections.abc import Sequence
from itertools import cycle, islice
from pathlib import Path
from typing import NamedTuple

import numpy as np

from evaluation.campaigns import Campaign
from evaluation.progress import progress_line
from machine.errors import UsageError
from machine.starts import sample_starts
from runtime.control.control_loop import ControlParams
from runtime.records.log_reader import read_throw_log
from runtime.records.log_writer import StoredLog
from runtime.records.recorder import log_path
from sim_twin.commissioning.motions import TestKind, motion_program
from sim_twin.commissioning.plant_data import plant_profile
from sim_twin.commissioning.recording import record_test
from sim_twin.throws.campaign import ThrowResult, run_throws
from sim_twin.throws.plants import TWIN, VIRTUAL
from sim_twin.throws.throw_logs import CampaignRecorder, LogContext
from sim_twin.twin.profile import TwinProfile, load_profile, nominal_profile

MAX_RECORDED_COUNT = 64
"""Throws that are kept in memory together; the rows of a throw take about 1 MB."""


THROW_PERIOD_S = 60.0
"""From one recorded throw to the next on the machine's clock: throws that are simulated side by side are
logged as a machine throws, one after the other."""


class RecordedMachine(NamedTuple):
    """The plant that is recorded, as named on the command line."""

    plant: str
    unit_seed: int
    profile: Path | None
    """Twin profile; None: the twin's nominal one, or identified on the virtual machine."""
    machine_id: str | None = None
    """In the logs; None: the plant's name and unit."""

    @property
    def logged_id(self) -> str:
        """Machine id of the logs."""
        return self.machine_id or f"{_slug(self.plant)}-{self.unit_seed}"


class RecordedCampaign(NamedTuple):
    """Results and logs of a recorded campaign."""

    results: list[ThrowResult]
    paths: list[Path]
    size_bytes: int


def record_campaign(
    campaigns: Sequence[Campaign],
    machine: RecordedMachine,
    test: TestKind | None,
    throws: int,
    seed: int,
    out: Path,
) -> RecordedCampaign:
    """Throw round the targets, or run an identification test, and write one log per throw into `out`.

    Args:
        campaigns: one per mode; throws take turns among them. A test takes the first.
        machine: what is recorded.
        test: kind of test, None for throws.
        throws: number of throws.
        seed: of starts, programs and noise.
        out: folder of the logs. The machine's clock goes on from its last log there.

    Raises:
        UsageError: `out` cannot be made.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"cannot make the folder {out}: {error.strerror}") from error
    what = test or "-".join(c.params.mode.value for c in campaigns)
    profile, prefix = _twin_profile(campaigns[0], machine), f"{machine.logged_id}-{what}-s{seed}"
    free_from_ns = _clock_ns(out, machine.logged_id)
    results: list[ThrowResult] = []
    stored: list[StoredLog] = []
    for place, campaign in enumerate(campaigns[:1] if test is not None else campaigns):
        numbers = tuple(range(place, throws, len(campaigns)))
        context = LogContext(
            machine_id=machine.logged_id,
            throw_prefix=prefix,
            twin_profile_version_count=0 if profile is None else profile.version_count,
            out_dir=out,
            twin_profile=profile,
            throw_numbers=() if test is not None else numbers,
            pace_ratio=campaign.pace_ratio,
            free_from_ns=free_from_ns,
            throw_period_s=THROW_PERIOD_S,
            test=test or "",
        )
        recorder = CampaignRecorder(campaign.params, context)
        if test is not None:
            results += _run_test(campaign, test, seed, recorder)
        elif numbers:
            results += _throw(campaign, len(numbers), seed, recorder)
        stored += recorder.stored
    return RecordedCampaign(results, [s.path for s in stored], sum(s.size_bytes for s in stored))


def _clock_ns(folder: Path, machine_id: str) -> int:
    """Time on the machine's clock from which a folder holds no log of this machine, ns."""
    logs = folder.glob(log_path(folder, f"{machine_id}-*").name)
    newest = max(logs, key=lambda path: path.stat().st_mtime_ns, default=None)
    if newest is None:
        return 0
    return int(read_throw_log(newest).control["t_mono_ns"][-1]) + round(THROW_PERIOD_S * 1e9)


def _slug(plant: str) -> str:
    """A plant's name in the characters that ids allow."""
    return re.sub(r"[^a-z0-9]+", "-", plant.lower()).strip("-")


def _twin_profile(campaign: Campaign, machine: RecordedMachine) -> TwinProfile | None:
    """The profile that the logs carry: read, the twin's, or identified on the virtual machine."""
    if machine.profile is not None:
        return load_profile(machine.profile)
    if machine.plant == TWIN:
        return nominal_profile(campaign.spec)
    if machine.plant != VIRTUAL:
        return None
    return plant_profile(
        campaign.make,
        unit_seed=machine.unit_seed,
        spec=campaign.spec,
        calibration=campaign.params.calibration,
    )


def _run_test(
    campaign: Campaign, test: TestKind, seed: int, recorder: CampaignRecorder
) -> list[ThrowResult]:
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
    """Throw round the targets from random starts."""
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
