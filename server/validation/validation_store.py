"""Rows of validations: written as they go on, read for the console; nothing is ever deleted."""

from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session, undefer

from evaluation.validation.gates import Gates
from evaluation.validation.results import UnitLandings, ValidationPlan
from evaluation.validation.validation import ValidationResult
from server.accounts.audit_chain import SERVER
from server.clock import utc_now
from server.errors import NotFoundError
from server.plans.policy_life import change_state, state_of
from server.schemas.policies import PolicyState
from server.schemas.validation import ValidationState, ValidationView
from server.store.database import Database
from server.store.models import Policy
from server.store.validation_tables import PolicyValidation, PolicyValidationPart

OPEN_STATES = (ValidationState.QUEUED.value, ValidationState.RUNNING.value)


class ValidationStore:
    """All validations in the database."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def begin(self, validation_id: str) -> PolicyValidation:
        """A validation begins to run, or goes on after a restart; its version is validating.

        An approved version stays approved: it is validated without a step of its life.
        """
        with self._database.write() as session:
            row = self._row(session, validation_id)
            row.state = ValidationState.RUNNING.value
            row.started_utc = row.started_utc or utc_now()
            if state_of(session, row.policy_sha256) in (
                PolicyState.UPLOADED,
                PolicyState.VALIDATED,
            ):
                change_state(
                    session,
                    row.policy_sha256,
                    PolicyState.VALIDATING,
                    actor=row.created_by,
                    reason=f"{row.plan['protocol']} validation",
                    evidence={"validation_id": validation_id},
                )
        return row

    def end(
        self,
        validation_id: str,
        state: ValidationState,
        detail: str,
        result: ValidationResult | None = None,
    ) -> None:
        """A validation has ended: its version is validated, or uploaded again; the result is the evidence."""
        with self._database.write() as session:
            row = self._row(session, validation_id)
            row.state, row.detail, row.ended_utc = state.value, detail, utc_now()
            is_passed = result is not None and result.is_passed
            if result is not None:
                row.is_passed, row.result = result.is_passed, result.model_dump(mode="json")
            if state_of(session, row.policy_sha256) is PolicyState.VALIDATING:
                change_state(
                    session,
                    row.policy_sha256,
                    PolicyState.VALIDATED if is_passed else PolicyState.UPLOADED,
                    actor=SERVER.name,
                    reason=_reason(state, detail, result),
                    evidence=_evidence(validation_id, result),
                )

    def open_ids(self) -> list[str]:
        """Validations that are to be carried out, oldest first."""
        wanted = select(PolicyValidation.validation_id).where(
            PolicyValidation.state.in_(OPEN_STATES)
        )
        with self._database.read() as session:
            return list(session.scalars(wanted.order_by(PolicyValidation.validation_id)))

    def row(self, validation_id: str) -> PolicyValidation:
        """A validation's row, without its result.

        Raises:
            NotFoundError: there is none.
        """
        with self._database.read() as session:
            return self._row(session, validation_id)

    @staticmethod
    def _row(session: Session, validation_id: str) -> PolicyValidation:
        row = session.get(PolicyValidation, validation_id)
        if row is None:
            raise NotFoundError("no_validation", f"There is no validation '{validation_id[:40]}'.")
        return row

    def keep_part(self, validation_id: str, part: str, landings: UnitLandings) -> None:
        """Keep a part that has ended; a repeated one changes nothing."""
        with self._database.write() as session:
            if session.get(PolicyValidationPart, (validation_id, part)) is None:
                session.add(
                    PolicyValidationPart(
                        validation_id=validation_id,
                        part=part,
                        landings=landings.model_dump(mode="json"),
                    )
                )

    def parts(self, validation_id: str) -> dict[str, UnitLandings]:
        """Parts that have ended, by name."""
        wanted = select(PolicyValidationPart).where(
            PolicyValidationPart.validation_id == validation_id
        )
        with self._database.read() as session:
            rows = session.scalars(wanted).all()
        return {row.part: UnitLandings.model_validate(row.landings) for row in rows}

    def newest(self, policy_sha256: str, limit: int = 1) -> list[ValidationView]:
        """Newest validations of a version, with their results."""
        wanted = (
            select(PolicyValidation, Policy.policy_id)
            .join(Policy, Policy.policy_sha256 == PolicyValidation.policy_sha256)
            .where(PolicyValidation.policy_sha256 == policy_sha256)
            .order_by(PolicyValidation.validation_id.desc())
            .limit(limit)
            .options(undefer(PolicyValidation.result))
        )
        with self._database.read() as session:
            return [_view(row, name) for row, name in session.execute(wanted)]

    def results(self, policy_sha256: str, limit: int) -> list[ValidationResult]:
        """Newest results in which a version threw, as candidate or as the active one."""
        wanted = (
            select(PolicyValidation.result)
            .where(
                (PolicyValidation.policy_sha256 == policy_sha256)
                | (PolicyValidation.active_sha256 == policy_sha256),
                PolicyValidation.state == ValidationState.DONE.value,
            )
            .order_by(PolicyValidation.validation_id.desc())
            .limit(limit)
        )
        with self._database.read() as session:
            stored: list[dict[str, Any] | None] = list(session.scalars(wanted))
        return [ValidationResult.model_validate(result) for result in stored if result is not None]


def _view(row: PolicyValidation, policy_id: str) -> ValidationView:
    state = ValidationState(row.state)
    return ValidationView(
        validation_id=row.validation_id,
        policy_sha256=row.policy_sha256,
        policy_id=policy_id,
        active_sha256=row.active_sha256,
        created_by=row.created_by,
        created_utc=row.created_utc,
        started_utc=row.started_utc,
        ended_utc=row.ended_utc,
        state=state,
        progress_ratio=1.0 if state is ValidationState.DONE else 0.0,
        step="",
        detail=row.detail,
        plan=ValidationPlan.model_validate(row.plan),
        gates=Gates.model_validate(row.gates),
        is_passed=row.is_passed,
        result=None if row.result is None else ValidationResult.model_validate(row.result),
    )


def _reason(state: ValidationState, detail: str, result: ValidationResult | None) -> str:
    if result is None:
        return f"validation {state.value}: {detail}" if detail else f"validation {state.value}"
    missed = [check.name for check in result.checks if not check.is_passed]
    if not missed:
        return f"passed all {len(result.checks)} gates"
    return f"{len(missed)} of {len(result.checks)} gates not passed: {', '.join(missed)}"


def _evidence(validation_id: str, result: ValidationResult | None) -> dict[str, Any]:
    """What the step rests on: the validation, and the number of each gate."""
    checks = () if result is None else result.checks
    gates = {check.gate: {"value": check.value, "limit": check.limit} for check in checks}
    return {"validation_id": validation_id, **({"gates": gates} if gates else {})}
