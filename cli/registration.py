"""How the machine of a campaign aims: by a registration of its own, by that of a file, or not at all."""

import sys
from typing import NamedTuple

from cli.campaigns import Campaign, CampaignOptions, open_with
from machine.errors import UsageError
from machine.policy_card import load_card
from sim_twin.commissioning.registration_throws import register_machine, registration_throw_count
from sim_twin.throws.plants import TWIN


class Aimed(NamedTuple):
    """A campaign, its machine registered where it can be."""

    campaign: Campaign
    words: str
    """How the machine aims, for people; where it is not registered, why, and what to do."""


def open_aimed(options: CampaignOptions, mode: str, default_targets: str) -> Aimed:
    """`open_with`; without a calibration file the machine is registered as at its first start.

    A policy that misses by more than a registration may correct is thrown as it is: that is what an
    evaluation has to show.
    """
    campaign = open_with(options, mode, default_targets)
    policy = load_card(campaign.policy_folder).policy_id
    if is_registered(campaign):
        return Aimed(campaign, f"aims by its registration in {options.calibration}")
    if options.calibration is not None:
        return Aimed(
            campaign,
            f"NOT REGISTERED: {options.calibration} holds no registration of {policy}, so the mean miss "
            f"stays; {_remedy(options)}",
        )
    if options.plant == TWIN:
        return Aimed(
            campaign,
            "the nominal twin, not registered: it stands for no machine; --calibration FILE --profile FILE "
            "of `downrange calibrate` throw with a machine's twin, which aims as its previews do",
        )
    count = registration_throw_count(load_card(campaign.policy_folder))
    print(f"registration: {count} throws with {policy} ...", file=sys.stderr, flush=True)
    try:
        aimed = registered(campaign, options.seed)
    except UsageError as error:
        return Aimed(campaign, f"NOT REGISTERED: {error}")
    return Aimed(aimed, f"registered with {count} throws of its own, as at a machine's first start")


def _remedy(options: CampaignOptions) -> str:
    if options.plant == TWIN:
        return "make one with `downrange calibrate`, this policy being active"
    return (
        "leave --calibration out and the machine is registered before it throws, or make a file with "
        "`downrange calibrate`, this policy being active"
    )


def registered(campaign: Campaign, seed: int) -> Campaign:
    """The campaign of a machine that has been registered as at its first start, its valves being measured.

    Raises:
        UsageError: no throw landed, or the misses are too large to aim away.
    """
    machine = campaign.make(registration_throw_count(load_card(campaign.policy_folder)))
    try:
        found = register_machine(machine, campaign.params, campaign.spec, seed)
    finally:
        machine.close()
    tables = campaign.params.calibration.model_copy(update={"registrations": (found,)})
    return campaign._replace(params=campaign.params.with_calibration(tables))


def is_registered(campaign: Campaign) -> bool:
    """Whether the machine aims by a registration of the policy that it throws with."""
    of_policy = load_card(campaign.policy_folder).policy_sha256
    known = campaign.params.calibration.registrations
    return any(registration.policy_sha256 == of_policy for registration in known)
