"""`downrange evaluate`: accuracy over many throws in a simulated plant, by the paper's protocol."""

import json as json_text
import secrets
from pathlib import Path
from typing import Literal, NamedTuple

from evaluation.accuracy_campaign import (
    DEFAULT_TARGETS,
    plot_campaign,
    throw_accuracy,
    write_card,
)
from evaluation.accuracy_report.report_campaign import ReportOptions, write_report
from evaluation.campaign_registration import open_registered
from evaluation.campaigns import CampaignOptions
from evaluation.execution.executor import Executor
from evaluation.execution.executor_choice import open_executor
from evaluation.unit_accuracy import FIRST_UNIT
from machine.conventions import DEFAULT_PACE_RATIO
from machine.errors import UsageError
from sim_twin.throws.accuracy import accuracy_table, bad_throws_text
from sim_twin.throws.plots import check_plot_path


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
    scheduler: str | None = None,
) -> int:
    """Throw many times at targets on the x axis and print how accurately the loads land.

    Every throw starts from a random pose that the machine could be in: in 2d the arm is aligned with the
    target, in 3d the cabin stands anywhere. A machine without --calibration is measured and registered first,
    as at commissioning; the nominal twin is not. Errors are in the frame of the throw: downrange positive
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
        calibration: valve calibration and registrations, from downrange calibrate; measured if left out.
        profile: twin profile, for --plant twin; nominal if left out.
        report: write report.html and report.json with the paper's plots, intervals, the logs of failed throws
            and sensitivities into this folder.
        units: for a report, number of further machines outside training, each registered by itself.
        first_unit: number of the first of them.
        trainings: for a report, folders of further policy versions: all of a mode in one table.
        jobs: processes at work side by side; the result is the same.
        scheduler: Dask scheduler, as tcp://HOST:8786, whose workers are used; they see the same files.
        card: also write the result onto the policy's card, in place of the last one on this plant.
    """
    is_drawn = report is not None and seed is None
    options = CampaignOptions(
        plant, targets, throws, secrets.randbelow(100_000) if is_drawn else seed or 0, unit_seed,
        policies, policy, calibration, profile, pace, heights,
    )  # fmt: skip
    outputs = Outputs(json, plot, card)
    if report is None and (units or trainings):
        raise UsageError("--units and --trainings go with --report")
    if report is not None and outputs != Outputs():
        raise UsageError("--report writes its own JSON and plots: leave --json, --plot, --card out")
    with open_executor(jobs, scheduler) as executor:
        if report is None:
            return _evaluate(options, mode, executor, outputs)
        modes = ["2d", "3d"] if mode == "both" else [mode]
        more = ReportOptions(units, first_unit, trainings, executor, is_drawn)
        for line in write_report(report, modes, options, more):
            print(line)
    return 0


class Outputs(NamedTuple):
    """Where the result of a campaign goes besides the terminal."""

    json: Path | None = None
    plot: Path | None = None
    card: bool = False


def _evaluate(options: CampaignOptions, mode: str, executor: Executor, outputs: Outputs) -> int:
    """Throw one campaign, print its accuracy and write the outputs."""
    _check_outputs(mode, options.heights, outputs)
    opened = open_registered(options, mode, DEFAULT_TARGETS)
    print(f"machine: {opened.registration_note}", flush=True)
    found = throw_accuracy(options, mode, opened, executor)
    print(accuracy_table(found.accuracy))
    bad = bad_throws_text([result for part in found.results for result in part])
    if bad:
        print(bad)
    if outputs.json is not None:
        text = json_text.dumps(found.accuracy, indent=2, allow_nan=False)
        outputs.json.write_text(text + "\n", encoding="utf-8")
    if outputs.card:
        write_card(found, options.unit_seed)
    if outputs.plot is not None:
        plot_campaign(found, outputs.plot, options.unit_seed)
    return 0


def _check_outputs(mode: str, heights: str, outputs: Outputs) -> None:
    """Refuse files that cannot be written, before anything is thrown.

    Raises:
        UsageError: a mode, plot or folder that does not fit.
    """
    if mode == "both":
        raise UsageError("--mode both goes with --report; choose 2d or 3d")
    if outputs.plot is not None:
        check_plot_path(outputs.plot)
        if (count := len(heights.split(","))) > 1:
            raise UsageError(f"--plot draws one height, --heights names {count}")
    json = outputs.json
    if json is not None and not json.parent.is_dir():
        raise UsageError(f"cannot write {json}: the folder {json.parent} does not exist")
