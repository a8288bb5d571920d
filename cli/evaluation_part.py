"""What a report throws with one machine in one mode: the campaign, what a miss hangs on, paces, heights."""

from collections.abc import Sequence
from pathlib import Path
from time import perf_counter
from typing import Any

from cli.campaigns import (
    Campaign,
    CampaignOptions,
    campaign_starts,
    open_with,
    progress_line,
    throw_campaign,
)
from cli.conditions import height_rows, pace_rows
from cli.registration import is_registered
from cli.report_parts import repeated_starts
from diagnosis.evaluation.conditions import ConditionRow
from diagnosis.evaluation.goals import examined_range_m
from diagnosis.evaluation.measures import ModeEvaluation, evaluation, target_row
from diagnosis.evaluation.paper import TARGETS
from diagnosis.evaluation.sensitivity import EffectPlantMaker, FactorShift, sensitivity
from machine.policy_card import load_card
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


def thrown_paces(mode: str, options: CampaignOptions) -> list[ConditionRow]:
    """Careful to fast."""
    campaign = open_with(options, mode, TARGETS[mode])
    return pace_rows(campaign, options.throws, options.seed)


def thrown_heights(mode: str, options: CampaignOptions) -> list[ConditionRow]:
    """On the ground and off it."""
    campaign = open_with(options, mode, TARGETS[mode])
    return height_rows(campaign, options.throws, options.seed)


def thrown_part(mode: str, options: CampaignOptions, aim: str, folder: Path) -> ModeEvaluation:
    """The campaign at the mode's targets, throws repeated from the same starts, and what a miss hangs on.

    Args:
        mode: 2d or 3d.
        options: with the machine's calibration in them.
        aim: how the machine aims, in words.
        folder: of the report; logs of throws that ended badly go into FOLDER/logs.
    """
    campaign = open_with(options, mode, TARGETS[mode])
    context = LogContext(
        machine_id=f"{options.plant}-{options.unit_seed}",
        throw_prefix=f"{mode}-s{options.seed}",
        twin_profile_version_count=0,
        out_dir=folder / "logs",
        pace_ratio=campaign.pace_ratio,
    )
    recorder = FailureRecorder(campaign.params, context, MAX_LOGS)
    started = perf_counter()
    results = throw_campaign(campaign, options.throws, options.seed, recorder)
    about: dict[str, Any] = {
        "mode": mode,
        "plant": options.plant,
        "unit_seed": options.unit_seed,
        "policy": campaign.policy_id,
        "policy_sha256": load_card(campaign.policy_folder).policy_sha256,
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
            "spread": repeated_starts(campaign, at_m, options.seed + 1) if at_m else None,
            "is_registered": is_registered(campaign),
            "aim": aim,
        }
    )


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
