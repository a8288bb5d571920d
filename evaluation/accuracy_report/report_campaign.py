"""The campaigns of `downrange evaluate --report`, and the files that it writes."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

from evaluation.accuracy_report.accuracy_page import accuracy_html
from evaluation.campaign_registration import open_registered
from evaluation.campaigns import CampaignOptions
from evaluation.conditions import condition_table
from evaluation.execution.executor import Executor, LocalProcesses, run_tasks
from evaluation.measures import ModeEvaluation
from evaluation.mode_campaign import throw_heights, throw_mode, throw_paces, throw_policy
from evaluation.paper import TARGETS
from evaluation.property_ablation import ablate_properties
from evaluation.requirements import find_widest
from evaluation.unit_accuracy import FIRST_UNIT, NOMINAL_UNIT, unit_row
from machine.calibration import ValveCalibration
from machine.conventions import Mode
from machine.errors import UsageError
from machine.policy_card import load_card
from machine.spec import load_spec
from runtime.control.policy import find_policy
from sim_twin.throws.plants import TWIN, VIRTUAL


class ReportOptions(NamedTuple):
    """What a report throws besides its campaign, and what runs it."""

    unit_count: int = 0
    first_unit: int = FIRST_UNIT
    trainings: tuple[Path, ...] = ()
    """Folders of policy versions."""
    executor: Executor = LocalProcesses()
    seed_is_drawn: bool = False
    """The seed was drawn at the start of the report; else it was given."""


def write_report(
    folder: Path, modes: Sequence[str], options: CampaignOptions, more: ReportOptions
) -> Iterator[str]:
    """Throw, and write FOLDER/report.html, FOLDER/report.json and FOLDER/logs.

    Yields:
        Lines that summarise the results for a terminal.

    Raises:
        UsageError: options that do not go together, or a folder that cannot be written.
    """
    _check_options(modes, options, more)
    try:
        (folder / "logs").mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"cannot make the folder {folder}: {error.strerror}") from error
    # Target heights have a campaign of their own.
    parts = _throw_modes(modes, options._replace(heights="0"), folder, more)
    for part in parts:
        yield from _summary(part)
    html, data = folder / "report.html", folder / "report.json"
    joined = ",\n".join(part.model_dump_json(indent=2) for part in parts)
    try:
        data.write_text(f'{{"modes": [\n{joined}\n]}}\n', encoding="utf-8")
        html.write_text(accuracy_html(parts, load_spec().static_reach_m), encoding="utf-8")
    except OSError as error:
        raise UsageError(f"cannot write {error.filename}: {error.strerror}") from error
    yield f"wrote {html}, {data}"


def _check_options(modes: Sequence[str], options: CampaignOptions, more: ReportOptions) -> None:
    """Refuse what cannot be thrown, before anything is thrown.

    Raises:
        UsageError: a policy for two modes, a number of units below 0, or units of a plant that has only one.
        PolicyError: a folder without a policy.
    """
    if options.policy is not None and len(modes) > 1:
        raise UsageError("--policy names one policy, of one mode: choose --mode 2d or 3d with it")
    if more.unit_count < 0:
        raise UsageError(f"--units {more.unit_count}: 0 or more")
    if more.first_unit < 1:
        raise UsageError(f"--first-unit {more.first_unit}: 1 or more; 0 is the nominal machine")
    if more.unit_count and options.plant == TWIN:
        raise UsageError("--units asks for other machines, the twin is one: use --plant virtual")
    for folder in more.trainings:
        load_card(folder)


def _throw_modes(
    modes: Sequence[str], options: CampaignOptions, folder: Path, more: ReportOptions
) -> list[ModeEvaluation]:
    """Register the machine of every mode, run all campaigns as tasks, then ablate the widest machine."""
    registered = run_tasks(
        [partial(_register, mode, options) for mode in modes], more.executor, "registration"
    )
    tasks: list[dict[str, list[Callable[[], Any]]]] = [
        _tasks(mode, options._replace(tables=tables), note, folder, more)
        for mode, (tables, note) in zip(modes, registered, strict=True)
    ]
    # The main campaigns take longest and are started first.
    every = [task for kind in tasks[0] for of_mode in tasks for task in of_mode[kind]]
    thrown = iter(run_tasks(every, more.executor, "report"))
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
    return [_with_ablation(part, options, more.executor) for part in parts]


def _register(mode: str, options: CampaignOptions) -> tuple[ValveCalibration, str]:
    """The machine's calibration with its registration, and the note on it."""
    campaign, note = open_registered(options, mode, TARGETS[mode])
    return campaign.params.calibration, note


def _tasks(
    mode: str, options: CampaignOptions, note: str, folder: Path, more: ReportOptions
) -> dict[str, list[Callable[[], Any]]]:
    """Campaigns of a mode by the field of the report that they fill; they are independent."""
    units = range(more.first_unit, more.first_unit + more.unit_count)
    evaluated = options.policy or find_policy(options.policies, Mode(mode))
    others = [training for training in more.trainings if training.resolve() != evaluated.resolve()]
    return {
        "part": [partial(throw_mode, mode, options, note, folder)],
        "paces": [partial(throw_paces, mode, options)],
        "heights": [partial(throw_heights, mode, options)],
        "units": [
            partial(unit_row, mode, options, unit)
            for unit in ((NOMINAL_UNIT, *units) if units else ())
        ],
        "trainings": [
            partial(throw_policy, mode, options, training)
            for training in ((evaluated, *others) if more.trainings else ())
        ],
    }


def _with_ablation(
    part: ModeEvaluation, options: CampaignOptions, executor: Executor
) -> ModeEvaluation:
    """Add the ablation of the widest machine; only virtual machines can be changed."""
    chosen = find_widest(part)
    if chosen is None or options.plant != VIRTUAL:
        return part
    return part.model_copy(
        update={"wide_unit": ablate_properties(part.mode, options, chosen, executor)}
    )


def _summary(part: ModeEvaluation) -> Iterator[str]:
    landed = sum(t.landed for t in part.targets)
    thrown = sum(t.throws for t in part.targets)
    speed = f"{part.seconds:.1f} s, {part.real_time_factor:.0f} times faster than real time"
    yield f"{part.mode}: {landed} of {thrown} landed, {speed}"
    yield f"machine: {part.aim}"
    for rows in (part.paces, part.heights):
        if rows:
            yield condition_table(rows)
    for shift in part.sensitivity:
        if shift.high_m is not None and shift.high_ci95_m is not None:
            low, high = shift.high_ci95_m
            yield f"  {shift.name} +: {shift.high_m:+.3f} m ({low:+.3f} .. {high:+.3f})"
