"""Campaigns of many simulated throws: check the options, set up the machine, throw."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from evaluation.progress import progress_line
from machine.calibration import ValveCalibration, load_calibration
from machine.conventions import DEFAULT_PACE_RATIO, Array, Mode
from machine.errors import UsageError
from machine.messages import Target
from machine.reach import check_pace, check_target, reach_m
from machine.spec import MachineSpec, load_spec
from machine.starts import sample_starts
from runtime.control.control_loop import ControlParams
from runtime.control.policy import PolicyRunner, find_policy
from sim_twin.commissioning.plant_data import plant_calibration
from sim_twin.throws.campaign import ThrowResult, TickRecorder, run_throws
from sim_twin.throws.plants import TWIN, PlantMaker, plant_maker
from sim_twin.twin.profile import load_profile

MAX_TARGET_COUNT = 200
MAX_BATCH_COUNT = 400
"""Machines simulated together; larger arrays no longer fit into the processor's cache."""


class Campaign(NamedTuple):
    """Machine, policy and targets of a campaign."""

    spec: MachineSpec
    params: ControlParams
    make: PlantMaker
    ranges_m: tuple[float, ...]
    policy_id: str
    policy_folder: Path
    pace_ratio: float = DEFAULT_PACE_RATIO
    """0 careful .. 1 fast."""
    heights_m: tuple[float, ...] = (0.0,)
    """Of the target surface above the ground."""

    @property
    def places(self) -> list[tuple[float, float]]:
        """Range and height of every target, height by height, without targets out of reach."""
        return [
            (range_m, height_m)
            for height_m in self.heights_m
            for range_m in self.ranges_m
            if self.params.policy is None
            or range_m <= reach_m(self.params.policy.card, height_m) + 1e-9
        ]


class CampaignOptions(NamedTuple):
    """Options of a campaign as given on the command line."""

    plant: str
    targets: str | None
    throws: int
    seed: int
    unit_seed: int
    policies: Path
    policy: Path | None
    calibration: Path | None
    profile: Path | None
    pace: float = DEFAULT_PACE_RATIO
    heights: str = "0"
    tables: ValveCalibration | None = None
    """The machine's calibration if it is already known; then no file is read and nothing is measured."""


def open_with(options: CampaignOptions, mode: str, default_targets: str) -> Campaign:
    """Call `open_campaign` with options of the command line."""
    return open_campaign(
        mode=Mode(mode),
        plant=options.plant,
        targets=options.targets or default_targets,
        throws=options.throws,
        seed=options.seed,
        unit_seed=options.unit_seed,
        policies=options.policies,
        policy=options.policy,
        calibration=options.calibration,
        profile=options.profile,
        pace_ratio=options.pace,
        heights=options.heights,
        tables=options.tables,
    )


def open_campaign(
    *,
    mode: Mode,
    plant: str,
    targets: str,
    throws: int,
    seed: int,
    unit_seed: int,
    policies: Path,
    policy: Path | None,
    calibration: Path | None,
    profile: Path | None,
    pace_ratio: float = DEFAULT_PACE_RATIO,
    heights: str = "0",
    tables: ValveCalibration | None = None,
) -> Campaign:
    """Check every option and set up the campaign; nothing is thrown.

    Raises:
        UsageError: an option that cannot work.
        PolicyError: no policy, or one that does not fit.
        RefusedError: a target that the policy was not trained for.
    """
    ranges = parse_targets(targets)
    if throws < 1:
        raise UsageError(f"--throws {throws}: at least 1 throw at each target is needed")
    if seed < 0 or unit_seed < 0:
        raise UsageError(f"--seed {seed} --unit-seed {unit_seed}: seeds are 0 or more")
    check_pace(pace_ratio)
    spec = load_spec()
    runner = open_policy(mode, policies, policy, spec)
    heights_m = parse_heights(heights)
    for height_m in heights_m:
        # On the ground every range must be in reach; above it, the nearest.
        for range_m in ranges if height_m == 0.0 else (min(ranges),):
            check_target(runner.card, Target(x_m=range_m, y_m=0.0, z_m=height_m))
    twin_profile = None if profile is None else load_profile(profile)
    make = plant_maker(
        plant,
        unit_seed=unit_seed,
        profile=twin_profile,
        calibration=None if calibration is None else load_calibration(calibration),
        spec=spec,
    )
    if tables is None:
        tables = plant_calibration(plant, make, unit_seed=unit_seed, spec=spec, path=calibration)
        if plant == TWIN:
            tables = tables.for_twin()
    params = ControlParams(spec=spec, calibration=tables, mode=mode, policy=runner)
    folder = policy if policy is not None else find_policy(policies, mode)
    return Campaign(
        spec, params, make, ranges, runner.card.policy_id, folder, pace_ratio, heights_m
    )


