"""Aim corrections of machines: proposed from their throws, put in force by a person, undone, withdrawn.

A correction belongs to a policy, a calibration and a twin profile. With anything else it is withdrawn, and it
comes back only when a person applies one again.
"""

import hashlib
import threading
from typing import Final, NamedTuple

import numpy as np
from pydantic import JsonValue
from sqlalchemy import func, select
from sqlalchemy.orm import Session as DatabaseSession

from machine.conventions import Mode
from machine.messages import (
    AimShift,
    EventKind,
    MachineEvent,
    MachineState,
    RejectReason,
    Target,
    ThrowPlan,
)
from machine.registration import Registration, too_much
from server.accounts.accounts import Session
from server.accounts.audit_chain import SERVER, Actor, AuditChain, Entry
from server.aim.aim_views import AimModeView, AimProposal, AimVersionView, AimView
from server.aim.bias_map import Misses, bias_map, expected_gain, is_correctable
from server.aim.surveyed_misses import SurveyedMisses, surveyed_misses
from server.clock import utc_now
from server.errors import ConflictError, from_reason
from server.machines.machine_registry import MachineRegistry
from server.machines.twin_files import TwinFiles, content_sha256
from server.plans.policy_store import PolicyStore
from server.store.aim_tables import AimCorrection
from server.store.database import Database

LEAST_COUNT: Final = 20
"""Measured throws from which a correction is made: five folds of four."""
SHOWN_COUNT: Final = 20
"""Versions in a view."""


class AimKey(NamedTuple):
    """What a correction belongs to."""

    policy_sha256: str
    calibration_sha256: str
    profile_sha256: str


