"""Throws of a rollout's machines: before and since the switch, as the stage's test and as people see them."""

from collections.abc import Sequence
from datetime import datetime
from typing import Any, Final, NamedTuple

import numpy as np
from sqlalchemy import ColumnElement, select
from sqlalchemy.orm import Session as DatabaseSession

from evaluation.measures import deviation_estimate, mean_estimate
from evaluation.validation.gates import Gates
from machine.conventions import Array
from server.rollouts.rollout_views import ThrowFigures
from server.rollouts.stage_test import Regression, StageFinding, StageThrow
from server.schemas.history import Outcome
from server.store.models import Throw
from server.store.throw_filters import threw_a_ball

REFERENCE_LIMIT: Final = 300
"""Newest throws with the version before: its spread is then known to 4 %."""


class MachineThrows(NamedTuple):
    """Throws of a machine in their order."""

    before: list[StageThrow]
    since: list[StageThrow | None]
    """None: failed."""


def machine_throws(
    database: DatabaseSession,
    machine_id: str,
    mode: str,
    *,
    before_sha256: str | None,
    policy_sha256: str,
    since_utc: datetime,
    throws_count: int,
) -> MachineThrows:
    """Read the measured throws of a machine.

    Args:
        database: a transaction.
        machine_id: machine.
        mode: mode.
        before_sha256: version before; None without one.
        policy_sha256: version of the rollout.
        since_utc: when the machine was asked to switch.
        throws_count: throws with the version that count.
    """
    columns = (
        Throw.measured_downrange_error_m,
        Throw.measured_crossrange_error_m,
        Throw.range_m,
        Throw.predicted_sd_downrange_m,
        Throw.predicted_sd_crossrange_m,
        Throw.outcome,
    )
    common = (Throw.machine_id == machine_id, Throw.mode == mode, threw_a_ball())
    landed = (Throw.outcome == Outcome.LANDED.value) & Throw.measured_downrange_error_m.is_not(None)
    old = (
        select(*columns)
        .where(*common, Throw.policy_sha256 == (before_sha256 or ""), landed)
        .order_by(Throw.throw_id.desc())
        .limit(REFERENCE_LIMIT)
    )
    new = (
        select(*columns)
        .where(
            *common,
            Throw.policy_sha256 == policy_sha256,
            Throw.created_utc >= since_utc,
            landed | _failed(),
        )
        .order_by(Throw.throw_id)
        .limit(throws_count)
    )
    before: list[Any] = [tuple(row) for row in database.execute(old)]
    since: list[Any] = [tuple(row) for row in database.execute(new)]
    along, across = _scale(before, 3), _scale(before, 4)

    def throw(row: Sequence[float]) -> StageThrow:
        return StageThrow(
            row[0], row[1], *(float(np.interp(row[2], *one)) for one in (along, across))
        )

    return MachineThrows(
        [throw(row) for row in reversed(before)],
        [throw(row) if row[5] == Outcome.LANDED.value else None for row in since],
    )


def _failed() -> ColumnElement[bool]:
    """Ends that count against a version: faults, and aborts but those that people, link or sensors caused."""
    aborted = (Throw.outcome == Outcome.ABORTED.value) & Throw.is_policys_own.is_not(False)
    return aborted | (Throw.outcome == Outcome.FAULT.value)


def _scale(rows: Sequence[Sequence[float | None]], column: int) -> tuple[Array, Array]:
    """Expected spread over the range by what the version before predicted, relative to its mean."""
    known = sorted((row[2], row[column]) for row in rows if row[2] and row[column])
    if len(known) < 2:
        return np.array([0.0]), np.array([1.0])
    ranges, spreads = np.array(known, dtype=float).T
    at, index = np.unique(np.round(2.0 * ranges) / 2.0, return_inverse=True)
    means = np.bincount(index, weights=spreads) / np.bincount(index)
    return at, means / means.mean()


def figures(throws: Sequence[StageThrow | None]) -> ThrowFigures:
    """Mean and spread with intervals."""
    misses = np.array([t[:2] for t in throws if t is not None]).reshape(-1, 2)
    along, across = misses.T
    return ThrowFigures(
        throw_count=len(throws),
        mean_downrange_error_m=mean_estimate(along),
        sd_downrange_m=deviation_estimate(along),
        mean_crossrange_error_m=mean_estimate(across),
        sd_crossrange_m=deviation_estimate(across),
    )


def worse_sentence(
    machine_id: str, finding: StageFinding, throws: MachineThrows, gates: Gates
) -> str:
    """How a machine's throws are worse, with the numbers; empty where they are not."""
    kind = finding.regression
    if kind is None:
        return ""
    since = throws.since[: finding.throw_count]
    new, old = figures(since), figures(throws.before)
    where = f"{machine_id}, {finding.throw_count} throws"
    chance = f"(chance of this with a version that is no worse: {finding.p_ratio or 0.0:.0e})"
    if kind is Regression.FAILED:
        failed_count = sum(throw is None for throw in since)
        allowed = 100.0 * (1.0 - gates.landed_ratio)
        return f"{where}: {failed_count} failed, the gate allows {allowed:.0f} % {chance}."
    if kind is Regression.SPREAD:
        return (
            f"{where}: spread {_m(new.sd_downrange_m.value)} along and "
            f"{_m(new.sd_crossrange_m.value)} across, with the version before "
            f"{_m(old.sd_downrange_m.value)} and {_m(old.sd_crossrange_m.value)} in "
            f"{old.throw_count} throws {chance}."
        )
    is_along = kind in (
        Regression.MEAN_ALONG,
        Regression.GATE_MEAN_ALONG,
        Regression.GATE_SPREAD_ALONG,
    )
    way = "along" if is_along else "across"
    is_spread = kind in (Regression.GATE_SPREAD_ALONG, Regression.GATE_SPREAD_ACROSS)
    name = f"sd_{'downrange' if is_along else 'crossrange'}_m"
    if not is_spread:
        name = f"mean_{'downrange' if is_along else 'crossrange'}_error_m"
    value, before = getattr(new, name).value, getattr(old, name).value
    word = "spread" if is_spread else "mean miss"
    if kind in (Regression.MEAN_ALONG, Regression.MEAN_ACROSS):
        beside = f"with the version before {_m(before)} in {old.throw_count} throws"
    else:
        beside = f"the gate is {_m(gates.sd_m if is_spread else gates.mean_m)}"
    return f"{where}: {word} {way} {_m(value)}, {beside} {chance}."


def _m(value: float | None) -> str:
    return "unknown" if value is None else f"{value:.3f} m"
