"""The report of `downrange evaluate --report`: everything that is thrown, its data and one page."""

from collections.abc import Callable, Sequence
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

from cli.campaigns import CampaignOptions
from cli.conditions import table
from cli.evaluation_part import thrown_heights, thrown_paces, thrown_part
from cli.registration import open_aimed
from cli.report_parts import FIRST_UNIT, check_parts, training_rows, unit_row
from cli.side_by_side import side_by_side
from cli.units import NOMINAL_UNIT
from cli.wide_unit import examine
from diagnosis.evaluation.goals import widest
from diagnosis.evaluation.measures import ModeEvaluation
from diagnosis.evaluation.page import evaluation_html
from diagnosis.evaluation.paper import TARGETS
from machine.calibration import ValveCalibration
from machine.conventions import Mode
from machine.errors import UsageError
from machine.spec import load_spec
from runtime.control.policy import find_policy
from sim_twin.throws.plants import VIRTUAL


class More(NamedTuple):
    """What is thrown beyond the campaign if it is asked for, and by how many processes."""

    unit_count: int = 0
    first_unit: int = FIRST_UNIT
    trainings: tuple[Path, ...] = ()
    """Folders of policy versions."""
    jobs: int = 1
    seed_is_drawn: bool = False
    """The seed was drawn when the report began; else it was given."""


def write_report(folder: Path, modes: Sequence[str], options: CampaignOptions, more: More) -> int:
    """Throw, and write FOLDER/report.html, FOLDER/report.json and FOLDER/logs.

    Raises:
        UsageError: options that do not go together, or a folder that cannot be written.
    """
    if options.policy is not None and len(modes) > 1:
        raise UsageError("--policy names one policy, of one mode: choose --mode 2d or 3d with it")
    check_parts(options, more.unit_count, more.first_unit, more.trainings)
    try:
        (folder / "logs").mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"cannot make the folder {folder}: {error.strerror}") from error
    # Heights have a section of their own.
    flat = options._replace(heights="0")
    parts = _thrown(modes, flat, folder, more)
    for part in parts:
        _print(part)
    html, data = folder / "report.html", folder / "report.json"
    joined = ",\n".join(part.model_dump_json(indent=2) for part in parts)
    try:
        data.write_text(f'{{"modes": [\n{joined}\n]}}\n', encoding="utf-8")
        html.write_text(evaluation_html(parts, load_spec().static_reach_m), encoding="utf-8")
    except OSError as error:
        raise UsageError(f"cannot write {error.filename}: {error.strerror}") from error
    print(f"wrote {html}, {data}")
    return 0


def _thrown(
    modes: Sequence[str], options: CampaignOptions, folder: Path, more: More
) -> list[ModeEvaluation]:
    """Every mode: its machine registered, then everything thrown side by side, then the widest machine."""
    aims = side_by_side([partial(_aim, m, options) for m in modes], more.jobs, "registration")
    tasks: list[dict[str, list[Callable[[], Any]]]] = [
        _tasks(mode, options._replace(tables=tables), words, folder, more)
        for mode, (tables, words) in zip(modes, aims, strict=True)
    ]
    # Kind by kind: the campaigns themselves take longest and come first.
    every = [task for kind in tasks[0] for of_mode in tasks for task in of_mode[kind]]
    thrown = iter(side_by_side(every, more.jobs, "report"))
    found: list[dict[str, list[Any]]] = [{} for _ in tasks]
    for kind in tasks[0]:
        for known, of_mode in zip(found, tasks, strict=True):
            known[kind] = [next(thrown) for _ in of_mode[kind]]
    parts: list[ModeEvaluation] = []
    for known in found:
        part: ModeEvaluation = known.pop("part")[0]
        units = tuple(known.pop("units"))
        lists = {name: tuple(chain.from_iterable(rows)) for name, rows in known.items()}
        update = {"units": units, "seed_is_drawn": more.seed_is_drawn, **lists}
        parts.append(part.model_copy(update=update))
    return [_with_widest(part, options, more.jobs) for part in parts]


def _aim(mode: str, options: CampaignOptions) -> tuple[ValveCalibration, str]:
    """The machine as it aims, and how, in words."""
    campaign, words = open_aimed(options, mode, TARGETS[mode])
    return campaign.params.calibration, words


def _tasks(
    mode: str, options: CampaignOptions, aim: str, folder: Path, more: More
) -> dict[str, list[Callable[[], Any]]]:
    """What is thrown in a mode, by what it is in the report; each can be done by itself."""
    units = range(more.first_unit, more.first_unit + more.unit_count)
    own = options.policy or find_policy(options.policies, Mode(mode))
    others = [training for training in more.trainings if training.resolve() != own.resolve()]
    return {
        "part": [partial(thrown_part, mode, options, aim, folder)],
        "paces": [partial(thrown_paces, mode, options)],
        "heights": [partial(thrown_heights, mode, options)],
        "units": [
            partial(unit_row, mode, options, unit)
            for unit in ((NOMINAL_UNIT, *units) if units else ())
        ],
        "trainings": [
            partial(training_rows, mode, options, training, TARGETS[mode])
            for training in ((own, *others) if more.trainings else ())
        ],
    }


def _with_widest(part: ModeEvaluation, options: CampaignOptions, jobs: int) -> ModeEvaluation:
    """With what makes the widest of the unseen machines wide, where it can be changed."""
    chosen = widest(part)
    if chosen is None or options.plant != VIRTUAL:
        return part
    return part.model_copy(update={"wide_unit": examine(part.mode, options, chosen, jobs)})


def _print(part: ModeEvaluation) -> None:
    landed = sum(t.landed for t in part.targets)
    thrown = sum(t.throws for t in part.targets)
    speed = f"{part.seconds:.1f} s, {part.real_time_factor:.0f} times faster than real time"
    print(f"{part.mode}: {landed} of {thrown} landed, {speed}\nmachine: {part.aim}")
    for rows in (part.paces, part.heights):
        if rows:
            print(table(rows))
    for shift in part.sensitivity:
        if shift.high_m is not None and shift.high_ci95_m is not None:
            low, high = shift.high_ci95_m
            print(f"  {shift.name} +: {shift.high_m:+.3f} m ({low:+.3f} .. {high:+.3f})")
