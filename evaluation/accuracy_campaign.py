"""The campaign of `downrange evaluate`: accuracy by target, by any executor."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

from evaluation.campaign_registration import RegisteredCampaign, is_registered
from evaluation.campaigns import (
    Campaign,
    CampaignOptions,
    batch_count,
    by_target,
    open_with,
    throw_batches,
)
from evaluation.execution.executor import Executor, run_tasks
from machine.policy_card import add_evaluation
from sim_twin.throws.accuracy import AccuracyReport, landing_errors, target_accuracy
from sim_twin.throws.campaign import ThrowResult
from sim_twin.throws.plots import TargetScatter, plot_accuracy

DEFAULT_TARGETS = "7.5:10:0.5"


class AccuracyCampaign(NamedTuple):
    """A campaign that was thrown."""

    campaign: Campaign
    results: list[list[ThrowResult]]
    """By target."""
    accuracy: AccuracyReport


def throw_accuracy(
    options: CampaignOptions, mode: str, opened: RegisteredCampaign, executor: Executor
) -> AccuracyCampaign:
    """Throw at every target; the result does not depend on the executor."""
    campaign = opened.campaign
    started = perf_counter()
    known = options._replace(tables=campaign.params.calibration)
    batches = range(batch_count(campaign, options.throws))
    tasks = [partial(_throw_batches, known, mode, batches[k : k + 1]) for k in batches]
    if executor.worker_count == 1:
        tasks = [partial(_throw_batches, known, mode, batches)]
    thrown = run_tasks(tasks, executor, "evaluate")
    results = by_target([result for part in thrown for result in part], options.throws)
    accuracy = _accuracy(campaign, options, results, perf_counter() - started)
    return AccuracyCampaign(campaign, results, accuracy)


def _throw_batches(options: CampaignOptions, mode: str, batches: range) -> list[ThrowResult]:
    """Some batches of a campaign, opened anew because a worker process has none."""
    campaign = open_with(options, mode, DEFAULT_TARGETS)
    return throw_batches(campaign, options.throws, options.seed, batches)


def _accuracy(
    campaign: Campaign,
    options: CampaignOptions,
    results: Sequence[Sequence[ThrowResult]],
    seconds: float,
) -> AccuracyReport:
    return AccuracyReport(
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


def write_card(found: AccuracyCampaign, unit_seed: int) -> None:
    """Write the accuracy onto the policy's card, in place of the previous one on this plant."""
    add_evaluation(found.campaign.policy_folder, {**found.accuracy, "unit_seed": unit_seed})


def plot_campaign(found: AccuracyCampaign, path: Path, unit_seed: int) -> None:
    """Draw range plot and landings into a file."""
    campaign, accuracy = found.campaign, found.accuracy
    scatters = [
        TargetScatter(range_m, *landing_errors(part), len(part))
        for (range_m, _), part in zip(campaign.places, found.results, strict=True)
    ]
    registered = "registered" if accuracy["is_registered"] else "not registered"
    where = f"plant {accuracy['plant']}, unit {unit_seed}, {registered}, seed {accuracy['seed']}"
    title = f"{accuracy['mode'].upper()} throws, policy {accuracy['policy']}, {where}"
    plot_accuracy(path, scatters, title=title, reach_m=campaign.spec.static_reach_m)
