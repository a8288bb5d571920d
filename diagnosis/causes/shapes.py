"""Shapes of effects that nobody has named yet: they make "unknown" a hypothesis like any other.

An effect outside the library mostly looks like one inside it whose size varies: a gain that depends on where
the joint stands, play that wears off on the way, motion that follows a neighbour's valve, a sensor's error
that grows with what it reports. A shape is a group of columns of a throw's vector (unheard.py makes them),
weighed like an effect of the library, alone or beside one. Healthy machines are off along the shapes, too;
that scatter is learned with the rest (healthy/expectation.py). A shape never becomes part of a twin.
"""

from collections.abc import Mapping
from functools import cache
from typing import Final, NamedTuple

import numpy as np

from machine.conventions import ACTIVE_JOINTS, Array

UNHEARD: Final = "unheard"
"""Groups of the layout are named ``unheard:<shape>``, columns ``unheard.<shape>.<joint>.<column>`` (the
machine's without a joint)."""
WAY_POWERS: Final = (0, 1, 2, 4)
PLAY_POWERS: Final = (0, 1, 2)
"""Bumps on a joint's way since the start of the throw."""
PLACE_WAVES: Final = (1, 2)
"""Half waves over a joint's range, or waves over the slew's circle."""
OTHER_JOINTS: Final = tuple(range(len(ACTIVE_JOINTS) - 1))


class Shape(NamedTuple):
    """Columns that come and go together; sizes of a joint's are shares of its speed, command or position."""

    said: str
    """What is seen, after "something unknown: "."""
    columns: tuple[str, ...]
    slab_sd: float
    """Prior width of a size (by eye)."""
    least_sd: float
    """No healthy machine is nearer to its twin than this (by eye)."""
    stage: str = "actuation"
    joints: tuple[str | None, ...] = ACTIVE_JOINTS
    """Where it can be; (None,) for the machine."""


SHAPES: Final[Mapping[str, Shape]] = {
    "way": Shape(
        "its speed depends on where the joint stands, or how far it has come since the start",
        (*(f"way_{k}_ratio" for k in WAY_POWERS), *(f"place_{k}_ratio" for k in PLACE_WAVES)),
        slab_sd=0.3,
        least_sd=0.02,
    ),
    "play": Shape(
        "its valve has play that changes on the way",
        tuple(f"play_{k}_ratio" for k in PLAY_POWERS),
        slab_sd=0.1,
        least_sd=0.004,
    ),
    "neighbours": Shape(
        "it moves with the valves of other joints",
        tuple(f"neighbour_{k}_ratio" for k in OTHER_JOINTS),
        slab_sd=0.2,
        least_sd=0.006,
    ),
    "command": Shape(
        "its speed grows with the command in another way than by a dead band and a gain",
        ("second_ratio", "third_ratio"),
        slab_sd=0.3,
        least_sd=0.03,
    ),
    "scale": Shape(
        "its sensor reports a constant share more, or less, of its position and speed",
        ("scale_ratio",),
        slab_sd=0.1,
        least_sd=0.001,
        stage="aim",
    ),
    "kick": Shape(
        "the load is pushed as it leaves, always the same way in the gripper",
        ("x_m_per_s", "y_m_per_s", "z_m_per_s"),
        slab_sd=0.5,
        least_sd=0.005,
        stage="release",
        joints=(None,),
    ),
    "opening": Shape(
        "the load leaves later or sooner by how the gripper hangs or swings as it opens",
        (),  # It moves a spread: jitter.py weighs it.
        slab_sd=0.0,
        least_sd=0.0,
        stage="release",
        joints=(None,),
    ),
}


@cache
def unheard_names() -> tuple[str, ...]:
    """Names of all columns, in the order of the vector."""
    return tuple(name for name, _, _ in _columns())


@cache
def unheard_groups() -> Mapping[tuple[str, str | None], tuple[int, ...]]:
    """Places of the columns of every shape of every joint among all columns."""
    groups: dict[tuple[str, str | None], list[int]] = {}
    for place, (_, key, joint) in enumerate(_columns()):
        groups.setdefault((group_of(key), joint), []).append(place)
    return {group: tuple(places) for group, places in groups.items()}


def group_of(key: str) -> str:
    """Name of a shape among the effects of the layout."""
    return f"{UNHEARD}:{key}"


def shape_of(effect: str) -> Shape | None:
    """The shape that a group of the layout is; None for effects of the library."""
    prefix, _, key = effect.partition(":")
    return SHAPES[key] if prefix == UNHEARD else None


def unheard_slab_sd() -> Array:
    """Prior widths (u,) of all columns."""
    return np.array([SHAPES[key].slab_sd for _, key, _ in _columns()])


def unheard_least_sd() -> Array:
    """Least scatter (u,) of healthy machines along all columns."""
    return np.array([SHAPES[key].least_sd for _, key, _ in _columns()])


@cache
def _columns() -> tuple[tuple[str, str, str | None], ...]:
    """Name, shape and joint of all columns."""
    return tuple(
        (".".join(part for part in (UNHEARD, key, joint, column) if part), key, joint)
        for key, shape in SHAPES.items()
        for joint in shape.joints
        for column in shape.columns
    )
