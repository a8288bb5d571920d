"""What an approval rests on: a validation of the same files that passed the gates in force."""

from dataclasses import dataclass
from typing import Final

from pydantic import JsonValue
from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession
from sqlalchemy.orm import undefer

from evaluation.validation.gates import GateCheck, Gates, check_gates
from evaluation.validation.validation import ValidationResult
from machine.errors import PolicyError
from machine.policy_card import PolicyFiles, read_policy
from machine.spec import load_spec
from runtime.control.policy_check import check_version
from server.accounts.audit_chain import AuditChain
from server.deployments.policy_checks import check_in_child
from server.errors import ConflictError, NotFoundError
from server.plans.policy_store import PolicyStore, StoredPolicy
from server.schemas.validation import ValidationState
from server.store.database import Database
from server.store.validation_tables import PolicyValidation
from server.validation.gate_settings import GateSettings

SHOWN_COUNT: Final = 3
"""Gates that a refusal names with their numbers."""


@dataclass(frozen=True, slots=True)
class ApprovalBasis:
    """Whether a version may be approved by its validation, and why."""

    is_validated: bool
    sentence: str
    evidence: dict[str, JsonValue]
    """Facts for the version's history."""


class VersionChecks:
    """What is looked at before a version is approved."""

    def __init__(self, database: Database, audit: AuditChain, policies: PolicyStore) -> None:
        self._database = database
        self._policies = policies
        self._gates = GateSettings(database, audit)

    def read(self, policy_sha256: str) -> tuple[StoredPolicy, PolicyFiles]:
        """A version and its files, read once.

        Raises:
            NotFoundError: there are none, or they cannot be read.
        """
        policy = self._policies.find(policy_sha256)
        if policy is None:
            raise NotFoundError(
                "no_policy", f"There are no files of policy {policy_sha256[:12]} here."
            )
        try:
            return policy, read_policy(policy.folder)
        except PolicyError as error:
            raise NotFoundError("no_policy", f"It cannot be read: {error}.") from error

    def basis(self, files: PolicyFiles) -> ApprovalBasis:
        """What an approval would rest on now."""
        gates = self._gates.view(files.card.mode).gates
        with self._database.read() as database:
            return approval_basis(database, files, gates)

    def require_usable(self, policy: StoredPolicy, files: PolicyFiles) -> None:
        """Check as a machine does: network, card, machine model, golden vectors.

        What came with the software is trusted as the server's own code is; the rest is loaded apart.

        Raises:
            ConflictError: a machine would not load it, with the reason.
        """
        try:
            if self._policies.is_installed(policy):
                check_version(files, load_spec())
            else:
                check_in_child(files)
        except PolicyError as error:
            raise ConflictError("policy_unusable", f"It cannot be approved: {error}.") from error


def approval_basis(database: DatabaseSession, files: PolicyFiles, gates: Gates) -> ApprovalBasis:
    """Look at the newest finished validation of a version, network and card alike.

    Args:
        database: a transaction.
        files: the version as it is to be approved.
        gates: in force for its mode; numbers of a validation from before a change are checked again.
    """
    name = files.card.policy_id
    row = database.scalars(
        select(PolicyValidation)
        .where(
            PolicyValidation.policy_sha256 == files.card.policy_sha256,
            PolicyValidation.state == ValidationState.DONE.value,
        )
        .order_by(PolicyValidation.validation_id.desc())
        .limit(1)
        .options(undefer(PolicyValidation.result))
    ).first()
    if row is None or row.result is None:
        return _without(f"{name} has no finished validation.")
    if row.card_sha256 != files.card_sha256:
        return _without(f"{name} was validated with another card than it has now.")
    result = ValidationResult.model_validate(row.result)
    checks = check_gates(gates, result.candidate, result.active)
    missed = [check for check in (*result.checks, *checks) if not check.is_passed]
    if missed:
        # A gate that was missed then and is missed now is named once.
        by_gate = {check.gate: check for check in missed}
        shown = "; ".join(_shown(check) for check in list(by_gate.values())[:SHOWN_COUNT])
        return _without(
            f"{name} did not pass {len(by_gate)} of {len(checks)} gates in its newest validation: {shown}."
        )
    count = result.candidate.throw_count
    return ApprovalBasis(
        is_validated=True,
        sentence=f"{name} passed all {len(checks)} gates in force with {count} throws in virtual machines.",
        evidence={
            "validation_id": row.validation_id,
            "throw_count": count,
            "gates": {check.gate: {"value": check.value, "limit": check.limit} for check in checks},
        },
    )


def _without(sentence: str) -> ApprovalBasis:
    return ApprovalBasis(
        is_validated=False,
        sentence=sentence,
        evidence={"is_without_validation": True, "cause": sentence},
    )


def _shown(check: GateCheck) -> str:
    value = "no number" if check.value is None else f"{check.value:.3g}"
    unit = "" if check.unit in ("ratio", "times") else f" {check.unit}"
    return f"{check.name} {value}{unit}, limit {check.limit:.3g}{unit}"