class AimCorrections:
    """Keeps the versions; thread-safe."""

    def __init__(
        self,
        database: Database,
        audit: AuditChain,
        registry: MachineRegistry,
        policies: PolicyStore,
        twins: TwinFiles,
    ) -> None:
        self._database = database
        self._audit = audit
        self._registry = registry
        self._policies = policies
        self._twins = twins
        self._lock = threading.RLock()

    # Read -----------------------------------------------------------------------------------------

    def view(self, machine_id: str) -> AimView:
        """What is in force, what is proposed, and what was.

        Raises:
            NotFoundError: no such machine.
        """
        self._registry.get(machine_id)
        modes = tuple(self._mode_view(machine_id, mode) for mode in Mode)
        query = (
            select(AimCorrection)
            .where(AimCorrection.machine_id == machine_id)
            .order_by(AimCorrection.version_count.desc())
            .limit(SHOWN_COUNT)
        )
        with self._database.read() as database:
            rows = database.scalars(query).all()
        return AimView(
            machine_id=machine_id, modes=modes, history=tuple(self._version(row) for row in rows)
        )

    def _mode_view(self, machine_id: str, mode: Mode) -> AimModeView:
        key = self._key(machine_id, mode)
        row = self._in_force(machine_id, mode)
        known = _NOT_KNOWN if key is None else self._surveyed(machine_id, mode, key)
        proposal, problem = None, "The machine has not said yet what it throws with."
        if key is not None:
            present = None if row is None else AimProposal.model_validate(row.content).table
            proposal, problem = _proposal(key, known, present)
        return AimModeView(
            mode=mode,
            in_force=None if row is None else self._version(row),
            proposal=proposal,
            proposal_sha256=None if proposal is None else _sha256(proposal),
            throw_count=len(known.throw_ids),
            problem=problem,
        )

    def shift(self, machine_id: str, mode: Mode, target: Target) -> AimShift | None:
        """The correction for a target; None where none is in force."""
        row = self._in_force(machine_id, mode)
        if row is None:
            return None
        table = AimProposal.model_validate(row.content).table
        range_m, zero = np.array([np.hypot(target.x_m, target.y_m)]), np.zeros(1)
        along, across = table.miss(range_m, np.array([target.z_m]), zero)
        return AimShift(
            version_count=row.version_count,
            downrange_m=round(float(along[0]), 4),
            crossrange_m=round(float(across[0]), 4),
            policy_sha256=row.policy_sha256,
            calibration_sha256=row.calibration_sha256,
        )

    def require_current(self, plan: ThrowPlan) -> None:
        """Refuse a plan that was made with another correction than is in force.

        Raises:
            ApiError: the correction was changed since the preview.
        """
        row = self._in_force(plan.machine_id, plan.mode)
        held = None if plan.aim is None else plan.aim.version_count
        if held != (None if row is None else row.version_count):
            raise from_reason(
                RejectReason.AIM_MISMATCH,
                "The aim correction was changed since the preview. Preview again.",
            )

    # Change ---------------------------------------------------------------------------------------

    def apply(self, machine_id: str, mode: Mode, proposal_sha256: str, session: Session) -> AimView:
        """Put the proposal that was shown in force.

        Raises:
            ConflictError: throws have come since, or what the machine throws with has changed.
        """
        with self._lock:
            shown = self._mode_view(machine_id, mode)
            key = self._key(machine_id, mode)
            if key is None or shown.proposal is None or shown.proposal_sha256 != proposal_sha256:
                raise ConflictError(
                    "aim_proposal_changed",
                    "There are other throws, or another policy, calibration or twin profile, than "
                    "when this was proposed. Look at it again.",
                )
            with self._database.write() as database:
                before = self._row(database, machine_id, mode)
                if before is not None:
                    self._end(database, before, session.actor, "replaced")
                self._add(database, machine_id, mode, key, shown.proposal, before, session)
        return self.view(machine_id)

    def undo(self, machine_id: str, mode: Mode, session: Session) -> AimView:
        """End what is in force; the version before comes back as a new one, if it still fits.

        Raises:
            ConflictError: nothing is in force.
        """
        with self._lock:
            self._in_force(machine_id, mode)
            key = self._key(machine_id, mode)
            with self._database.write() as database:
                row = self._row(database, machine_id, mode)
                if row is None:
                    raise ConflictError(
                        "no_aim_correction",
                        f"No aim correction of {machine_id} is in force in {mode.value}.",
                    )
                self._end(database, row, session.actor, "undone")
                earlier = None
                if row.before_version_count is not None:
                    earlier = database.get(AimCorrection, (machine_id, row.before_version_count))
                if earlier is not None and key is not None and _key_of(earlier) == key:
                    content = AimProposal.model_validate(earlier.content)
                    self._add(database, machine_id, mode, key, content, earlier, session, "undone")
        return self.view(machine_id)

    def take_event(self, event: MachineEvent) -> None:
        """An event that has been stored may say that a machine throws with something else."""
        if event.kind in (EventKind.BOOTED, EventKind.POLICY_SWITCHED, EventKind.POLICY_REFUSED):
            for mode in Mode:
                self._in_force(event.machine_id, mode)

    # Parts ----------------------------------------------------------------------------------------

    def _key(self, machine_id: str, mode: Mode) -> AimKey | None:
        """What the machine throws with now; None where it has not said so."""
        state: MachineState | None = self._registry.get(machine_id).state
        policy_sha256 = None if state is None else state.policy_sha256.get(mode.value)
        if state is None or policy_sha256 is None or state.calibration_sha256 is None:
            return None
        profile_sha256 = content_sha256(self._twins.profile(machine_id))
        return AimKey(policy_sha256, state.calibration_sha256, profile_sha256)

    def _in_force(self, machine_id: str, mode: Mode) -> AimCorrection | None:
        """The version in force; one that does not fit any more is withdrawn."""
        with self._database.read() as database:
            row = self._row(database, machine_id, mode)
        if row is None:
            return None
        key = self._key(machine_id, mode)
        if key is None:
            # Nothing is thrown with it before the machine has said what it has.
            return None
        reason = _withdrawal(row, key)
        if not reason:
            return row
        with self._lock, self._database.write() as database:
            row = self._row(database, machine_id, mode)
            if row is not None and (reason := _withdrawal(row, key)):
                self._end(database, row, SERVER, reason)
        return None

    @staticmethod
    def _row(database: DatabaseSession, machine_id: str, mode: Mode) -> AimCorrection | None:
        return database.scalars(
            select(AimCorrection)
            .where(
                AimCorrection.machine_id == machine_id,
                AimCorrection.mode == mode.value,
                AimCorrection.ended_utc.is_(None),
            )
            .order_by(AimCorrection.version_count.desc())
            .limit(1)
        ).first()

    def _add(
        self,
        database: DatabaseSession,
        machine_id: str,
        mode: Mode,
        key: AimKey,
        content: AimProposal,
        before: AimCorrection | None,
        session: Session,
        cause: str = "applied",
    ) -> None:
        newest = database.scalar(
            select(func.max(AimCorrection.version_count)).where(
                AimCorrection.machine_id == machine_id
            )
        )
        back = None if before is None else before.version_count
        if cause == "undone" and before is not None:
            back = before.before_version_count
        row = AimCorrection(
            machine_id=machine_id,
            version_count=(newest or 0) + 1,
            mode=mode.value,
            **key._asdict(),
            content=content.model_dump(mode="json"),
            before_version_count=back,
            cause=cause,
            created_by=session.username,
            created_utc=utc_now(),
            end_reason="",
        )
        database.add(row)
        database.flush()
        self._record(database, row, session.actor, "aim.apply")

    def _end(
        self, database: DatabaseSession, row: AimCorrection, actor: Actor, reason: str
    ) -> None:
        row.ended_utc, row.ended_by, row.end_reason = utc_now(), actor.name, reason
        database.flush()
        self._record(database, row, actor, "aim.end")

    def _record(
        self, database: DatabaseSession, row: AimCorrection, actor: Actor, action: str
    ) -> None:
        detail: dict[str, JsonValue] = {
            "version_count": row.version_count,
            "mode": row.mode,
            "policy_sha256": row.policy_sha256,
            "reason": row.end_reason or row.cause,
        }
        self._audit.append(
            database, Entry(actor, action, "fact", machine_id=row.machine_id, detail=detail)
        )

    def _surveyed(self, machine_id: str, mode: Mode, key: AimKey) -> SurveyedMisses:
        return surveyed_misses(
            self._database,
            machine_id,
            mode,
            policy_sha256=key.policy_sha256,
            calibration_sha256=key.calibration_sha256,
            twin_profile_version=self._twins.profile_version(machine_id),
        )

    def _version(self, row: AimCorrection) -> AimVersionView:
        return AimVersionView(
            version_count=row.version_count,
            mode=Mode(row.mode),
            policy_sha256=row.policy_sha256,
            policy_id=self._policies.name_of(row.policy_sha256),
            cause="undone" if row.cause == "undone" else "applied",
            created_by=row.created_by,
            created_utc=row.created_utc,
            ended_utc=row.ended_utc,
            ended_by=row.ended_by,
            end_reason=row.end_reason,
            content=AimProposal.model_validate(row.content),
        )


