"""Rows of diagnoses: written as they go on, read for the console; nothing is ever deleted."""

import zlib

from sqlalchemy import select, update
from sqlalchemy.orm import undefer

from diagnosis.report.diagnosis_words import words_of
from diagnosis.report.vocabulary import compared_words
from diagnosis.verdict import Diagnosis, VerdictKind
from server.clock import utc_now
from server.errors import ConflictError, NotFoundError
from server.schemas.gap import GapRunPage, GapRunRow, GapRunView, GapState
from server.store.database import Database
from server.store.models import GapRun

OPEN_STATES = (GapState.QUEUED.value, GapState.RUNNING.value)

USUAL_COUNT = 5
"""Earlier diagnoses whose times are shown for the next one."""


class GapStore:
    """All diagnoses in the database."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def interrupt_all(self) -> None:
        """After a restart nobody works on what was open."""
        with self._database.write() as session:
            session.execute(
                update(GapRun)
                .where(GapRun.state.in_(OPEN_STATES))
                .values(
                    state=GapState.INTERRUPTED.value,
                    detail="The server ended before the diagnosis did. Start it again.",
                    ended_utc=utc_now(),
                )
            )

    def change(self, gap_run_id: str, **values: object) -> GapRun:
        """Set columns of a run; returns its row."""
        with self._database.write() as session:
            session.execute(update(GapRun).where(GapRun.gap_run_id == gap_run_id).values(**values))
        return self.row(gap_run_id)

    def row(self, gap_run_id: str, machine_id: str | None = None) -> GapRun:
        """A run's row, without its result.

        Raises:
            NotFoundError: there is none, or it is another machine's.
        """
        with self._database.read() as session:
            row = session.get(GapRun, gap_run_id)
        if row is None or machine_id not in (None, row.machine_id):
            raise NotFoundError("no_gap_run", f"There is no diagnosis '{gap_run_id[:40]}' here.")
        return row

    def usual_s(self, *, has_reference: bool) -> tuple[float, float] | None:
        """Shortest and longest time of the newest finished diagnoses, of any machine; None without any.

        Args:
            has_reference: whether they were compared with reference throws.
        """
        wanted = select(GapRun).where(GapRun.state == GapState.DONE.value)
        newest = wanted.order_by(GapRun.gap_run_id.desc()).limit(4 * USUAL_COUNT)
        with self._database.read() as session:
            rows = session.scalars(newest).all()
        times_s = [
            (row.ended_utc - row.started_utc).total_seconds()
            for row in rows
            if row.ended_utc is not None
            and row.started_utc is not None
            and bool(row.reference_throw_ids) == has_reference
        ][:USUAL_COUNT]
        return (min(times_s), max(times_s)) if times_s else None

    def result(self, gap_run_id: str, machine_id: str) -> Diagnosis | None:
        """What a run found."""
        self.row(gap_run_id, machine_id)
        with self._database.read() as session:
            row = session.get(GapRun, gap_run_id, options=[undefer(GapRun.result)])
            stored = None if row is None else row.result
        return None if stored is None else Diagnosis.model_validate(stored)

    def report(self, gap_run_id: str, machine_id: str) -> bytes:
        """The HTML page of a run.

        Raises:
            ConflictError: it has none.
        """
        state = self.row(gap_run_id, machine_id).state
        with self._database.read() as session:
            row = session.get(GapRun, gap_run_id, options=[undefer(GapRun.report)])
            packed = None if row is None else row.report
        if packed is None:
            raise ConflictError("no_report", f"This diagnosis has no report: it is {state}.")
        return zlib.decompress(packed)

    def page(self, machine_id: str, cursor: str | None, limit: int) -> GapRunPage:
        """Runs of a machine, newest first."""
        wanted = select(GapRun).where(GapRun.machine_id == machine_id)
        if cursor is not None:
            wanted = wanted.where(GapRun.gap_run_id < cursor)
        with self._database.read() as session:
            rows = session.scalars(wanted.order_by(GapRun.gap_run_id.desc()).limit(limit + 1)).all()
        return GapRunPage(
            rows=tuple(gap_row(row) for row in rows[:limit]),
            next_cursor=rows[limit - 1].gap_run_id if len(rows) > limit else None,
        )

    def view(self, gap_run_id: str, machine_id: str) -> GapRunView:
        """One run with its result."""
        row = self.row(gap_run_id, machine_id)
        result = self.result(gap_run_id, machine_id)
        return GapRunView(
            row=gap_row(row),
            throw_ids=tuple(str(throw_id) for throw_id in row.throw_ids),
            reference_throw_ids=tuple(str(throw_id) for throw_id in row.reference_throw_ids),
            result=result,
            words=None if result is None else words_of(result),
        )


def gap_row(row: GapRun, progress_ratio: float = 0.0, step: str = "") -> GapRunRow:
    """A run for the console."""
    is_done = row.state == GapState.DONE.value
    return GapRunRow(
        gap_run_id=row.gap_run_id,
        machine_id=row.machine_id,
        created_by=row.created_by,
        created_utc=row.created_utc,
        started_utc=row.started_utc,
        ended_utc=row.ended_utc,
        state=GapState(row.state),
        progress_ratio=1.0 if is_done else progress_ratio,
        step=step,
        detail=row.detail,
        throw_count=len(row.throw_ids),
        reference_throw_count=len(row.reference_throw_ids),
        compared_with=compared_words(len(row.reference_throw_ids)),
        profile_version_count=row.profile_version_count,
        verdict=None if row.verdict is None else VerdictKind(row.verdict),
        sentence=row.sentence,
        effect_count=row.effect_count,
        applied_version_count=row.applied_version_count,
    )
