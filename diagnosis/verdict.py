"""The result of `downrange diagnose`, with units in the names.

The same schema serves whole throws and single stages. Lengths are in frame `throw` (downrange, crossrange).
"""

from collections.abc import Mapping
from enum import IntEnum, StrEnum
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

Interval = tuple[float, float]
"""Lower and upper end of a 90 % interval."""


class VerdictKind(StrEnum):
    """The answer in one word."""

    NONE = "none"
    """The twin explains the data as well as those of a machine without a further effect."""
    EXPLAINED = "explained"
    AMBIGUOUS = "ambiguous"
    """Two causes that these data cannot separate; a motion that separates them is given."""
    UNKNOWN = "unknown"
    """A deviation that no effect of the library explains."""
    BAD_DATA = "bad_data"


class ExitCode(IntEnum):
    """Exit codes of `downrange diagnose`."""

    EXPLAINED = 0
    ERROR = 1
    AMBIGUOUS = 2
    UNKNOWN = 3
    BAD_DATA = 4


EXIT_CODES: Mapping[VerdictKind, ExitCode] = {
    VerdictKind.NONE: ExitCode.EXPLAINED,
    VerdictKind.EXPLAINED: ExitCode.EXPLAINED,
    VerdictKind.AMBIGUOUS: ExitCode.AMBIGUOUS,
    VerdictKind.UNKNOWN: ExitCode.UNKNOWN,
    VerdictKind.BAD_DATA: ExitCode.BAD_DATA,
}


class Stage(StrEnum):
    """Links of the chain from command to impact, in its order."""

    ACTUATION = "actuation"
    """Command to joint motion, per joint."""
    SWING = "swing"
    """Joint motion to gripper motion."""
    RELEASE = "release"
    """Command to opening."""
    FLIGHT = "flight"
    """Release state to impact."""
    AIM = "aim"
    """Base pose, sensors, survey."""


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Miss(_Part):
    """A horizontal displacement in frame `throw`."""

    downrange: float
    crossrange: float


class Gap(_Part):
    """Twin against measurement, before anything is added. None where it was not measured."""

    impact_rms_m: float | None = None
    healthy_rms_m: float | None = None
    """The same of the reference throws; None without them."""
    downrange_bias_m: float | None = None
    crossrange_bias_m: float | None = None
    trajectory_rms_ratio: float | None = None
    """Root mean square residual of the recorded channels over that of a healthy machine; 1 = no gap."""


class StageGap(_Part):
    """Contribution of one stage to the miss; the terms of all stages sum to measured minus twin."""

    stage: Stage
    joint: str | None = None
    miss_m: Miss
    share_ratio: float
    """Of the sum of the magnitudes of all terms."""
    ci90_m: Interval
    """Of the term's downrange mean over throws, by bootstrap."""


class FittedParameter(_Part):
    """A parameter with its interval."""

    value: float
    ci90: Interval
    unit: str


class FittedEffect(_Part):
    """An effect of the library with its fitted parameters."""

    effect: str
    joint: str | None = None
    parameters: Mapping[str, FittedParameter]


class Cause(_Part):
    """A hypothesis: a set of effects, ``none`` or ``unknown``, and its probability."""

    effects: tuple[FittedEffect, ...]
    probability: float = Field(ge=0.0, le=1.0)
    name: str = ""
    """``none``, ``unknown``, or the effects in words."""


class Ambiguity(_Part):
    """Causes that these data cannot separate."""

    members: tuple[str, ...]
    """In words."""
    effects: tuple[tuple[FittedEffect, ...], ...] = ()
    """The effects of every member with their sizes, in the same order; empty for ``none``."""
    separating_motion: Mapping[str, Any]
    """What to record next: ``{kind, joint, ...}`` with units in the names, and ``words`` for people."""
    why: str


class Shrink(_Part):
    """Reduction of the gap on throws that were not used to estimate the cause."""

    predicted_ratio: float | None
    """Share of the removable gap, predicted before the effect was added."""
    before_m: float
    after_m: float
    ratio: float
    """Realised share of the removable gap."""
    ci90: Interval
    held_out_throws: int
    removable_ratio: float
    """Share of the gap that is neither noise nor jitter."""
    moved_m: float | None = None
    """How far the effects move the twin's impact, root mean square; None where it was not measured, or where
    an effect acts on pose or sensors, which a replay is given."""


class Diagnosis(_Part):
    """The result."""

    verdict: VerdictKind
    sentence: str = ""
    """The verdict for people, with its numbers."""
    gap: Gap = Gap()
    stages: tuple[StageGap, ...] = ()
    causes: tuple[Cause, ...] = ()
    """Ranked; includes ``none`` and ``unknown``."""
    ambiguity: Ambiguity | None = None
    shrink: Shrink | None = None
    evidence: Mapping[str, Any] = {}
    """Data used, rates, clocks, refused channels, effects ruled out with reasons; ``unknown``: its
    signature."""
    plots: Mapping[str, Any] = {}
    """Series for the report: ``{name: {x, y..., unit}}``; numbers only."""
