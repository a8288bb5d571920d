"""The history of throws: filters, pages, export. Every page walks an index that ends with the throw's id.

Ids are ordered in time, so bounds of time are bounds of ids, and a page costs the same at any depth.
"""

import csv
import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from sqlalchemy import ColumnElement, Executable, Row, Select, func, select
from sqlalchemy.orm import InstrumentedAttribute
from sqlalchemy.orm import Session as DatabaseSession

from machine.conventions import Mode
from server.clock import first_id_at
from server.schemas.history import Outcome, ThrowPage, ThrowRow
from server.store.database import Database
from server.store.models import Throw
from server.throws.throw_store import throw_row

PROBE_COUNT = 10_000
"""Newest throws that are looked through for a range of distances before anything else is tried."""
SORT_COUNT = 20_000
"""So many throws of a range of distances are found by their distance and sorted by time; more are common
enough to be met soon when walking back in time."""
SORT_RATIO = 20
"""The same for each throw that is wanted: to sort 100 000 entries of an index takes as long as to walk to
5 001 throws that are a tenth of a million (benchmarks/history.py)."""
_EXPORT_CHUNK = 1000


@dataclass(frozen=True, slots=True)
class ThrowFilter:
    """Which throws are meant; None means any."""

    machine_id: str | None = None
    mode: Mode | None = None
    policy_sha256: str | None = None
    operator: str | None = None
    outcome: Outcome | None = None
    min_range_m: float | None = None
    max_range_m: float | None = None
    since: datetime | None = None
    until: datetime | None = None

    def conditions(
        self,
        before: str | None,
        *,
        is_sqlite: bool,
        is_indexed: bool = True,
        common: InstrumentedAttribute[str] | None = None,
    ) -> list[ColumnElement[bool]]:
        """Everything but the distance; not `is_indexed` keeps SQLite from using an index for it.

        Neither does it use that of the column `common`.

        PostgreSQL knows how common each value is and chooses by that.
        """
        pairs = (
            (Throw.machine_id, self.machine_id),
            (Throw.policy_sha256, self.policy_sha256),
            (Throw.operator, self.operator),
            (Throw.outcome, None if self.outcome is None else self.outcome.value),
            (Throw.mode, None if self.mode is None else self.mode.value),
        )
        conditions: list[ColumnElement[bool]] = []
        for column, value in pairs:
            if value is not None:
                # Half of all throws have a mode: any other index finds fewer.
                is_common = column is common or (column is Throw.mode and bool(conditions))
                is_hidden = is_sqlite and (is_common or not is_indexed)
                conditions.append((column.concat("") if is_hidden else column) == value)
        throw_id = _plain_id() if is_sqlite and not is_indexed else Throw.throw_id
        if self.since is not None:
            conditions.append(throw_id >= first_id_at(self.since))
        if self.until is not None:
            conditions.append(throw_id < first_id_at(self.until))
        if before is not None:
            conditions.append(throw_id < before)
        return conditions

    def within(
        self, distance_m: ColumnElement[float] | InstrumentedAttribute[float]
    ) -> list[ColumnElement[bool]]:
        """Conditions on the distance of the target."""
        conditions: list[ColumnElement[bool]] = []
        if self.min_range_m is not None:
            conditions.append(distance_m >= self.min_range_m)
        if self.max_range_m is not None:
            conditions.append(distance_m <= self.max_range_m)
        return conditions


