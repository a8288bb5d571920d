"""The history of throws: filters, pages, export. Every page walks an index that ends with the throw's id.

Ids are ordered in time, so bounds of time are bounds of ids, and a page costs the same at any depth.
"""

import csv
import io
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from sqlalchemy import ColumnElement, Select, select
from sqlalchemy.orm import Session as DatabaseSession

from machine.conventions import Mode
from server.clock import first_id_at
from server.database import Database
from server.models import Throw
from server.schemas_history import Outcome, ThrowPage, ThrowRow
from server.throws import throw_row

PROBE_COUNT = 10_000
"""Newest throws that are looked through for a range of distances before the index of ranges is asked."""
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

    def equalities(self) -> list[ColumnElement[bool]]:
        """Conditions that an index serves in order of time."""
        pairs = (
            (Throw.machine_id, self.machine_id),
            (Throw.mode, None if self.mode is None else self.mode.value),
            (Throw.policy_sha256, self.policy_sha256),
            (Throw.operator, self.operator),
            (Throw.outcome, None if self.outcome is None else self.outcome.value),
        )
        conditions: list[ColumnElement[bool]] = [
            column == value for column, value in pairs if value is not None
        ]
        if self.since is not None:
            conditions.append(Throw.throw_id >= first_id_at(self.since))
        if self.until is not None:
            conditions.append(Throw.throw_id < first_id_at(self.until))
        return conditions

    def ranges(self) -> list[ColumnElement[bool]]:
        """Conditions on the distance of the target."""
        conditions: list[ColumnElement[bool]] = []
        if self.min_range_m is not None:
            conditions.append(Throw.range_m >= self.min_range_m)
        if self.max_range_m is not None:
            conditions.append(Throw.range_m <= self.max_range_m)
        return conditions


class History:
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
    database: DatabaseSession,
    wanted: ThrowFilter,
    limit: int,
    *,
    before: str | None = None,
    extra: tuple[ColumnElement[bool], ...] = (),
) -> list[Throw]:
    """The newest throws that match, newest first.

    A filter on distance cannot be served in order of time by one index. The newest few thousand throws
    are looked through first; only a filter that finds too little there is rare enough to sort.
    """
    conditions = [*wanted.equalities(), *extra]
    if before is not None:
        conditions.append(Throw.throw_id < before)
    base = select(Throw).order_by(Throw.throw_id.desc())
    ranges = wanted.ranges()
    if not ranges:
        return _all(database, base.where(*conditions).limit(limit))
    edge = database.scalar(
        select(Throw.throw_id)
        .where(*conditions)
        .order_by(Throw.throw_id.desc())
        .offset(PROBE_COUNT)
        .limit(1)
    )
    near = [] if edge is None else [Throw.throw_id >= edge]
    rows = _all(database, base.where(*conditions, *ranges, *near).limit(limit))
    if len(rows) >= limit or edge is None:
        return rows
    return rows + _all(
        database,
        base.where(*conditions, *ranges, Throw.throw_id < edge).limit(limit - len(rows)),
    )


def _all(database: DatabaseSession, query: Select[Throw]) -> list[Throw]:
    return list(database.scalars(query))


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
