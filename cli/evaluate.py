"""`downrange evaluate`: accuracy over many throws in a simulated plant, by the paper's protocol."""

import json as json_text
import secrets
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Literal, NamedTuple

from cli.campaigns import (
    Campaign,
    CampaignOptions,
    batch_count,
    by_target,
    open_with,
    throw_batches,
)
from cli.evaluation_report import More, write_report
from cli.registration import is_registered, open_aimed
from cli.report_parts import FIRST_UNIT
from cli.side_by_side import side_by_side
from machine.conventions import DEFAULT_PACE_RATIO
from machine.errors import UsageError
from machine.policy_card import add_evaluation
from sim_twin.throws.accuracy import (
    AccuracyReport,
    accuracy_table,
    bad_throws_text,
    landing_errors,
    target_accuracy,
)
from sim_twin.throws.campaign import ThrowResult
from sim_twin.throws.plots import TargetScatter, check_plot_path, plot_accuracy

DEFAULT_TARGETS = "7.5:10:0.5"


def run(
    *,
    mode: Literal["2d", "3d", "both"],
    plant: str = "twin",
    targets: str | None = None,
    throws: int = 200,
    seed: int | None = None,
    unit_seed: int = 0,
    pace: float = DEFAULT_PACE_RATIO,
    heights: str = "0",
    json: Path | None = None,
    plot: Path | None = None,
    policies: Path = Path("policies"),
    policy: Path | None = None,
    calibration: Path | None = None,
    profile: Path | None = None,
    card: bool = False,
    report: Path | None = None,
    units: int = 0,
    first_unit: int = FIRST_UNIT,
    trainings: tuple[Path, ...] = (),
    jobs: int = 2,
) -> int:
    """Throw many times at targets on the x axis and print how accurately the loads land.

    Every throw starts from a random pose that the machine could be in: in 2d the arm is aligned with the
    target, in 3d the cabin stands anywhere. A machine without --calibration is measured and registered first,
    as at its first start; the nominal twin is not. Errors are in the frame of the throw: downrange positive
    beyond the target, crossrange positive to its left. Throws run side by side, faster than real time.

    Example: downrange evaluate --mode 2d --plant virtual --targets 7.5:10:0.5 --json accuracy.json

    The whole report: downrange evaluate --mode both --plant virtual --report report --throws 200

    Args:
        mode: 2d throws within the arm's plane, 3d turns the cabin as well; both, for a report.
        plant: twin (velocity response), virtual (pressure-level stand-in for a real machine), or
            package.module:Class of your own simulated machine.
        targets: ranges in metres from the slew axis, FIRST:LAST:STEP with both ends, or 8,8.5,9; the paper's
            if left out, 7.5:10:0.5; in a report those and on to 10.87, in 3d from 7.
        throws: throws at each target.
        seed: of start poses and of everything random in the plant; the same seed gives the same throws. Left
            out: 0; in a report one drawn at its start, so that no policy can have been chosen by it.
        unit_seed: which machine of its kind the plant is; 0 is the nominal one.
        pace: 0 careful .. 1 fast, for policies that were trained with a pace.
        heights: of the target surface above ground, metres, as in -1,0,2; every range at every height.
        json: write the result to this file.
        plot: write the plot to this file (.png, .svg or .pdf).
        policies: folder of policy versions; its active.json names the one of each mode.
        policy: folder of one policy version (policy.onnx and card.json), instead of the active one.
        calibration: valve calibration and registrations of the machine, from downrange calibrate; measured on
            the plant if left out.
        profile: twin profile, for --plant twin; nominal if left out.
        report: write report.html and report.json with the paper's plots, intervals, the logs of failed throws
            and what a miss hangs on into this folder.
        units: for a report, this many machines too that no training has seen, each registered by itself.
        first_unit: number of the first of them.
        trainings: for a report, folders of further policy versions: all of a mode in one table.
        jobs: processes at work side by side; the result is the same.
        card: also write the result onto the policy's card, in place of the last one on this plant.
    """
    is_drawn = report is not None and seed is None
    fixed_seed = secrets.randbelow(100_000) if is_drawn else seed or 0
    options = CampaignOptions(
        plant, targets, throws, fixed_seed, unit_seed, policies, policy, calibration, profile, pace,
        heights,
    )  # fmt: skip
    if jobs < 1:
        raise UsageError(f"--jobs {jobs}: at least 1")
    if report is not None:
        _check_report(Outputs(json, plot, card))
        modes = [mode] if mode != "both" else ["2d", "3d"]
        return write_report(
            report, modes, options, More(units, first_unit, trainings, jobs, is_drawn)
        )
    if units or trainings:
        raise UsageError("--units and --trainings go with --report")
    return _evaluate(options, mode, Outputs(json, plot, card), jobs)


