"""How well machines throw, beside each other and over the life of one, from the history of throws."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from sqlalchemy import Row, func, select
from sqlalchemy.orm import Session as DatabaseSession

from machine.conventions import Mode
from machine.messages import EventKind
from server.deployments.machine_policies import MachinePolicies
from server.machines.machine_registry import MachineRegistry
from server.plans.policy_store import PolicyStore
from server.schemas.fleet import (
    FleetRowView,
    MachineCounts,
    MachineLifeView,
    MissFigures,
    ModeSummary,
    TrendPoint,
    VersionChange,
)
from server.schemas.history import Outcome
from server.store.database import Database
from server.store.models import Event, Machine, MachinePolicy, Throw
from server.throws.throw_store import throw_row

RECENT_COUNT: Final = 20
"""Newest measured throws that stand for today; the sd of 20 is known to 16 %."""
BASELINE_COUNT: Final = 50
TREND_COUNT: Final = 500
VERSIONS_COUNT: Final = 100
_COUNTED: Final = (EventKind.BOOTED, EventKind.STOP_LATCHED, EventKind.FAULT)

Misses = list[tuple[float, float]]


class MachineSummaries:
    """Reads what is known of machines."""

    def __init__(
        self,
        database: Database,
        registry: MachineRegistry,
        machine_policies: MachinePolicies,
        policies: PolicyStore,
    ) -> None:
        self._database = database
        self._registry = registry
        self._machine_policies = machine_policies
        self._policies = policies

    def fleet(self) -> list[FleetRowView]:
        """Every machine that people see."""
        return [self._row(known.machine_id, known.tags) for known in self._registry.listed()]

    def life(self, machine_id: str) -> MachineLifeView:
        """One machine.

        Raises:
            NotFoundError: there is none of this name.
        """
        known = self._registry.get(machine_id)
        with self._database.read() as database:
            measured = database.execute(
                select(
                    Throw.throw_id,
                    Throw.created_utc,
                    Throw.mode,
                    Throw.range_m,
                    Throw.policy_sha256,
                    Throw.measured_downrange_error_m,
                    Throw.measured_crossrange_error_m,
                )
                .where(
                    Throw.machine_id == machine_id, Throw.measured_downrange_error_m.is_not(None)
                )
                .order_by(Throw.throw_id.desc())
                .limit(TREND_COUNT + 1)
            ).all()
            changes = database.scalars(
                select(MachinePolicy)
                .where(MachinePolicy.machine_id == machine_id)
                .order_by(MachinePolicy.machine_policy_count.desc())
                .limit(VERSIONS_COUNT)
            ).all()
            counts = _counts(database, machine_id)
        names = TrendPoint.model_fields
        return MachineLifeView(
            machine_id=machine_id,
            tags=known.tags,
            counts=counts,
            trend=tuple(
                TrendPoint.model_validate(dict(zip(names, row, strict=True)))
                for row in reversed(measured[:TREND_COUNT])
            ),
            is_trend_cut=len(measured) > TREND_COUNT,
            versions=tuple(
                VersionChange(
                    mode=Mode(row.mode),
                    policy_id=self._name_of(row.policy_sha256),
                    policy_sha256=row.policy_sha256,
                    since_utc=row.since_utc,
                )
                for row in changes
            ),
        )

    def _name_of(self, policy_sha256: str | None) -> str | None:
        return None if policy_sha256 is None else self._policies.name_of(policy_sha256)

    def _row(self, machine_id: str, tags: tuple[str, ...]) -> FleetRowView:
        aboard = {
            entry.mode: entry for entry in self._machine_policies.view(machine_id, None).policies
        }
        with self._database.read() as database:
            last = database.scalars(
                select(Throw)
                .where(Throw.machine_id == machine_id)
                .order_by(Throw.throw_id.desc())
                .limit(1)
            ).first()
            count = database.scalar(
                select(func.count()).select_from(Throw).where(Throw.machine_id == machine_id)
            )
            modes: list[ModeSummary] = []
            for mode in Mode:
                entry = aboard.get(mode)
                sha256 = None if entry is None else entry.policy_sha256
                recent, baseline = (
                    (None, None)
                    if sha256 is None
                    else _recent_and_baseline(database, machine_id, mode, sha256)
                )
                modes.append(
                    ModeSummary(
                        mode=mode,
                        policy_id=None if entry is None else entry.policy_id,
                        policy_sha256=sha256,
                        since_utc=None if entry is None else entry.since_utc,
                        recent=recent,
                        baseline=baseline,
                    )
                )
        return FleetRowView(
            machine_id=machine_id,
            tags=tags,
            throw_count=count or 0,
            last_throw=None if last is None else throw_row(last),
            modes=tuple(modes),
        )


def _recent_and_baseline(
    database: DatabaseSession, machine_id: str, mode: Mode, policy_sha256: str
) -> tuple[MissFigures | None, MissFigures | None]:
    """Figures of the newest and of the first measured throws with a version; no throw is in both."""
    measured = select(
        Throw.throw_id, Throw.measured_downrange_error_m, Throw.measured_crossrange_error_m
    ).where(
        Throw.machine_id == machine_id,
        Throw.mode == mode.value,
        Throw.policy_sha256 == policy_sha256,
        Throw.measured_downrange_error_m.is_not(None),
    )
    newest = database.execute(measured.order_by(Throw.throw_id.desc()).limit(RECENT_COUNT)).all()
    recent = _misses(newest)
    if len(newest) < RECENT_COUNT:
        return figures(recent), None
    first = database.execute(
        measured.where(Throw.throw_id < newest[-1].throw_id)
        .order_by(Throw.throw_id)
        .limit(BASELINE_COUNT)
    ).all()
    baseline = _misses(first)
    return figures(recent), figures(baseline) if len(baseline) >= RECENT_COUNT else None


def _misses(rows: Sequence[Row[str, float | None, float | None]]) -> Misses:
    return [(row[1] or 0.0, row[2] or 0.0) for row in rows]


def figures(misses: Misses) -> MissFigures | None:
    """Mean and spread of misses (downrange, crossrange), m; None of no throw."""
    if not misses:
        return None
    errors = np.array(misses)
    mean = errors.mean(axis=0)
    sd = errors.std(axis=0, ddof=1) if len(misses) > 1 else None
    return MissFigures(
        throw_count=len(misses),
        mean_downrange_error_m=float(mean[0]),
        mean_crossrange_error_m=float(mean[1]),
        sd_downrange_m=None if sd is None else float(sd[0]),
        sd_crossrange_m=None if sd is None else float(sd[1]),
        mean_miss_m=float(np.hypot(errors[:, 0], errors[:, 1]).mean()),
    )


def _counts(database: DatabaseSession, machine_id: str) -> MachineCounts:
    machine = database.get(Machine, machine_id)
    assert machine is not None, "the registry knows it"
    outcomes = {
        row[0]: (row[1], row[2] or 0.0)
        for row in database.execute(
            select(Throw.outcome, func.count(), func.sum(Throw.throw_duration_s))
            .where(Throw.machine_id == machine_id)
            .group_by(Throw.outcome)
        )
    }
    events = {
        row[0]: row[1]
        for row in database.execute(
            select(Event.kind, func.count())
            .where(
                Event.machine_id == machine_id, Event.kind.in_([kind.value for kind in _COUNTED])
            )
            .group_by(Event.kind)
        )
    }
    return MachineCounts(
        enrolled_utc=machine.enrolled_utc,
        throw_count=sum(count for count, _ in outcomes.values()),
        landed_count=outcomes.get(Outcome.LANDED.value, (0, 0.0))[0],
        aborted_count=outcomes.get(Outcome.ABORTED.value, (0, 0.0))[0],
        throwing_s=sum(seconds for _, seconds in outcomes.values()),
        start_count=events.get(EventKind.BOOTED.value, 0),
        stop_count=events.get(EventKind.STOP_LATCHED.value, 0),
        fault_count=events.get(EventKind.FAULT.value, 0),
    )