def open_policy(mode: Mode, policies: Path, policy: Path | None, spec: MachineSpec) -> PolicyRunner:
    """Load the policy of a folder, or the active one of the mode.

    Raises:
        PolicyError: missing, broken, or for another machine.
        UsageError: for the other mode.
    """
    runner = PolicyRunner(policy if policy is not None else find_policy(policies, mode), spec)
    if runner.card.mode is not mode:
        raise UsageError(
            f"policy {runner.card.policy_id} throws in {runner.card.mode.value}, --mode is "
            f"{mode.value}; choose the other mode or another policy"
        )
    return runner


def parse_targets(text: str) -> tuple[float, ...]:
    """Ranges from ``FIRST:LAST:STEP`` (both ends) or from a list with commas.

    Raises:
        UsageError: anything else, with what was wrong.
    """
    form = "use FIRST:LAST:STEP such as 7.5:10:0.5, or a list such as 8,8.5,9"
    parts = text.split(":")
    try:
        numbers = [float(part) for part in (parts if len(parts) > 1 else text.split(","))]
    except ValueError:
        raise UsageError(f"--targets '{text}' holds something that is no number; {form}") from None
    if not all(math.isfinite(number) for number in numbers):
        raise UsageError(f"--targets '{text}' holds a number that is not finite; {form}")
    if len(parts) == 1:
        return _checked_ranges(tuple(numbers), text)
    if len(numbers) != 3:
        raise UsageError(f"--targets '{text}' has {len(numbers)} parts; {form}")
    first, last, step = numbers
    if step <= 0.0 or last < first:
        raise UsageError(
            f"--targets '{text}' goes from {first:g} m to {last:g} m in steps of {step:g} m; {form}"
        )
    count = math.floor((last - first) / step + 1e-6) + 1
    if count > MAX_TARGET_COUNT:
        raise UsageError(f"--targets '{text}' names {count} targets; at most {MAX_TARGET_COUNT}")
    return _checked_ranges(tuple(round(first + i * step, 9) for i in range(count)), text)


def parse_heights(text: str) -> tuple[float, ...]:
    """Heights of the target surface from a list with commas, m.

    Raises:
        UsageError: anything else, with what was wrong.
    """
    try:
        heights = tuple(float(part) for part in text.split(","))
    except ValueError:
        heights = ()
    if not heights or not all(-5.0 <= height <= 10.0 for height in heights):
        raise UsageError(f"--heights '{text}': use a list such as 0,1,2 in metres, each -5 to 10")
    return heights


def _checked_ranges(ranges_m: tuple[float, ...], text: str) -> tuple[float, ...]:
    if any(range_m <= 0.0 or range_m > 60.0 for range_m in ranges_m):
        raise UsageError(f"--targets '{text}': ranges lie between 0 and 60 m")
    return ranges_m


def campaign_starts(campaign: Campaign, throws: int, seed: int) -> tuple[Array, Array]:
    """Targets (N, 3) and random start poses (N, 6), `throws` at each place."""
    places = np.repeat(np.asarray(campaign.places), throws, axis=0)
    target_m = np.zeros((places.shape[0], 3))
    target_m[:, 0], target_m[:, 2] = places.T
    rng = np.random.default_rng(seed)
    return target_m, sample_starts(campaign.spec, campaign.params.mode, target_m, rng)


def batch_count(campaign: Campaign, throws: int) -> int:
    """Number of batches in which a campaign is thrown."""
    return math.ceil(len(campaign.places) * throws / MAX_BATCH_COUNT)


def throw_campaign(
    campaign: Campaign, throws: int, seed: int, record: TickRecorder | None = None
) -> list[list[ThrowResult]]:
    """Throw `throws` times at each place; results by target."""
    batches = range(batch_count(campaign, throws))
    results = throw_batches(campaign, throws, seed, batches, record)
    return by_target(results, throws)


def throw_batches(
    campaign: Campaign, throws: int, seed: int, batches: range, record: TickRecorder | None = None
) -> list[ThrowResult]:
    """Throw some of the batches of `throw_campaign`; the results do not depend on which."""
    target_m, starts = campaign_starts(campaign, throws, seed)
    size = math.ceil(target_m.shape[0] / batch_count(campaign, throws))
    taken = slice(batches.start * size, batches.stop * size)
    plant = campaign.make(size)
    try:
        return run_throws(
            plant,
            campaign.params,
            target_m[taken],
            starts[taken],
            seed,
            record=record,
            progress=progress_line("evaluate"),
            pace_ratio=campaign.pace_ratio,
            first_batch=batches.start,
        )
    finally:
        plant.close()


def by_target(results: Sequence[ThrowResult], throws: int) -> list[list[ThrowResult]]:
    """Group results in their order, `throws` for each target."""
    return [list(results[i : i + throws]) for i in range(0, len(results), throws)]