_NOT_KNOWN = SurveyedMisses((), Misses(*(np.zeros(0) for _ in Misses._fields)))


def _proposal(
    key: AimKey, known: SurveyedMisses, present: Registration | None
) -> tuple[AimProposal | None, str]:
    """A correction from these throws, or why there is none."""
    count = len(known.throw_ids)
    if count < LEAST_COUNT:
        thrown = "1 measured throw" if count == 1 else f"{count} measured throws"
        return None, (
            f"{thrown} with this policy, calibration and twin profile; {LEAST_COUNT} are needed."
        )
    found = bias_map(known.misses)
    if not is_correctable(found):
        worst = max(abs(found.along_m).max(), abs(found.across_m).max())
        return None, f"{too_much(float(worst)).capitalize()}."
    try:
        gain = expected_gain(known.misses, present)
    except ValueError as error:
        return None, f"{str(error).capitalize()}."
    if gain.low_m <= 0.0:
        return None, (
            f"{count} throws show no bias that a correction would remove: on held-out throws the "
            f"distance from the target would change by {-gain.gain_m:+.3f} m "
            f"({-gain.high_m:+.3f} to {-gain.low_m:+.3f} m)."
        )
    proposal = AimProposal(
        table=found.registration(key.policy_sha256, count),
        downrange_sd_m=tuple(found.along_sd_m.tolist()),
        crossrange_sd_m=tuple(found.across_sd_m.tolist()),
        throw_count=count,
        newest_throw_id=known.throw_ids[-1],
        before_m=gain.before_m,
        after_m=gain.after_m,
        gain_low_m=gain.low_m,
        gain_high_m=gain.high_m,
    )
    return proposal, ""


def _sha256(proposal: AimProposal) -> str:
    return hashlib.sha256(proposal.model_dump_json().encode()).hexdigest()


def _key_of(row: AimCorrection) -> AimKey:
    return AimKey(row.policy_sha256, row.calibration_sha256, row.profile_sha256)


def _withdrawal(row: AimCorrection, key: AimKey) -> str:
    """Why a version does not fit what the machine throws with; empty: it fits."""
    names = ("policy", "calibration", "twin profile")
    changed = [name for name, a, b in zip(names, _key_of(row), key, strict=True) if a != b]
    return f"withdrawn: another {' and '.join(changed)}" if changed else ""
