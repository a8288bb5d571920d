"""The report of `downrange evaluate --report`: both campaigns, sensitivities, logs of failures, one page."""

from collections.abc import Sequence
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

from cli.campaigns import (
    Campaign,
    CampaignOptions,
    campaign_starts,
    progress_line,
    throw_campaign,
)
from cli.conditions import height_rows, pace_rows, table
from cli.registration import Aimed, is_registered, open_aimed
from cli.report_parts import FIRST_UNIT, check_parts, repeated_starts, training_rows, unit_rows
from cli.wide_unit import examine
from diagnosis.evaluation.goals import examined_range_m, widest
from diagnosis.evaluation.measures import ModeEvaluation, evaluation, target_row
from diagnosis.evaluation.page import evaluation_html
from diagnosis.evaluation.paper import TARGETS
from diagnosis.evaluation.sensitivity import EffectPlantMaker, FactorShift, sensitivity
from machine.errors import UsageError
from runtime.driver import SimulatedDriver
from sim_twin.effects.effect import Effect
from sim_twin.faults.fault import PlantEffect
from sim_twin.throws.campaign import ThrowResult
from sim_twin.throws.plants import TWIN, VIRTUAL
from sim_twin.throws.throw_logs import FailureRecorder, LogContext
from sim_twin.twin.profile import TwinProfile, load_profile, nominal_profile
from sim_twin.twin.twin import Twin
from sim_twin.virtual.virtual_machine import Condition, VirtualMachine

MAX_LOGS = 20
SENSITIVITY_THROWS = 40


class More(NamedTuple):
    """What is thrown beyond the campaign if it is asked for."""

    unit_count: int = 0
    first_unit: int = FIRST_UNIT
    trainings: tuple[Path, ...] = ()
    """Folders of policy versions."""


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
    machines = [open_aimed(flat, mode, TARGETS[mode]) for mode in modes]
    room = MAX_LOGS
    parts: list[ModeEvaluation] = []
    for mode, aimed in zip(modes, machines, strict=True):
        own = aimed.campaign.policy_folder
        part = _with_more(_part(mode, aimed, flat, folder, room), flat, more, own)
        room -= sum(failure.log is not None for failure in part.failures)
        parts.append(part)
        _print(part)
    html, data = folder / "report.html", folder / "report.json"
    joined = ",\n".join(part.model_dump_json(indent=2) for part in parts)
    try:
        data.write_text(f'{{"modes": [\n{joined}\n]}}\n', encoding="utf-8")
        html.write_text(
            evaluation_html(parts, machines[0].campaign.spec.static_reach_m), encoding="utf-8"
        )
    except OSError as error:
        raise UsageError(f"cannot write {error.filename}: {error.strerror}") from error
    print(f"wrote {html}, {data}")
    return 0


def _part(
    mode: str, aimed: Aimed, options: CampaignOptions, folder: Path, room: int
) -> ModeEvaluation:
    """One mode thrown and measured."""
    campaign = aimed.campaign
    context = LogContext(
        machine_id=f"{options.plant}-{options.unit_seed}",
        throw_prefix=f"{mode}-s{options.seed}",
        twin_profile_version_count=0,
        out_dir=folder / "logs",
        pace_ratio=campaign.pace_ratio,
    )
    recorder = FailureRecorder(campaign.params, context, room)
    started = perf_counter()
    results = throw_campaign(campaign, options.throws, options.seed, recorder)
    about: dict[str, Any] = {
        "mode": mode,
        "plant": options.plant,
        "unit_seed": options.unit_seed,
        "policy": campaign.policy_id,
        "seed": options.seed,
        "seconds": perf_counter() - started,
    }
    logs = [stored.path for stored in recorder.stored]
    part = evaluation(
        about, campaign.ranges_m, results, logs, folder, _sensitivity(campaign, options, results)
    )
    at_m = part.sensitivity_range_m
    return part.model_copy(
        update={
            "paces": tuple(pace_rows(campaign, options.throws, options.seed)),
            "heights": tuple(height_rows(campaign, options.throws, options.seed)),
            "spread": repeated_starts(campaign, at_m, options.seed + 1) if at_m else None,
            "is_registered": is_registered(campaign),
            "aim": aimed.words,
        }
    )


def _with_more(
    part: ModeEvaluation, options: CampaignOptions, more: More, own: Path
) -> ModeEvaluation:
    """With other machines and other trainings, beside the policy's `own` where there are any."""
    others = [folder for folder in more.trainings if folder.resolve() != own.resolve()]
    trainings = (own, *others) if more.trainings else ()
    rows = unit_rows(part.mode, options, more.unit_count, more.first_unit)
    part = part.model_copy(
        update={
            "units": rows,
            "trainings": training_rows(part.mode, options, trainings, TARGETS[part.mode]),
        }
    )
    chosen = widest(part)
    if chosen is None or options.plant != VIRTUAL:
        return part
    return part.model_copy(update={"wide_unit": examine(part.mode, options, chosen)})


def _sensitivity(
    campaign: Campaign, options: CampaignOptions, results: Sequence[Sequence[ThrowResult]]
) -> tuple[float | None, Sequence[FactorShift], str]:
    """Where, what shifts, and on what."""
    make = _maker(campaign, options)
    rows = [target_row(r, part) for r, part in zip(campaign.ranges_m, results, strict=True)]
    range_m = examined_range_m(campaign.params.mode.value, rows)
    if make is None:
        return range_m, (), f"Plant {options.plant} takes no effects: nothing was changed."
    count = min(SENSITIVITY_THROWS, max(options.throws, 2))
    # Other throws than the campaign's, the same for every factor.
    seed = options.seed + 1
    target_m, starts = campaign_starts(campaign._replace(ranges_m=(range_m,)), count, seed)
    show = progress_line("sensitivity", "runs")
    shifts = sensitivity(make, campaign.params, target_m, starts, seed, show)
    where = "the twin" if options.plant == TWIN else f"virtual machine {options.unit_seed}"
    return range_m, shifts, f"{count} throws a run on {where}."


def _maker(campaign: Campaign, options: CampaignOptions) -> EffectPlantMaker | None:
    """How the plant is made with effects; None when it cannot be."""
    if options.plant == VIRTUAL:

        def virtual(count: int, effects: tuple[Effect, ...]) -> SimulatedDriver:
            faults = tuple(PlantEffect(e.effect, e.joint, e.parameters) for e in effects)
            condition = Condition(effects=faults)
            return VirtualMachine(count=count, unit_seed=options.unit_seed, condition=condition)

        return virtual
    if options.plant != TWIN:
        return None
    profile = (
        nominal_profile(campaign.spec) if options.profile is None else load_profile(options.profile)
    )

    def twin(count: int, effects: tuple[Effect, ...]) -> SimulatedDriver:
        return Twin(
            count=count,
            profile=_with_effects(profile, effects),
            calibration=campaign.params.calibration,
        )

    return twin


def _with_effects(profile: TwinProfile, effects: tuple[Effect, ...]) -> TwinProfile:
    """The profile with these effects on top; an effect that it has already is added to."""
    kept = {(e.effect, e.joint): e for e in profile.effects}
    for effect in effects:
        own = kept.get((effect.effect, effect.joint))
        before = {} if own is None else dict(own.parameters)
        added = {name: before.get(name, 0.0) + v for name, v in effect.parameters.items()}
        kept[effect.effect, effect.joint] = Effect(
            effect=effect.effect, joint=effect.joint, parameters={**before, **added}
        )
    return profile.model_copy(update={"effects": tuple(kept.values())})


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
