"""Versions of twin profiles: the findings of a diagnosis are applied or undone, each as a new version.

A version's number is never used twice, so that a plan's `twin_profile_version` always names one content.
"""

import threading

from sqlalchemy import func, select
from sqlalchemy.orm import Session as DatabaseSession

from diagnosis.correction import corrected_profile
from diagnosis.verdict import Diagnosis
from server.accounts.accounts import Session
from server.accounts.audit_chain import AuditChain, Entry
from server.clock import utc_now
from server.errors import ConflictError
from server.event_hub import EventHub
from server.gap.gap_store import GapStore
from server.machines.machine_registry import MachineRegistry
from server.machines.twin_files import TwinFiles, content_sha256
from server.schemas.events import TwinUpdatedEvent
from server.schemas.gap import TwinProfileView, TwinVersionView
from server.store.database import Database
from server.store.models import GapRun, TwinVersion
from sim_twin.twin.profile import TwinProfile

SHOWN_COUNT = 20


class TwinVersions:
    """Applies and undoes versions of twin profiles."""

    def __init__(
        self,
        database: Database,
        audit: AuditChain,
        registry: MachineRegistry,
        twins: TwinFiles,
        runs: GapStore,
        hub: EventHub,
    ) -> None:
        self._database = database
        self._audit = audit
        self._registry = registry
        self._twins = twins
        self._runs = runs
        self._hub = hub
        self._lock = threading.Lock()

    def view(self, machine_id: str) -> TwinProfileView:
        """The profile in use and where it came from."""
        self._registry.get(machine_id)
        profile = self._twins.profile(machine_id)
        with self._database.read() as database:
            newest = self._newest(database, machine_id)
            rows = database.scalars(
                select(TwinVersion)
                .where(TwinVersion.machine_id == machine_id)
                .order_by(TwinVersion.version_count.desc())
                .limit(SHOWN_COUNT)
            ).all()
        return TwinProfileView(
            machine_id=machine_id,
            version_count=profile.version_count,
            note=profile.note,
            effects=profile.effects,
            undo_version_count=None if newest is None else newest.before_version_count,
            versions=tuple(
                TwinVersionView(
                    version_count=row.version_count,
                    before_version_count=row.before_version_count,
                    cause="applied" if row.cause == "applied" else "undone",
                    gap_run_id=row.gap_run_id,
                    created_by=row.created_by,
                    created_utc=row.created_utc,
                )
                for row in rows
            ),
        )

    def corrected(self, machine_id: str, gap_run_id: str) -> TwinProfile:
        """The profile in use with what a run found.

        Raises:
            ConflictError: nothing to apply, applied already, or the profile is not the run's any more.
        """
        row = self._runs.row(gap_run_id, machine_id)
        found = self._runs.result(gap_run_id, machine_id)
        if found is None or row.effect_count == 0:
            raise ConflictError(
                "nothing_to_apply",
                f"This diagnosis names no effect to add: {row.verdict or row.state}.",
            )
        if row.applied_version_count is not None:
            raise ConflictError(
                "already_applied",
                f"This diagnosis was applied as version {row.applied_version_count}.",
            )
        return self._corrected(machine_id, row, found)

    def compared(self, machine_id: str, gap_run_id: str) -> tuple[TwinProfile, TwinProfile]:
        """Profiles without and with what a run found: of one in use what it was applied to, and itself.

        Raises:
            ConflictError: as for `corrected`, where the run is not in use.
        """
        self._runs.row(gap_run_id, machine_id)
        present = self._twins.profile(machine_id)
        with self._database.read() as database:
            newest = self._newest(database, machine_id)
        if newest is not None and newest.gap_run_id == gap_run_id and newest.before_file:
            return self._twins.kept(newest.before_file), present
        return present, self.corrected(machine_id, gap_run_id)

    def _corrected(self, machine_id: str, row: GapRun, found: Diagnosis) -> TwinProfile:
        profile = self._twins.profile(machine_id)
        if content_sha256(profile) != row.profile_sha256:
            raise ConflictError(
                "profile_changed",
                f"The throws were compared with twin profile {row.profile_version_count}; in use is "
                f"{profile.version_count}, which says something else. Diagnose again.",
            )
        note = f"{profile.note}; diagnosis {row.gap_run_id} of {len(row.throw_ids)} throws"
        return corrected_profile(profile, found, machine_id, note)

    def apply(self, machine_id: str, gap_run_id: str, session: Session) -> TwinProfileView:
        """Put what a run found in use.

        Raises:
            ConflictError: as for `corrected`.
        """
        with self._lock:
            profile = self.corrected(machine_id, gap_run_id)
            present = self._twins.profile(machine_id)
            with self._database.write() as database:
                row = self._row(database, machine_id, session, "applied")
                row.gap_run_id = gap_run_id
                row.before_version_count = present.version_count
                row.before_file = self._use(row, profile)
                database.add(row)
                self._mark(database, gap_run_id, row.version_count)
                self._record(database, row, session, present.version_count, gap_run_id)
        return self._announced_view(machine_id)

    def undo(self, machine_id: str, session: Session) -> TwinProfileView:
        """Go back to the version before, as a new version that has that version's past.

        Raises:
            ConflictError: the profile in use was not applied here.
        """
        self._registry.get(machine_id)
        with self._lock, self._database.write() as database:
            newest = self._newest(database, machine_id)
            if newest is None or newest.before_file is None:
                raise ConflictError(
                    "nothing_to_undo",
                    f"Nothing was applied to the twin of {machine_id} that could be undone.",
                )
            earlier = database.get(TwinVersion, (machine_id, newest.before_version_count))
            row = self._row(database, machine_id, session, "undone")
            if earlier is not None:
                row.gap_run_id = earlier.gap_run_id
                row.before_version_count = earlier.before_version_count
                row.before_file = earlier.before_file
            self._use(row, self._twins.kept(newest.before_file))
            database.add(row)
            self._mark(database, newest.gap_run_id, None)
            self._record(database, row, session, newest.version_count, newest.gap_run_id)
        return self._announced_view(machine_id)

    def _newest(self, database: DatabaseSession, machine_id: str) -> TwinVersion | None:
        """The row of the profile in use; None for a file that somebody else has put there."""
        row = database.get(TwinVersion, (machine_id, self._twins.profile_version(machine_id)))
        if row is None or row.profile_sha256 != content_sha256(self._twins.profile(machine_id)):
            return None
        return row

    def _row(
        self, database: DatabaseSession, machine_id: str, session: Session, cause: str
    ) -> TwinVersion:
        """A version with the next number that was never used."""
        newest = database.scalar(
            select(func.max(TwinVersion.version_count)).where(TwinVersion.machine_id == machine_id)
        )
        return TwinVersion(
            machine_id=machine_id,
            version_count=max(self._twins.profile_version(machine_id), newest or 0) + 1,
            cause=cause,
            created_by=session.username,
            created_utc=utc_now(),
        )

    def _use(self, row: TwinVersion, profile: TwinProfile) -> str:
        """Write the profile as this version; returns where the present one is kept."""
        row.profile_sha256 = content_sha256(profile)
        numbered = profile.model_copy(update={"version_count": row.version_count})
        return self._twins.replace(row.machine_id, numbered)

    @staticmethod
    def _mark(database: DatabaseSession, gap_run_id: str | None, version_count: int | None) -> None:
        run = None if gap_run_id is None else database.get(GapRun, gap_run_id)
        if run is not None:
            run.applied_version_count = version_count

    def _record(
        self,
        database: DatabaseSession,
        row: TwinVersion,
        session: Session,
        from_version_count: int,
        gap_run_id: str | None,
    ) -> None:
        self._audit.append(
            database,
            Entry(
                session.actor,
                "twin.apply" if row.cause == "applied" else "twin.undo",
                "fact",
                machine_id=row.machine_id,
                detail={
                    "gap_run_id": gap_run_id,
                    "from_version_count": from_version_count,
                    "version_count": row.version_count,
                    "profile_sha256": row.profile_sha256,
                },
            ),
        )

    def _announced_view(self, machine_id: str) -> TwinProfileView:
        view = self.view(machine_id)
        self._hub.publish(TwinUpdatedEvent(machine_id=machine_id, version_count=view.version_count))
        return view
