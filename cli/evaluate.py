"""`downrange evaluate`: accuracy over many throws in a simulated plant, by the paper's protocol."""

import json as json_text
import math
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from time import perf_counter
from typing import Any, Literal, NamedTuple

import numpy as np

from machine.calibration import load_calibration
from machine.conventions import Mode
from machine.errors import UsageError
from machine.messages import Target
from machine.policy_card import add_evaluation, load_card
from machine.reach import check_target
from machine.spec import MachineSpec, load_spec
from machine.starts import sample_starts
from runtime.control.control_loop import ControlParams
from runtime.control.policy import PolicyRunner, find_policy
from sim_twin.throws.accuracy import (
    AccuracyReport,
    accuracy_table,
    bad_throws_text,
    landing_errors,
    target_accuracy,
)
from sim_twin.throws.campaign import ThrowResult, run_throws
from sim_twin.throws.plants import PlantMaker, plant_calibration, plant_maker
from sim_twin.throws.plots import TargetScatter, check_plot_path, plot_accuracy
from sim_twin.twin.profile import load_profile

MAX_TARGET_COUNT = 200
MAX_BATCH_COUNT = 400
"""Machines simulated side by side: beyond it the arrays of a tick leave the processor's cache."""


class Campaign(NamedTuple):
    """What `evaluate` and `record` set up alike."""

    spec: MachineSpec
    params: ControlParams
    make: PlantMaker
    ranges_m: tuple[float, ...]
    policy_id: str
    policy_folder: Path


