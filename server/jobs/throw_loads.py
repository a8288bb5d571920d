"""Throws as loads of a job: where they landed, what they were aimed at, how they scatter."""

import math
from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime
from typing import Final, NamedTuple

import numpy as np
from sqlalchemy import ColumnElement, select
from sqlalchemy.orm import Session as DatabaseSession

from bulk.footprint import turned
from bulk.job_file import material_of
from bulk.throw_model import LandingScatter, MeasuredLoad
from machine.conventions import Array
from machine.messages import Target
from machine.site.thrown_material import MaterialFootprint, ThrownMaterial
from server.accounts.audit_chain import Actor
from server.clock import first_id_at, utc_now
from server.jobs.job_store import JobRecord
from server.jobs.job_views import JobProposal, LandedBy
from server.plans.landing_errors import point_of
from server.schemas.history import Outcome
from server.store.job_tables import JobLoad, JobRow
from server.store.models import Impact, Plan, Throw
from server.store.throw_filters import threw_a_ball
from server.throws.impacts import target_of

SAME_TARGET_M: Final = 0.05
"""A throw at a target this near to a proposal is a load of the job, at whatever height."""
OFFERED_COUNT: Final = 12
"""Proposals of the last plans, which a throw may have been aimed at."""
SCATTER_COUNT: Final = 20
"""Measured throws of about one range that give their scatter to a sixth."""
SAME_LANDING_M: Final = 1e-3
NEWEST_COUNT: Final = 300
NEWEST_LOADS_COUNT: Final = 40
"""Measured loads whose spread counts: those of about two trucks."""
BIN_M: Final = 1.0
LEAST_SD_M: Final = 0.01


class ThrowLanding(NamedTuple):
    """Where a throw came down, frame `machine`."""

    x_m: float
    y_m: float
    landed_by: LandedBy
    footprint: MaterialFootprint | None = None
    """As measured."""

    @property
    def volume_m3(self) -> float | None:
        """Measured."""
        return None if self.footprint is None else self.footprint.volume_m3

    @property
    def covariance_m2(self) -> tuple[float, float, float] | None:
        """Measured."""
        return None if self.footprint is None else self.footprint.covariance_m2


Footprints = Mapping[str, MaterialFootprint]
"""Newest measured footprints by throw."""


def footprints_of(database: DatabaseSession, throw_ids: Iterable[str]) -> Footprints:
    """Measured footprints of throws that have one."""
    query = select(Impact).where(Impact.throw_id.in_(list(throw_ids)))
    return {
        row.throw_id: MaterialFootprint.model_validate(row.footprint)
        for row in database.scalars(query.order_by(Impact.impact_id))
        if row.footprint is not None
    }


def landing_of(throw: Throw, footprints: Footprints) -> ThrowLanding:
    """The measured impact that counts; without one the predicted one, without that the target."""
    along_m, across_m = throw.measured_downrange_error_m, throw.measured_crossrange_error_m
    landed_by: LandedBy = "measured"
    if along_m is None or across_m is None:
        landed_by = "predicted"
        along_m = throw.predicted_downrange_error_m or 0.0
        across_m = throw.predicted_crossrange_error_m or 0.0
    lies = footprints.get(throw.throw_id) if landed_by == "measured" else None
    return ThrowLanding(*point_of(target_of(throw), along_m, across_m), landed_by, lies)


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


def thrown_material(record: JobRecord, target: Target) -> ThrownMaterial | None:
    """The load that an open job wants at a target, the newest of several; None: no proposal is there."""
    for item in record.row.offered:
        offer = JobOffer.model_validate(item)
        if math.hypot(target.x_m - offer.x_m, target.y_m - offer.y_m) <= SAME_TARGET_M:
            stuff = material_of(record.file)
            return ThrownMaterial(
                name=stuff.name,
                volume_m3=offer.volume_m3,
                mass_kg=stuff.mass_kg(offer.volume_m3),
                grain_diameter_m=stuff.grain_diameter_m,
                grain_spread_ratio=stuff.grain_spread_ratio,
                grain_density_kg_per_m3=stuff.grain_density_kg_per_m3,
                drag_coefficient_ratio=stuff.drag_coefficient_ratio,
            )
    return None


