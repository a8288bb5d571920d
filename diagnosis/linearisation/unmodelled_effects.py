"""Effects outside the library, which make "unknown" a hypothesis like any other.

An effect outside the library mostly resembles one inside it whose size varies: a gain that depends on the
joint's position, play that wears, motion that follows another valve, a sensor error that grows with the
reading. An unmodelled effect is a group of basis functions of a throw's vector (basis_functions.py). It is
weighed like an effect of the library, alone or beside others. Healthy machines scatter along these
directions, too; that scatter is learned with the rest (expectation_maximisation.py). An unmodelled effect
never becomes part of a twin.
"""

from collections.abc import Mapping
from functools import cache
from typing import Final, NamedTuple

import numpy as np

from machine.conventions import ACTIVE_JOINTS, Array

UNMODELLED: Final = "unmodelled"
"""Groups of the layout are named ``unmodelled:<name>``, columns ``unmodelled.<name>.<joint>.<column>``
(without a joint for the machine's)."""
TRAVEL_ORDERS: Final = (0, 1, 2, 4)
PLAY_ORDERS: Final = (0, 1, 2)
"""Orders of the bumps along a joint's travel since the start of the throw, for gain and for play."""
PLACE_WAVES: Final = (1, 2)
"""Numbers of half waves over a joint's range, or of waves over the slew's circle."""
OTHER_JOINTS: Final = tuple(range(len(ACTIVE_JOINTS) - 1))


class UnmodelledEffect(NamedTuple):
    """Basis functions that are present together; sizes are shares of a joint's speed, command or position."""

    description: str
    """Description, after "something unknown: "."""
    columns: tuple[str, ...]
    slab_sd: float
    """Prior width of a size."""
    least_sd: float
    """Least scatter of healthy machines along it."""
    stage: str = "actuation"
    joints: tuple[str | None, ...] = ACTIVE_JOINTS
    """Where it can act; (None,) for the machine."""


UNMODELLED_EFFECTS: Final[Mapping[str, UnmodelledEffect]] = {
    "way": UnmodelledEffect(
        "its speed depends on where the joint stands, or how far it has come since the start",
        (*(f"way_{k}_ratio" for k in TRAVEL_ORDERS), *(f"place_{k}_ratio" for k in PLACE_WAVES)),
        slab_sd=0.3,
        least_sd=0.02,
    ),
    "play": UnmodelledEffect(
        "its valve has play that changes on the way",
        tuple(f"play_{k}_ratio" for k in PLAY_ORDERS),
        slab_sd=0.1,
        least_sd=0.004,
    ),
    "neighbours": UnmodelledEffect(
        "it moves with the valves of other joints",
        tuple(f"neighbour_{k}_ratio" for k in OTHER_JOINTS),
        slab_sd=0.2,
        least_sd=0.006,
    ),
    "command": UnmodelledEffect(
        "its speed grows with the command in another way than by a dead band and a gain",
        ("second_ratio", "third_ratio"),
        slab_sd=0.3,
        least_sd=0.03,
    ),
    "scale": UnmodelledEffect(
        "its sensor reports a constant share more, or less, of its position and speed",
        ("scale_ratio",),
        slab_sd=0.1,
        least_sd=0.001,
        stage="aim",
    ),
    "kick": UnmodelledEffect(
        "the load is pushed as it leaves, always the same way in the gripper",
        ("x_m_per_s", "y_m_per_s", "z_m_per_s"),
        slab_sd=0.5,
        least_sd=0.005,
        stage="release",
        joints=(None,),
    ),
    "opening": UnmodelledEffect(
        "the load leaves later or sooner by how the gripper hangs or swings as it opens",
        (),  # It moves a spread: release_jitter.py weighs it.
        slab_sd=0.0,
        least_sd=0.0,
        stage="release",
        joints=(None,),
    ),
}


@cache
def unmodelled_names() -> tuple[str, ...]:
    """Names of all columns, in the order of the vector."""
    return tuple(name for name, _, _ in _columns())


@cache
def unmodelled_groups() -> Mapping[tuple[str, str | None], tuple[int, ...]]:
    """Indices of the columns of every unmodelled effect of every joint."""
    groups: dict[tuple[str, str | None], list[int]] = {}
    for place, (_, key, joint) in enumerate(_columns()):
        groups.setdefault((group_of(key), joint), []).append(place)
    return {group: tuple(places) for group, places in groups.items()}


def group_of(key: str) -> str:
    """Name of an unmodelled effect among the effects of the layout."""
    return f"{UNMODELLED}:{key}"


def unmodelled_effect_of(effect: str) -> UnmodelledEffect | None:
    """The unmodelled effect of a group of the layout; None for effects of the library."""
    prefix, _, key = effect.partition(":")
    return UNMODELLED_EFFECTS[key] if prefix == UNMODELLED else None


def unmodelled_slab_sd() -> Array:
    """Prior widths (u,) of all columns."""
    return np.array([UNMODELLED_EFFECTS[key].slab_sd for _, key, _ in _columns()])


def unmodelled_least_sd() -> Array:
    """Least scatter (u,) of healthy machines along all columns."""
    return np.array([UNMODELLED_EFFECTS[key].least_sd for _, key, _ in _columns()])


@cache
def _columns() -> tuple[tuple[str, str, str | None], ...]:
    """Name, unmodelled effect and joint of all columns."""
    return tuple(
        (".".join(part for part in (UNMODELLED, key, joint, column) if part), key, joint)
        for key, shape in UNMODELLED_EFFECTS.items()
        for joint in shape.joints
        for column in shape.columns
    )
