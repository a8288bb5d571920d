"""Protocols of a validation: which targets, how many throws, which machines."""

import secrets
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Final, Literal, NamedTuple

import numpy as np

from evaluation.campaigns import parse_targets
from evaluation.paper import TARGETS
from evaluation.unit_accuracy import FIRST_UNIT, MAX_UNIT_THROW_COUNT, NOMINAL_UNIT, UNIT_TARGETS
from evaluation.validation.results import ValidationPlan
from machine.policy_card import PolicyCard
from machine.reach import MIN_RANGE_M

ProtocolName = Literal["short", "full"]
UNIT_SEED_END: Final = 1_000_000
EVEN_TARGET_COUNT: Final = 3


class Protocol(NamedTuple):
    """Size of a validation."""

    targets: Mapping[str, str]
    """By mode."""
    throws_per_target: int
    unseen_unit_count: int


PROTOCOLS: Final[Mapping[ProtocolName, Protocol]] = MappingProxyType(
    {
        "short": Protocol({"2d": UNIT_TARGETS, "3d": UNIT_TARGETS}, 20, 2),
        "full": Protocol(TARGETS, 200, 10),
    }
)
"""Short: minutes on one core, for a first look. Full: the paper's targets and its 200 throws at each (IV-A),
and ten machines that served no training, with at most 60 throws at each target."""


def make_plan(
    cards: Sequence[PolicyCard],
    protocol: ProtocolName,
    throws_per_target: int | None = None,
    unseen_unit_count: int | None = None,
    seed: int | None = None,
) -> ValidationPlan:
    """The throws of a validation.

    Seed and machines are drawn now, so that no version can have been chosen by them.

    Args:
        cards: of the versions that throw, of one mode; only targets in reach of all are taken.
        protocol: name.
        throws_per_target: instead of the protocol's.
        unseen_unit_count: instead of the protocol's.
        seed: instead of a drawn one.
    """
    size, mode = PROTOCOLS[protocol], cards[0].mode
    throws = size.throws_per_target if throws_per_target is None else throws_per_target
    units = size.unseen_unit_count if unseen_unit_count is None else unseen_unit_count
    drawn = secrets.SystemRandom().sample(range(FIRST_UNIT, UNIT_SEED_END), units)
    nearest = max(MIN_RANGE_M[mode], *(card.target_range_min_m for card in cards))
    farthest = min(card.target_range_max_m for card in cards)
    known = parse_targets(size.targets[mode.value])
    ranges = tuple(r for r in known if nearest <= r <= farthest + 1e-9)
    if len(ranges) < 2:
        even = np.linspace(nearest, farthest, EVEN_TARGET_COUNT + 2)[1:-1]
        ranges = tuple(round(float(r), 2) for r in even)
    return ValidationPlan(
        mode=mode,
        protocol=protocol,
        ranges_m=ranges,
        throws_per_target=throws,
        unseen_throws_per_target=min(throws, MAX_UNIT_THROW_COUNT),
        unit_seeds=(NOMINAL_UNIT, *drawn),
        seed=secrets.randbelow(100_000) if seed is None else seed,
    )