class ThrowHistory:
    """Reads throws, newest first."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def page(self, wanted: ThrowFilter, cursor: str | None, limit: int) -> ThrowPage:
        """One page.

        Args:
            wanted: which throws.
            cursor: `next_cursor` of the page before; None begins.
            limit: rows a page.
        """
        with self._database.read() as database:
            rows = newest(database, wanted, limit + 1, before=cursor)
        return ThrowPage(
            rows=tuple(throw_row(row) for row in rows[:limit]),
            next_cursor=rows[limit - 1].throw_id if len(rows) > limit else None,
        )

    def export(self, wanted: ThrowFilter) -> Iterator[str]:
        """All throws that match as CSV, newest first, in parts."""
        names = [name for name in ThrowRow.model_fields if name != "target"]
        target_names = ["target_x_m", "target_y_m", "target_z_m", "range_m", "azimuth_rad"]
        yield _csv_line([*names, *target_names])
        before: str | None = None
        while True:
            with self._database.read() as database:
                rows = newest(database, wanted, _EXPORT_CHUNK, before=before)
            yield "".join(_csv_row(throw_row(row), names) for row in rows)
            if len(rows) < _EXPORT_CHUNK:
                return
            before = rows[-1].throw_id


def newest(
    database: DatabaseSession, wanted: ThrowFilter, limit: int, *, before: str | None = None
) -> list[Throw]:
    """The newest throws that match, newest first."""
    found = newest_values(database, wanted, limit, (Throw.throw_id,), before=before)
    ids = [throw_id for (throw_id,) in found]
    rows = database.scalars(select(Throw).where(Throw.throw_id.in_(ids)))
    return sorted(rows, key=lambda row: row.throw_id, reverse=True)


def newest_values(
    database: DatabaseSession,
    wanted: ThrowFilter,
    limit: int,
    columns: Sequence[InstrumentedAttribute[Any]],
    *,
    before: str | None = None,
    is_measured: bool = False,
) -> Sequence[Row[Any]]:
    """Some columns of the newest throws that match, newest first.

    One index cannot serve a filter on distance in order of time. For a page the newest few thousand throws
    are looked through first. If they do not fill it, a distance that is rare is served by the index of
    distances, and a common one by walking on.

    Args:
        database: an open transaction.
        wanted: which throws.
        limit: rows at most.
        columns: what is read of each throw.
        before: id that all found are older than.
        is_measured: only throws with a measured impact.
    """
    extra = (Throw.measured_downrange_error_m.is_not(None),) if is_measured else ()
    is_sqlite = database.get_bind().dialect.name == "sqlite"
    common = _commoner(database, wanted) if is_sqlite else None
    conditions = (*wanted.conditions(before, is_sqlite=is_sqlite, common=common), *extra)
    walk = select(*columns).where(*conditions).order_by(Throw.throw_id.desc()).limit(limit)
    if not wanted.within(Throw.range_m):
        return _all(database, walk)
    if limit < PROBE_COUNT / 10:
        newest_ids = select(Throw.throw_id).where(*conditions).order_by(Throw.throw_id.desc())
        recent = newest_ids.add_columns(Throw.range_m).limit(PROBE_COUNT).subquery()
        near = select(recent.c.throw_id).where(*wanted.within(recent.c.range_m))
        near = near.order_by(recent.c.throw_id.desc()).limit(limit)
        found = _values_of(database, columns, near)
        if len(found) >= limit:
            return found
    if _is_rare(database, wanted, max(SORT_COUNT, SORT_RATIO * limit)):
        others = wanted.conditions(before, is_sqlite=is_sqlite, is_indexed=False)
        ids = select(Throw.throw_id).where(*wanted.within(Throw.range_m), *others, *extra)
        return _values_of(database, columns, ids.order_by(_plain_id().desc()).limit(limit))
    distance_m = _plain_range() if is_sqlite else Throw.range_m
    return _all(database, walk.where(*wanted.within(distance_m)))


def _values_of(
    database: DatabaseSession,
    columns: Sequence[InstrumentedAttribute[Any]],
    ids: Select[str],
) -> Sequence[Row[Any]]:
    """Columns of the throws that a query finds, newest first."""
    chosen = ids.subquery()
    rows = select(*columns).join(chosen, chosen.c.throw_id == Throw.throw_id)
    return _all(database, rows.order_by(Throw.throw_id.desc()))


def _all(database: DatabaseSession, query: Executable) -> Sequence[Row[Any]]:
    # The session would spend as much time on its own view of these rows as the database takes.
    return database.connection().execute(query).all()


def _commoner(database: DatabaseSession, wanted: ThrowFilter) -> InstrumentedAttribute[str] | None:
    """Of operator and policy, if both are wanted, the one with more throws; None: both are common."""
    pairs = ((Throw.operator, wanted.operator), (Throw.policy_sha256, wanted.policy_sha256))
    counts: list[int] = []
    for column, value in pairs:
        if value is None:
            return None
        some = select(Throw.throw_id).where(column == value).limit(SORT_COUNT + 1)
        counts.append(database.scalar(select(func.count()).select_from(some.subquery())) or 0)
    if min(counts) > SORT_COUNT:
        return None
    return pairs[counts.index(max(counts))][0]


def _is_rare(database: DatabaseSession, wanted: ThrowFilter, most_count: int) -> bool:
    """Whether at most so many throws have these distances; counts in the index of distances alone."""
    some = select(Throw.range_m).where(*wanted.within(Throw.range_m)).limit(most_count + 1)
    count = database.scalar(select(func.count()).select_from(some.subquery())) or 0
    return count <= most_count


def _plain_id() -> ColumnElement[str]:
    """The id as an expression that no index serves."""
    return Throw.throw_id.concat("")


def _plain_range() -> ColumnElement[float]:
    """The distance as an expression that no index serves; PostgreSQL would take it for rare."""
    return Throw.range_m + 0.0


def _csv_row(row: ThrowRow, names: list[str]) -> str:
    values = row.model_dump(mode="json")
    target = values["target"]
    return _csv_line(
        [_csv_safe(values[name]) for name in names]
        + [target[name] for name in ("x_m", "y_m", "z_m", "range_m", "azimuth_rad")]
    )


def _csv_safe(value: Any) -> Any:
    # A spreadsheet runs text that begins with these as a formula.
    if isinstance(value, str) and value[:1] in ("=", "+", "-", "@", "\t", "\r"):
        return "'" + value
    return value


def _csv_line(values: list[Any]) -> str:
    buffer = io.StringIO()
    csv.writer(buffer, lineterminator="\r\n").writerow(values)
    return buffer.getvalue()