class Outputs(NamedTuple):
    """Where the result goes besides the terminal."""

    json: Path | None
    plot: Path | None
    card: bool


def _check_report(outputs: Outputs) -> None:
    if outputs.json is not None or outputs.plot is not None or outputs.card:
        raise UsageError("--report writes its own JSON and plots: leave --json, --plot, --card out")


def _evaluate(options: CampaignOptions, mode: str, outputs: Outputs, jobs: int) -> int:
    """One campaign."""
    _check_outputs(mode, options.heights, outputs.json, outputs.plot)
    campaign, aim = open_aimed(options, mode, DEFAULT_TARGETS)
    print(f"machine: {aim}", flush=True)
    started = perf_counter()
    known = options._replace(tables=campaign.params.calibration)
    batches = range(batch_count(campaign, options.throws))
    tasks = [partial(_batches, known, mode, batches[k : k + 1]) for k in batches]
    if jobs == 1:
        tasks = [partial(_batches, known, mode, batches)]
    thrown = side_by_side(tasks, jobs, "evaluate")
    results = by_target([result for part in thrown for result in part], options.throws)
    accuracy = _accuracy(campaign, options, results, perf_counter() - started)
    _write_json(outputs.json, accuracy)
    if outputs.card:
        add_evaluation(campaign.policy_folder, {**accuracy, "unit_seed": options.unit_seed})
    if outputs.plot is not None:
        words = "registered" if accuracy["is_registered"] else "not registered"
        where = f"plant {options.plant}, unit {options.unit_seed}, {words}, seed {options.seed}"
        _plot(outputs.plot, campaign, results, where)
    return 0


def _batches(options: CampaignOptions, mode: str, batches: range) -> list[ThrowResult]:
    """Some batches of a campaign, in a process of their own."""
    campaign = open_with(options, mode, DEFAULT_TARGETS)
    return throw_batches(campaign, options.throws, options.seed, batches)


def _check_outputs(mode: str, heights: str, json: Path | None, plot: Path | None) -> None:
    """Refuse what cannot be written, before anything is thrown."""
    if mode == "both":
        raise UsageError("--mode both goes with --report; choose 2d or 3d")
    if plot is not None:
        check_plot_path(plot)
        if len(campaign_heights := heights.split(",")) > 1:
            raise UsageError(f"--plot draws one height, --heights names {len(campaign_heights)}")
    if json is not None and not json.parent.is_dir():
        raise UsageError(f"cannot write {json}: the folder {json.parent} does not exist")


def _write_json(path: Path | None, accuracy: AccuracyReport) -> None:
    if path is not None:
        text = json_text.dumps(accuracy, indent=2, allow_nan=False)
        path.write_text(text + "\n", encoding="utf-8")


def _accuracy(
    campaign: Campaign,
    options: CampaignOptions,
    results: Sequence[Sequence[ThrowResult]],
    seconds: float,
) -> AccuracyReport:
    """The result, printed."""
    accuracy = AccuracyReport(
        mode=campaign.params.mode.value,
        plant=options.plant,
        policy=campaign.policy_id,
        is_registered=is_registered(campaign),
        seed=options.seed,
        seconds=seconds,
        real_time_factor=sum(r.simulated_s for part in results for r in part) / seconds,
        targets=[
            target_accuracy(range_m, part, height_m)
            for (range_m, height_m), part in zip(campaign.places, results, strict=True)
        ],
    )
    print(accuracy_table(accuracy))
    bad = bad_throws_text([r for part in results for r in part])
    if bad:
        print(bad)
    return accuracy


def _plot(
    path: Path, campaign: Campaign, results: Sequence[Sequence[ThrowResult]], where: str
) -> None:
    scatters = [
        TargetScatter(range_m, *landing_errors(part), len(part))
        for (range_m, _), part in zip(campaign.places, results, strict=True)
    ]
    title = f"{campaign.params.mode.value.upper()} throws, policy {campaign.policy_id}, {where}"
    plot_accuracy(path, scatters, title=title, reach_m=campaign.spec.static_reach_m)
