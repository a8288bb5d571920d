"""Registration of a campaign's machine: thrown now, read from a file, or missing."""

import sys
from typing import NamedTuple

from evaluation.campaigns import Campaign, CampaignOptions, open_with
from machine.errors import UsageError
from machine.policy_card import load_card
from sim_twin.commissioning.registration_throws import register_machine, registration_throw_count
from sim_twin.throws.plants import TWIN


class RegisteredCampaign(NamedTuple):
    """A campaign whose machine is registered where it can be."""

    campaign: Campaign
    registration_note: str
    """State of the registration, for people; where it is missing, the reason and the remedy."""


def open_registered(
    options: CampaignOptions, mode: str, default_targets: str
) -> RegisteredCampaign:
    """Open a campaign; without a calibration file the machine is registered as at commissioning.

    A policy whose misses exceed what a registration may correct is thrown without one, so that the
    evaluation shows them.
    """
    campaign = open_with(options, mode, default_targets)
    policy = load_card(campaign.policy_folder).policy_id
    if is_registered(campaign):
        return RegisteredCampaign(campaign, f"aims by its registration in {options.calibration}")
    if options.calibration is not None:
        return RegisteredCampaign(
            campaign,
            f"NOT REGISTERED: {options.calibration} holds no registration of {policy}, so the mean miss "
            f"stays; {_remedy(options)}",
        )
    if options.plant == TWIN:
        return RegisteredCampaign(
            campaign,
            "the nominal twin, not registered: it stands for no machine; --calibration FILE --profile FILE "
            "of `downrange calibrate` throw with a machine's twin, which aims as its previews do",
        )
    count = registration_throw_count(load_card(campaign.policy_folder))
    sys.stderr.write(f"registration: {count} throws with {policy} ...\n")
    sys.stderr.flush()
    try:
        found = register_campaign(campaign, options.seed)
    except UsageError as error:
        return RegisteredCampaign(campaign, f"NOT REGISTERED: {error}")
    note = f"registered with {count} throws of its own, as at a machine's first start"
    return RegisteredCampaign(found, note)


def _remedy(options: CampaignOptions) -> str:
    if options.plant == TWIN:
        return "make one with `downrange calibrate`, this policy being active"
    return (
        "leave --calibration out and the machine is registered before it throws, or make a file with "
        "`downrange calibrate`, this policy being active"
    )


def register_campaign(campaign: Campaign, seed: int) -> Campaign:
    """Register the campaign's machine, whose valves are calibrated, as at commissioning.

    Raises:
        UsageError: no throw landed, or the misses are too large to correct.
    """
    machine = campaign.make(registration_throw_count(load_card(campaign.policy_folder)))
    try:
        found = register_machine(machine, campaign.params, campaign.spec, seed)
    finally:
        machine.close()
    tables = campaign.params.calibration.model_copy(update={"registrations": (found,)})
    return campaign._replace(params=campaign.params.with_calibration(tables))


def is_registered(campaign: Campaign) -> bool:
    """Whether the machine is registered with the policy of the campaign."""
    of_policy = load_card(campaign.policy_folder).policy_sha256
    known = campaign.params.calibration.registrations
    return any(registration.policy_sha256 == of_policy for registration in known)