def new_load(
    record: JobRecord, throw: Throw | None, landing: ThrowLanding, volume_m3: float, actor: Actor
) -> JobLoad:
    """Add a last load to a job."""
    load = JobLoad(
        job_id=record.row.job_id,
        load_count=len(record.loads) + 1,
        version_count=record.row.version_count + 1,
        throw_id=None if throw is None else throw.throw_id,
        x_m=landing.x_m,
        y_m=landing.y_m,
        volume_m3=volume_m3,
        covariance_m2=_listed(landing.covariance_m2),
        landed_by=landing.landed_by,
        recorded_by=actor.name,
        at_utc=utc_now() if throw is None else throw.created_utc,
        is_withdrawn=False,
        filled_ratio=None,
        spill_ratio=None,
    )
    record.loads.append(load)
    return load


def follow(load: JobLoad, landing: ThrowLanding) -> bool:
    """Move a load to where its throw landed by what is known now; whether anything changed."""
    away_m = max(abs(load.x_m - landing.x_m), abs(load.y_m - landing.y_m))
    spread = _listed(landing.covariance_m2)
    is_same = load.landed_by == landing.landed_by and load.covariance_m2 == spread
    if away_m <= SAME_LANDING_M and is_same:
        return False
    load.x_m, load.y_m, load.landed_by = landing.x_m, landing.y_m, landing.landed_by
    if landing.volume_m3 is not None and load.covariance_m2 is None:
        load.volume_m3 = landing.volume_m3
    load.covariance_m2 = spread
    return True


def _listed(covariance_m2: tuple[float, float, float] | None) -> list[float] | None:
    return None if covariance_m2 is None else list(covariance_m2)


def _is_measured(machine_id: str, mode: str, policy_sha256: str) -> tuple[ColumnElement[bool], ...]:
    """Throws of a machine and version that landed, and whose miss is known."""
    return (
        Throw.machine_id == machine_id,
        Throw.mode == mode,
        Throw.policy_sha256 == policy_sha256,
        Throw.outcome == Outcome.LANDED.value,
        Throw.measured_downrange_error_m.is_not(None),
        Throw.measured_crossrange_error_m.is_not(None),
    )


def measured_scatter(
    database: DatabaseSession, machine_id: str, mode: str, policy_sha256: str
) -> tuple[LandingScatter, ...]:
    """Scatter of a machine's newest measured throws of a ball by range; empty where they are too few."""
    query = (
        select(Throw.range_m, Throw.measured_downrange_error_m, Throw.measured_crossrange_error_m)
        .where(
            *_is_measured(machine_id, mode, policy_sha256),
            threw_a_ball(),
        )
        .order_by(Throw.throw_id.desc())
        .limit(NEWEST_COUNT)
    )
    rows = [tuple(row) for row in database.execute(query)]
    return scatter_by_range(np.array(rows, dtype=np.float64).reshape(-1, 3))


def measured_loads(
    database: DatabaseSession, machine_id: str, mode: str, policy_sha256: str, material: str
) -> tuple[MeasuredLoad, ...]:
    """A machine's newest loads of a material whose footprints were measured."""
    query = (
        select(Throw)
        .join(Plan, Plan.plan_id == Throw.plan_id)
        .where(
            *_is_measured(machine_id, mode, policy_sha256),
            Plan.material["name"].as_string() == material,
        )
        .order_by(Throw.throw_id.desc())
        .limit(NEWEST_LOADS_COUNT)
    )
    throws = database.scalars(query).all()
    footprints = footprints_of(database, [throw.throw_id for throw in throws])
    return tuple(
        _measured_load(throw, footprints[throw.throw_id])
        for throw in throws
        if throw.throw_id in footprints
    )


def _measured_load(throw: Throw, lies: MaterialFootprint) -> MeasuredLoad:
    xx, xy, yy = lies.covariance_m2
    turn = turned(math.atan2(throw.target_y_m, throw.target_x_m))
    along, across = np.diagonal(turn.T @ np.array([[xx, xy], [xy, yy]]) @ turn).tolist()
    error_m = throw.measured_downrange_error_m or 0.0, throw.measured_crossrange_error_m or 0.0
    return MeasuredLoad(throw.range_m, throw.pace_ratio, error_m, (along, across))


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
