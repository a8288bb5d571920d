"""Campaigns of the report with one machine in one mode: targets, sensitivity, paces, heights, policies."""

from collections.abc import Sequence
from pathlib import Path
from time import perf_counter
from typing import Any

from evaluation.campaign_registration import is_registered, open_registered
from evaluation.campaigns import (
    Campaign,
    CampaignOptions,
    campaign_starts,
    open_with,
    throw_campaign,
)
from evaluation.conditions import ConditionRow, condition_rows, height_rows, pace_rows
from evaluation.measures import ModeEvaluation, TrainingRow, mode_evaluation, target_row
from evaluation.paper import TARGETS
from evaluation.progress import progress_line
from evaluation.requirements import examined_range_m
from evaluation.sensitivity import EffectPlantMaker, FactorShift, measure_sensitivity
from evaluation.spread import measure_spread_parts
from machine.policy_card import load_card
from runtime.driver import SimulatedDriver
from sim_twin.effects.effect import Effect
from sim_twin.faults.fault import Fault
from sim_twin.throws.campaign import ThrowResult
from sim_twin.throws.plants import TWIN, VIRTUAL
from sim_twin.throws.throw_logs import FailureRecorder, LogContext
from sim_twin.twin.profile import TwinProfile, load_profile, nominal_profile
from sim_twin.twin.twin import Twin
from sim_twin.virtual_machine import Condition, VirtualMachine

MAX_LOG_COUNT = 20
"""Logs of failed throws that are kept."""
SENSITIVITY_THROW_COUNT = 40
MAX_TRAINING_THROW_COUNT = 60
"""Throws per target with each other policy."""


def throw_paces(mode: str, options: CampaignOptions) -> list[ConditionRow]:
    """Throw at paces from careful to fast."""
    campaign = open_with(options, mode, TARGETS[mode])
    return pace_rows(campaign, options.throws, options.seed)


def throw_heights(mode: str, options: CampaignOptions) -> list[ConditionRow]:
    """Throw at targets on the ground, below it and above it."""
    campaign = open_with(options, mode, TARGETS[mode])
    return height_rows(campaign, options.throws, options.seed)


def throw_mode(
    mode: str, options: CampaignOptions, registration_note: str, folder: Path
) -> ModeEvaluation:
    """Throw at the mode's targets, repeatedly from the same starts, and with factors changed.

    Args:
        mode: 2d or 3d.
        options: with the machine's calibration.
        registration_note: state of the machine's registration, for people.
        folder: of the report; logs of failed throws are written to FOLDER/logs.
    """
    campaign = open_with(options, mode, TARGETS[mode])
    context = LogContext(
        machine_id=f"{options.plant}-{options.unit_seed}",
        throw_prefix=f"{mode}-s{options.seed}",
        twin_profile_version_count=0,
        out_dir=folder / "logs",
        pace_ratio=campaign.pace_ratio,
    )
    recorder = FailureRecorder(campaign.params, context, MAX_LOG_COUNT)
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
    part = mode_evaluation(
        about, campaign.ranges_m, results, logs, folder, _sensitivity(campaign, options, results)
    )
    at_m = part.sensitivity_range_m
    return part.model_copy(
        update={
            "spread": measure_spread_parts(campaign, at_m, options.seed + 1) if at_m else None,
            "is_registered": is_registered(campaign),
            "aim": registration_note,
        }
    )


def throw_policy(mode: str, options: CampaignOptions, folder: Path) -> tuple[TrainingRow, ...]:
    """Throw with another policy of the mode, registered by itself; empty for a policy of the other mode.

    Targets and starts are the same for every policy.
    """
    card = load_card(folder)
    if card.mode.value != mode:
        return ()
    here = options._replace(policy=folder, calibration=None, tables=None, heights="0")
    campaign = open_registered(here, mode, TARGETS[mode]).campaign
    throws = min(options.throws, MAX_TRAINING_THROW_COUNT)
    return tuple(
        TrainingRow(
            policy=card.policy_id,
            training_seed=card.training.seed_count,
            step_count=card.training.environment_step_count,
            is_registered=is_registered(campaign),
            row=row,
        )
        for row in condition_rows(campaign, throws, options.seed)
    )


def _sensitivity(
    campaign: Campaign, options: CampaignOptions, results: Sequence[Sequence[ThrowResult]]
) -> tuple[float | None, Sequence[FactorShift], str]:
    """Range, shifts, and a note on how they were measured."""
    make = _maker(campaign, options)
    rows = [target_row(r, part) for r, part in zip(campaign.ranges_m, results, strict=True)]
    range_m = examined_range_m(campaign.params.mode.value, rows)
    if make is None:
        return range_m, (), f"Plant {options.plant} takes no effects: nothing was changed."
    count = min(SENSITIVITY_THROW_COUNT, max(options.throws, 2))
    # Another seed than the campaign's, the same for every factor.
    seed = options.seed + 1
    target_m, starts = campaign_starts(campaign._replace(ranges_m=(range_m,)), count, seed)
    show = progress_line("sensitivity", "runs")
    shifts = measure_sensitivity(make, campaign.params, target_m, starts, seed, show)
    where = "the twin" if options.plant == TWIN else f"virtual machine {options.unit_seed}"
    return range_m, shifts, f"{count} throws a run on {where}."


def _maker(campaign: Campaign, options: CampaignOptions) -> EffectPlantMaker | None:
    """Maker of the plant with effects; None for a plant that takes none."""
    if options.plant == VIRTUAL:

        def virtual(count: int, effects: tuple[Effect, ...]) -> SimulatedDriver:
            faults = tuple(Fault(e.effect, e.joint, e.parameters) for e in effects)
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
    """The profile plus these effects; parameters of an effect that it already has are summed."""
    kept = {(e.effect, e.joint): e for e in profile.effects}
    for effect in effects:
        present = kept.get((effect.effect, effect.joint))
        before = {} if present is None else dict(present.parameters)
        added = {name: before.get(name, 0.0) + v for name, v in effect.parameters.items()}
        kept[effect.effect, effect.joint] = Effect(
            effect=effect.effect, joint=effect.joint, parameters={**before, **added}
        )
    return profile.model_copy(update={"effects": tuple(kept.values())})
