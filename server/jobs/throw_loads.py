"""Throws as loads of a job: where they landed, what they were aimed at, how they scatter."""

import math
from collections.abc import Iterable, Sequence
from datetime import datetime
from typing import Final, NamedTuple

import numpy as np
from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession

from bulk.throw_model import LandingScatter
from machine.conventions import Array
from server.clock import first_id_at, utc_now
from server.jobs.job_views import JobProposal, LandedBy
from server.plans.landing_errors import point_of
from server.schemas.history import Outcome
from server.store.job_tables import JobLoad, JobRow
from server.store.models import Throw
from server.throws.impacts import target_of

SAME_TARGET_M: Final = 0.05
"""A throw at a target this near to a proposal is a load of the job, at whatever height."""
OFFERED_COUNT: Final = 12
"""Proposals of the last plans, which a throw may have been aimed at."""
SCATTER_COUNT: Final = 20
"""Measured throws of about one range that give their scatter to a sixth."""
NEWEST_COUNT: Final = 300
BIN_M: Final = 1.0
LEAST_SD_M: Final = 0.01


class ThrowLanding(NamedTuple):
    """Where a throw came down, frame `machine`."""

    x_m: float
    y_m: float
    landed_by: LandedBy


def landing_of(throw: Throw) -> ThrowLanding:
    """The measured impact that counts; without one the predicted one, without that the target."""
    along_m, across_m = throw.measured_downrange_error_m, throw.measured_crossrange_error_m
    landed_by: LandedBy = "measured"
    if along_m is None or across_m is None:
        landed_by = "predicted"
        along_m = throw.predicted_downrange_error_m or 0.0
        across_m = throw.predicted_crossrange_error_m or 0.0
    return ThrowLanding(*point_of(target_of(throw), along_m, across_m), landed_by)


def landed_throws(database: DatabaseSession, job: JobRow) -> Sequence[Throw]:
    """Throws of the job's machine since the job began that have landed, oldest first."""
    query = select(Throw).where(
        Throw.machine_id == job.machine_id,
        Throw.throw_id >= first_id_at(job.created_utc),
        Throw.outcome == Outcome.LANDED.value,
    )
    return database.scalars(query.order_by(Throw.throw_id)).all()


def counted_ids(database: DatabaseSession, throws: Iterable[Throw]) -> set[str]:
    """Which throws are, or were, loads of any job."""
    ids = [throw.throw_id for throw in throws]
    found = database.scalars(select(JobLoad.throw_id).where(JobLoad.throw_id.in_(ids)))
    return {throw_id for throw_id in found if throw_id is not None}


class JobOffer(JobProposal):
    """A proposal since it was offered."""

    offered_utc: datetime


def offers(proposals: Iterable[JobProposal], before: Sequence[object]) -> list[object]:
    """JSON of the newest offers: proposals that are offered now, and those before."""
    now = utc_now()
    new = [JobOffer(**item.model_dump(), offered_utc=now) for item in proposals]
    return [*(item.model_dump(mode="json") for item in new), *before][:OFFERED_COUNT]


def aimed_at(throw: Throw, offered: Sequence[object]) -> JobProposal | None:
    """The proposal that a throw was aimed at, the newest of several.

    Args:
        throw: fired.
        offered: JSON of `JobOffer`, newest first; what was offered after the throw does not count.
    """
    for item in offered:
        offer = JobOffer.model_validate(item)
        away_m = math.hypot(throw.target_x_m - offer.x_m, throw.target_y_m - offer.y_m)
        if away_m <= SAME_TARGET_M and offer.offered_utc <= throw.created_utc:
            return offer
    return None


def measured_scatter(
    database: DatabaseSession, machine_id: str, mode: str, policy_sha256: str
) -> tuple[LandingScatter, ...]:
    """Scatter of a machine's newest measured throws by range; empty where they are too few."""
    query = (
        select(Throw.range_m, Throw.measured_downrange_error_m, Throw.measured_crossrange_error_m)
        .where(
            Throw.machine_id == machine_id,
            Throw.mode == mode,
            Throw.policy_sha256 == policy_sha256,
            Throw.outcome == Outcome.LANDED.value,
            Throw.measured_downrange_error_m.is_not(None),
            Throw.measured_crossrange_error_m.is_not(None),
        )
        .order_by(Throw.throw_id.desc())
        .limit(NEWEST_COUNT)
    )
    rows = [tuple(row) for row in database.execute(query)]
    return scatter_by_range(np.array(rows, dtype=np.float64).reshape(-1, 3))


def scatter_by_range(throws_m: Array) -> tuple[LandingScatter, ...]:
    """Scatter by range.

    Args:
        throws_m: (N, 3) range, downrange and crossrange error.
    """
    ordered = throws_m[np.argsort(throws_m[:, 0], kind="stable")]
    bins: list[Array] = []
    first = 0
    for end in range(1, len(ordered) + 1):
        part = ordered[first:end]
        if len(part) >= SCATTER_COUNT and np.ptp(part[:, 0]) >= BIN_M:
            bins.append(part)
            first = end
    rest = ordered[first:]
    if len(rest) >= SCATTER_COUNT:
        bins.append(rest)
    elif bins and len(rest):
        bins[-1] = np.concatenate([bins[-1], rest])
    return tuple(
        LandingScatter(
            float(part[:, 0].mean()),
            *(max(float(part[:, i].std(ddof=1)), LEAST_SD_M) for i in (1, 2)),
        )
        for part in bins
    )
