"""Machines beside each other, and one machine over its life."""

from datetime import datetime
from typing import Annotated

from pydantic import Field, StringConstraints

from machine.conventions import LINE_PATTERN, Mode
from server.schemas.console import Request, View
from server.schemas.history import ThrowRow

Tag = Annotated[
    str, StringConstraints(strip_whitespace=True, min_length=1, max_length=24, pattern=LINE_PATTERN)
]


class MissFigures(View):
    """Misses of some throws."""

    throw_count: int
    mean_downrange_error_m: float
    mean_crossrange_error_m: float
    sd_downrange_m: float | None
    """None for a single throw."""
    sd_crossrange_m: float | None
    mean_miss_m: float


class ModeSummary(View):
    """What a machine throws with in a mode, and how well."""

    mode: Mode
    policy_id: str | None
    """None: no usable version on board, or it is not known here."""
    policy_sha256: str | None
    since_utc: datetime | None
    recent: MissFigures | None
    """The newest measured throws with the version on board; None: there are none."""
    baseline: MissFigures | None
    """The first ones with it, as far as they are not among the newest; None: too few throws."""


class FleetRowView(View):
    """One machine of the fleet, beside its live state."""

    machine_id: str
    tags: tuple[str, ...]
    throw_count: int
    last_throw: ThrowRow | None
    modes: tuple[ModeSummary, ...]


class MachineCounts(View):
    """What a machine has done, as far as this server knows."""

    enrolled_utc: datetime
    throw_count: int
    landed_count: int
    aborted_count: int
    throwing_s: float
    """Sum of the throws' durations."""
    start_count: int
    """How often its software has started."""
    stop_count: int
    fault_count: int


class TrendPoint(View):
    """A measured throw."""

    throw_id: str
    created_utc: datetime
    mode: Mode
    range_m: float
    policy_sha256: str
    downrange_error_m: float
    crossrange_error_m: float


class VersionChange(View):
    """From when on a machine had a version on board."""

    mode: Mode
    policy_id: str | None
    policy_sha256: str | None
    since_utc: datetime


class MachineLifeView(View):
    """One machine over its life."""

    machine_id: str
    tags: tuple[str, ...]
    counts: MachineCounts
    trend: tuple[TrendPoint, ...]
    """The newest measured throws, oldest first."""
    is_trend_cut: bool
    """There are older ones."""
    versions: tuple[VersionChange, ...]
    """Changes of versions, newest first."""


class MachineEditRequest(Request):
    """How people call and sort a machine; what is left out stays."""

    name: str | None = Field(default=None, max_length=80, pattern=LINE_PATTERN)
    tags: tuple[Tag, ...] | None = Field(default=None, max_length=8)
