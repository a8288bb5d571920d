"""Drifts that the test finds in the measured throws of a machine with the versions on board."""

from collections.abc import Iterator
from typing import Final, NamedTuple

from sqlalchemy import select

from machine.conventions import Mode
from server.aim.surveyed_misses import corrected_m
from server.deployments.machine_policies import MachinePolicies
from server.drift.drift_test import Change, Drift, DriftTest, ThrowMiss
from server.schemas.history import Outcome
from server.store.database import Database
from server.store.models import Plan, Throw
from server.store.throw_filters import threw_a_ball

CONSIDERED_COUNT: Final = 3000
"""Newest measured throws of a mode and version."""
CHANGE_WORDS: Final = {
    Change.LONG: "longer than predicted and than before",
    Change.SHORT: "shorter than predicted and than before",
    Change.LEFT: "further left than predicted and than before",
    Change.RIGHT: "further right than predicted and than before",
    Change.SPREAD_ALONG: "with more spread along than before",
    Change.SPREAD_ACROSS: "with more spread across than before",
}


class TestedThrow(NamedTuple):
    """A throw that the test has taken."""

    throw_id: str
    has_log: bool
    """Whether it landed and its log is here: only then it can be diagnosed."""
    miss: ThrowMiss


class FoundDrift(NamedTuple):
    """A drift that lasts, with the throws of before and since; oldest first."""

    mode: Mode
    change: Change
    before: tuple[TestedThrow, ...]
    since: tuple[TestedThrow, ...]


def found_drifts(
    database: Database, machine_policies: MachinePolicies, machine_id: str
) -> Iterator[FoundDrift]:
    """Drifts of a machine, at most one a mode."""
    for entry in machine_policies.view(machine_id, None).policies:
        if entry.policy_sha256 is None:
            continue
        throws = _tested_throws(database, machine_id, entry.mode, entry.policy_sha256)
        test = DriftTest()
        drift: Drift | None = None
        for throw in throws:
            drift = test.add(throw.miss)
        if drift is not None:
            count = drift.change_count
            yield FoundDrift(entry.mode, drift.change, tuple(throws[:count]), tuple(throws[count:]))


def _tested_throws(
    database: Database, machine_id: str, mode: Mode, policy_sha256: str
) -> list[TestedThrow]:
    """Measured minus predicted misses, oldest first; throws without a prediction are left out."""
    columns = (
        Throw.measured_downrange_error_m,
        Throw.measured_crossrange_error_m,
        Throw.predicted_downrange_error_m,
        Throw.predicted_crossrange_error_m,
        Throw.predicted_sd_downrange_m,
        Throw.predicted_sd_crossrange_m,
    )
    query = (
        select(Throw.throw_id, Throw.has_log, Throw.outcome, Plan.aim, *columns)
        .outerjoin(Plan, Plan.plan_id == Throw.plan_id)
        .where(
            Throw.machine_id == machine_id,
            Throw.mode == mode.value,
            Throw.policy_sha256 == policy_sha256,
            threw_a_ball(),
            *(column.is_not(None) for column in columns),
            Throw.predicted_sd_downrange_m > 0.0,
            Throw.predicted_sd_crossrange_m > 0.0,
        )
        .order_by(Throw.throw_id.desc())
        .limit(CONSIDERED_COUNT)
    )
    with database.read() as session:
        rows = session.execute(query).all()
    found: list[TestedThrow] = []
    for throw_id, has_log, outcome, aim, *values in reversed(rows):
        # None is left out by the query.
        along, across, along_0, across_0, sd_along, sd_across = (value or 0.0 for value in values)
        # Without the aim correction: another version of it is no drift of the machine.
        along_m, across_m = (
            miss - predicted + corrected
            for miss, predicted, corrected in zip(
                (along, across), (along_0, across_0), corrected_m(aim), strict=True
            )
        )
        miss = ThrowMiss(along_m / sd_along, across_m / sd_across, along_m, across_m)
        found.append(TestedThrow(throw_id, has_log and outcome == Outcome.LANDED.value, miss))
    return found