def run(
    *,
    mode: Literal["2d", "3d"],
    plant: str = "twin",
    targets: str = "7.5:10:0.5",
    throws: int = 200,
    seed: int = 0,
    unit_seed: int = 0,
    json: Path | None = None,
    plot: Path | None = None,
    policies: Path = Path("policies"),
    policy: Path | None = None,
    calibration: Path | None = None,
    profile: Path | None = None,
    card: bool = False,
) -> int:
    """Throw many times at targets on the x axis and print how accurately the loads land.

    Every throw starts from a random pose that the machine could be in: in 2d the arm is aligned with the
    target, in 3d the cabin stands anywhere. Errors are in the frame of the throw: downrange positive
    beyond the target, crossrange positive to its left. Throws run side by side, faster than real time.

    Example: downrange evaluate --mode 2d --plant virtual --targets 7.5:10:0.5 --json accuracy.json

    Args:
        mode: 2d throws within the arm's plane, 3d turns the cabin as well.
        plant: twin (velocity response), virtual (pressure-level stand-in for a real machine), or
            package.module:Class of your own simulated machine.
        targets: ranges in metres from the slew axis, FIRST:LAST:STEP with both ends, or 8,8.5,9.
        throws: throws at each target.
        seed: of start poses and of everything random in the plant; the same seed gives the same throws.
        unit_seed: which machine of its kind the plant is; 0 is the nominal one.
        json: write the result to this file.
        plot: write the plot to this file (.png, .svg or .pdf).
        policies: folder of policy versions; its active.json names the one of each mode.
        policy: folder of one policy version (policy.onnx and card.json), instead of the active one.
        calibration: valve calibration of the machine; measured on the plant if left out.
        profile: twin profile, for --plant twin; nominal if left out.
        card: also write the result onto the policy's card, in place of the last one on this plant.
    """
    if plot is not None:
        check_plot_path(plot)
    if json is not None and not json.parent.is_dir():
        raise UsageError(f"cannot write {json}: the folder {json.parent} does not exist")
    campaign = open_campaign(
        mode=Mode(mode),
        plant=plant,
        targets=targets,
        throws=throws,
        seed=seed,
        unit_seed=unit_seed,
        policies=policies,
        policy=policy,
        calibration=calibration,
        profile=profile,
    )
    started = perf_counter()
    results = _throw(campaign, throws, seed)
    seconds = perf_counter() - started
    report = AccuracyReport(
        mode=mode,
        plant=plant,
        policy=campaign.policy_id,
        seed=seed,
        seconds=seconds,
        real_time_factor=sum(r.simulated_s for part in results for r in part) / seconds,
        targets=[target_accuracy(r, p) for r, p in zip(campaign.ranges_m, results, strict=True)],
    )
    print(accuracy_table(report))
    bad = bad_throws_text([r for part in results for r in part])
    if bad:
        print(bad)
    if json is not None:
        json.write_text(json_text.dumps(report, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    if card:
        add_evaluation(campaign.policy_folder, _card_entry(campaign, report, unit_seed))
    if plot is not None:
        _plot(plot, campaign, results, f"plant {plant}, unit {unit_seed}, seed {seed}")
    return 0


def _card_entry(campaign: Campaign, report: AccuracyReport, unit_seed: int) -> dict[str, Any]:
    """The report, and what a reader of the card must know beside it."""
    of_policy = load_card(campaign.policy_folder).policy_sha256
    registered = [r.policy_sha256 for r in campaign.params.calibration.registrations]
    return {**report, "unit_seed": unit_seed, "is_registered": of_policy in registered}


def _plot(
    path: Path, campaign: Campaign, results: Sequence[Sequence[ThrowResult]], where: str
) -> None:
    scatters = [
        TargetScatter(range_m, *landing_errors(part), len(part))
        for range_m, part in zip(campaign.ranges_m, results, strict=True)
    ]
    title = f"{campaign.params.mode.value.upper()} throws, policy {campaign.policy_id}, {where}"
    plot_accuracy(path, scatters, title=title, reach_m=campaign.spec.static_reach_m)


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
) -> Campaign:
    """Check every option before anything is simulated.

    Raises:
        UsageError: an option that cannot work.
        PolicyError: no policy, or one that does not fit.
        RefusedError: a target that the policy was not made for.
    """
    ranges = parse_targets(targets)
    if throws < 1:
        raise UsageError(f"--throws {throws}: at least 1 throw at each target is needed")
    if seed < 0 or unit_seed < 0:
        raise UsageError(f"--seed {seed} --unit-seed {unit_seed}: seeds are 0 or more")
    spec = load_spec()
    runner = open_policy(mode, policies, policy, spec)
    for range_m in ranges:
        check_target(runner.card, Target(x_m=range_m, y_m=0.0))
    twin_profile = None if profile is None else load_profile(profile)
    make = plant_maker(
        plant,
        unit_seed=unit_seed,
        profile=twin_profile,
        calibration=None if calibration is None else load_calibration(calibration),
        spec=spec,
    )
    valves = plant_calibration(plant, make, unit_seed=unit_seed, spec=spec, path=calibration)
    if plant == "twin":
        # A registration answers for the machine's misses; the twin has its own.
        valves = valves.without_registrations()
    params = ControlParams(spec=spec, calibration=valves, mode=mode, policy=runner)
    folder = policy if policy is not None else find_policy(policies, mode)
    return Campaign(spec, params, make, ranges, runner.card.policy_id, folder)


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


def _checked_ranges(ranges_m: tuple[float, ...], text: str) -> tuple[float, ...]:
    if any(range_m <= 0.0 or range_m > 60.0 for range_m in ranges_m):
        raise UsageError(f"--targets '{text}': ranges lie between 0 and 60 m")
    return ranges_m


def progress_line(what: str, of: str = "throws") -> Callable[[int, int], None]:
    """Show throws (or others) done on stderr: in place on a terminal, else a line every tenth."""
    live = sys.stderr.isatty()
    shown = -1

    def show(done: int, total: int) -> None:
        nonlocal shown
        step = done * 10 // max(total, 1)
        if live:
            end = "\n" if done == total else ""
            print(f"\r{what}: {done} of {total} {of}", end=end, file=sys.stderr, flush=True)
        elif step != shown:
            print(f"{what}: {done} of {total} {of}", file=sys.stderr, flush=True)
        shown = step

    return show


def _throw(campaign: Campaign, throws: int, seed: int) -> list[list[ThrowResult]]:
    """Results per target."""
    ranges = np.repeat(np.asarray(campaign.ranges_m), throws)
    target_m = np.zeros((ranges.size, 3))
    target_m[:, 0] = ranges
    rng = np.random.default_rng(seed)
    starts = sample_starts(campaign.spec, campaign.params.mode, target_m, rng)
    batches = math.ceil(ranges.size / MAX_BATCH_COUNT)
    plant = campaign.make(math.ceil(ranges.size / batches))
    try:
        results = run_throws(
            plant, campaign.params, target_m, starts, seed, progress=progress_line("evaluate")
        )
    finally:
        plant.close()
    return [results[i : i + throws] for i in range(0, len(results), throws)]
