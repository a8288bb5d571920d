"""The site's key, and the versions that it has approved; machines load nothing else.

Both lie in `DATA/policy-approvals`: the private key readable by its owner alone, and what machines are given.
"""

import base64
import logging
import os
import shutil
import threading
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from pydantic import JsonValue

from machine.errors import DownrangeError, PolicyError
from machine.policy_approval import (
    Approval,
    SiteKey,
    SiteTrust,
    approve,
    new_private_key,
    public_key,
    revoke_key,
    rotate_key,
    sign,
    sign_list,
)
from machine.policy_card import PolicyFiles, read_policy
from machine.spec import load_spec
from runtime.control.policy_check import check_version
from server.accounts.accounts import Session
from server.accounts.audit_chain import SERVER, Actor, AuditChain, Entry
from server.clock import utc_now
from server.deployments.approval_basis import ApprovalBasis, VersionChecks
from server.deployments.machine_policies import machines_that_need
from server.deployments.site_keys import MAKE_KEY, REVOKE_KEY, ROTATE_KEY, key_views
from server.errors import ApiError, ConflictError, NotFoundError
from server.plans.policy_life import (
    change_state,
    state_before_approval,
    state_of,
    states,
    uploader_of,
    was_withdrawn,
)
from server.plans.policy_store import PolicyStore, StoredPolicy
from server.schemas.policies import PolicyState, SiteKeyView
from server.secret_files import write_secret
from server.store.database import Database

logger = logging.getLogger(__name__)

KEY_FILE: Final = "site.key"
TRUST_FILE: Final = "site.json"
WITHDRAW: Final = "policy.withdraw"
APPROVE_WITHOUT: Final = "policy.approve.without_validation"
FIRST_START: Final = "the site's key at first start"
FIRST_START_REASON: Final = "came with the software"
FIRST_START_STATES: Final = (PolicyState.UPLOADED, PolicyState.VALIDATED, PolicyState.APPROVED)
LISTED_REASON: Final = "the site's signed list holds its approval"


class ApprovalError(DownrangeError):
    """The site's key or its approvals cannot be used."""

    code = "approvals"


@dataclass(frozen=True, slots=True)
class _Step:
    """What is done to a version."""

    action: str
    """For the audit."""
    policy_sha256: str
    to_state: PolicyState
    reason: str
    evidence: dict[str, JsonValue] = field(default_factory=dict)
    """What it rests on."""


class SiteApprovals:
    """Approves, withdraws and retires; thread-safe."""

    def __init__(
        self,
        database: Database,
        audit: AuditChain,
        policies: PolicyStore,
        site: str,
        data_dir: Path,
        *,
        is_four_eyes: bool = False,
    ) -> None:
        """Args: is_four_eyes: the one who uploaded a version may not approve it."""
        self._is_four_eyes = is_four_eyes
        self._database = database
        self._audit = audit
        self._policies = policies
        self._site = site
        self._folder = data_dir / "policy-approvals"
        self._checks = VersionChecks(database, audit, policies)
        self._lock = threading.Lock()
        self._trust = SiteTrust(site=site, keys=())

    def start(self) -> None:
        """Read key and approvals; at the first start make the key and approve what came with the software.

        Raises:
            ApprovalError: they are damaged, or one of the two files is gone.
        """
        has_key, has_trust = (self._folder / KEY_FILE).exists(), self._file.exists()
        if has_key != has_trust:
            raise ApprovalError(
                f"{self._folder} lacks {TRUST_FILE if has_key else KEY_FILE}: bring it back from the "
                "backup, or remove the folder and bind every machine again (docs/policies.md)"
            )
        if has_trust:
            try:
                self._trust = SiteTrust.model_validate_json(self._file.read_bytes())
                self._take_next_key()
                self._require_own_key()
            except (OSError, ValueError) as error:
                raise ApprovalError(f"{self._file} cannot be used: {error}") from error
        else:
            self._begin()
        self._reconcile()

    def _begin(self) -> None:
        """Make the key and the first list; both come into being at once."""
        part = self._folder.with_name(f"{self._folder.name}.part")
        shutil.rmtree(part, ignore_errors=True)
        key = new_private_key()
        write_secret(part / KEY_FILE, base64.b64encode(key).decode() + "\n")
        self._trust = SiteTrust(site=self._site, keys=(public_key(key),))
        approvals: list[Approval] = []
        for policy in self._policies.present():
            if not self._came_with_the_software(policy):
                continue
            try:
                files = read_policy(policy.folder)
                check_version(files, load_spec())
                approvals.append(_signed(files, key, FIRST_START))
            except PolicyError as error:
                logger.warning("%s is not approved: %s", policy.card.policy_id, error)
            else:
                self._note("policy.approve", policy.card.policy_sha256, SERVER)
        self._trust = sign_list(self._trust.model_copy(update={"approvals": tuple(approvals)}), key)
        _write(part / TRUST_FILE, self._trust)
        part.rename(self._folder)
        self._note_key(MAKE_KEY, {"key_id": self._trust.signed_by}, SERVER)
        logger.info("made the site's key and approved %d policy versions by it", len(approvals))

    def _came_with_the_software(self, policy: StoredPolicy) -> bool:
        """Whether no person brought a version, took its approval back or retired it."""
        if not self._policies.is_installed(policy):
            return False
        sha256 = policy.card.policy_sha256
        with self._database.read() as database:
            return (
                uploader_of(database, sha256) == SERVER.name
                and state_of(database, sha256) in FIRST_START_STATES
                and not was_withdrawn(database, sha256, except_by=SERVER.name)
            )

    def trust(self) -> SiteTrust:
        """What machines are given."""
        return self._trust

    def is_approved(self, policy: StoredPolicy) -> bool:
        """Whether the version, as it lies there, is approved."""
        try:
            self._trust.check(read_policy(policy.folder), policy.card.mode)
        except PolicyError:
            return False
        return True

    def catch_up(self) -> None:
        """Let the history say what the list says, for example of files that came after the start."""
        with self._lock:
            self._reconcile()

    def basis(self, policy_sha256: str) -> ApprovalBasis:
        """What an approval of a version would rest on now.

        Raises:
            NotFoundError: no files of such a version, or they cannot be read.
        """
        return self._checks.basis(self._checks.read(policy_sha256)[1])

    def approve(
        self,
        policy_sha256: str,
        reason: str,
        session: Session,
        *,
        is_without_validation: bool = False,
    ) -> Approval:
        """Approve a version.

        Args:
            policy_sha256: the version.
            reason: why, for the history.
            session: who approves.
            is_without_validation: also where no validation of these files passed the gates in force; history
                and audit say so.

        Raises:
            NotFoundError: no files of such a version.
            ConflictError: it is approved already or retired, cannot be used, has not been validated, the one
                who uploaded it asks where two people are required, or the disk refuses.
        """
        policy, files = self._checks.read(policy_sha256)
        self._checks.require_usable(policy, files)
        with self._lock:
            if self.is_approved(policy):
                raise ConflictError("approved", f"{policy.card.policy_id} is approved already.")
            self._require_other_person(policy, session)
            basis = self._checks.basis(files)
            if not (basis.is_validated or is_without_validation):
                raise ConflictError(
                    "not_validated",
                    f"{basis.sentence} Validate it, or approve it without a validation and say why.",
                )
            approval = _signed(files, self._private_key(), session.username)
            others = tuple(a for a in self._trust.approvals if a.policy_sha256 != policy_sha256)
            action = "policy.approve" if basis.is_validated else APPROVE_WITHOUT
            step = _Step(action, policy_sha256, PolicyState.APPROVED, reason, basis.evidence)
            self._change(step, session.actor, (*others, approval))
        return approval

    def withdraw(self, policy_sha256: str, reason: str, session: Session) -> None:
        """Withdraw an approval: machines stop using the version while no plan is armed.

        Raises:
            NotFoundError: the version is not approved.
            ConflictError: the disk refuses.
        """
        with self._lock:
            kept = tuple(a for a in self._trust.approvals if a.policy_sha256 != policy_sha256)
            if len(kept) == len(self._trust.approvals):
                raise NotFoundError(
                    "not_approved", f"Policy {policy_sha256[:12]} has no approval to withdraw."
                )
            # The history may lag behind the list, for example for files that came after the start; a
            # withdrawal is never refused for that.
            self._reconcile()
            with self._database.read() as database:
                before = state_before_approval(database, policy_sha256)
            step = _Step(WITHDRAW, policy_sha256, before, reason)
            self._change(step, session.actor, kept)

    def retire(self, policy_sha256: str, reason: str, session: Session) -> None:
        """Take a version out of use for good; its approval ends with it.

        Raises:
            NotFoundError: the server never met it.
            ConflictError: it is retired already or being validated, the server throws with it, a machine
                runs it, is to switch to it or may go back to it, or the disk refuses.
        """
        with self._lock:
            with self._database.read() as database:
                users = machines_that_need(database, policy_sha256)
            if self._policies.is_active(policy_sha256):
                users.insert(0, "active.json of the policies folder names it")
            self._require_unneeded(policy_sha256, users)
            kept = tuple(a for a in self._trust.approvals if a.policy_sha256 != policy_sha256)
            step = _Step("policy.retire", policy_sha256, PolicyState.RETIRED, reason)
            self._change(step, session.actor, kept)

    def keys(self) -> list[SiteKeyView]:
        """The site's keys, the newest first."""
        with self._database.read() as database:
            return key_views(database, self._trust)

    def sign(self, message: bytes) -> tuple[SiteKey, str]:
        """Sign something other than an approval by the site's key; returns key and signature."""
        with self._lock:
            key = self._private_key()
        return public_key(key), sign(key, message)

    def rotate(self, reason: str, session: Session) -> list[SiteKeyView]:
        """Make a new key and sign everything by it; machines follow by what the old key says.

        Raises:
            ConflictError: the disk refuses.
        """
        with self._lock:
            key = new_private_key()
            detail: dict[str, JsonValue] = {
                "old_key_id": self._trust.signed_by,
                "key_id": public_key(key).key_id,
                "reason": reason,
            }
            self._note_key(ROTATE_KEY, detail, session.actor)
            signed = rotate_key(self._trust, self._private_key(), key, rotated_utc=_utc_text())
            try:
                # A start takes the next key into use where the list knows it, and else removes it.
                write_secret(self._next_key_file, base64.b64encode(key).decode() + "\n")
                _write(self._file, signed)
                self._trust = signed
                self._next_key_file.replace(self._folder / KEY_FILE)
            except OSError as error:
                raise self._disk_error(ROTATE_KEY, detail, session.actor, error) from error
        return self.keys()

    def revoke(self, key_id: str, reason: str, session: Session) -> list[SiteKeyView]:
        """Revoke a key that signs no more: what it has signed counts no more.

        Raises:
            ConflictError: the site does not have it, it is revoked or still signs, or the disk refuses.
        """
        with self._lock:
            try:
                signed = revoke_key(self._trust, key_id, self._private_key())
            except PolicyError as error:
                raise ConflictError("key", f"{error}.") from error
            detail: dict[str, JsonValue] = {"key_id": key_id, "reason": reason}
            self._note_key(REVOKE_KEY, detail, session.actor)
            try:
                _write(self._file, signed)
            except OSError as error:
                raise self._disk_error(REVOKE_KEY, detail, session.actor, error) from error
            self._trust = signed
        return self.keys()

    def _disk_error(
        self, action: str, detail: dict[str, JsonValue], actor: Actor, error: OSError
    ) -> ConflictError:
        self._note_key(f"{action}.failed", detail, actor)
        return ConflictError("disk", f"The site's list or key cannot be written: {error}")

    def _note_key(self, action: str, detail: dict[str, JsonValue], actor: Actor) -> None:
        with self._database.write() as database:
            self._audit.append(database, Entry(actor, action, "fact", detail=detail))

    def _take_next_key(self) -> None:
        """End or undo a change of the key that was cut off."""
        if not self._next_key_file.exists():
            return
        text = self._next_key_file.read_text(encoding="ascii").strip()
        key_id = public_key(base64.b64decode(text, validate=True)).key_id
        if key_id == self._trust.signed_by:
            self._next_key_file.replace(self._folder / KEY_FILE)
        else:
            self._next_key_file.unlink()

    def _require_other_person(self, policy: StoredPolicy, session: Session) -> None:
        if not self._is_four_eyes:
            return
        with self._database.read() as database:
            uploader = uploader_of(database, policy.card.policy_sha256)
        if uploader == session.username:
            raise ConflictError(
                "four_eyes",
                f"{uploader} has uploaded {policy.card.policy_id}; another engineer approves it.",
            )

    def _require_unneeded(self, policy_sha256: str, users: list[str]) -> None:
        if users:
            name = self._policies.name_of(policy_sha256)
            raise ConflictError("policy_needed", f"{name} cannot be retired: {'; '.join(users)}.")

    def _change(self, step: "_Step", actor: Actor, approvals: tuple[Approval, ...]) -> None:
        """Take the next list into use once it is on the disk, and note the step with it."""
        self._note(step.action, step.policy_sha256, actor, step.reason)
        signed = sign_list(
            self._trust.model_copy(update={"approvals": approvals}), self._private_key()
        )
        evidence: dict[str, JsonValue] = {
            "key_id": signed.signed_by,
            "list_count": signed.serial_count,
            **step.evidence,
        }
        try:
            with self._database.write() as database:
                state = state_of(database, step.policy_sha256)
                is_removal = len(approvals) < len(self._trust.approvals)
                # An approval that the list should not hold leaves it in any case.
                is_listed_only = is_removal and (
                    state is PolicyState.RETIRED or (state is None and step.action == WITHDRAW)
                )
                if not is_listed_only:
                    change_state(
                        database,
                        step.policy_sha256,
                        step.to_state,
                        actor=actor.name,
                        reason=step.reason,
                        evidence=evidence,
                    )
                if step.to_state is PolicyState.RETIRED:
                    # Again, with the version locked: a deployment may have come in between.
                    self._require_unneeded(
                        step.policy_sha256, machines_that_need(database, step.policy_sha256)
                    )
                # The last that can fail before the commit; a start mends what lies between the two.
                _write(self._file, signed)
        except OSError as error:
            self._note(f"{step.action}.failed", step.policy_sha256, actor)
            raise ConflictError(
                "disk", f"The list of approvals cannot be written, nothing has changed: {error}"
            ) from error
        except ApiError:
            self._note(f"{step.action}.failed", step.policy_sha256, actor)
            raise
        self._trust = signed

    def _reconcile(self) -> None:
        """Add the steps that the signed list shows and the history lacks: it is what machines go by."""
        approvals = {approval.policy_sha256: approval for approval in self._trust.approvals}
        self._policies.refresh()
        with self._database.write() as database:
            for policy_sha256, state in states(database).items():
                approval = approvals.get(policy_sha256)
                if (approval is not None) == (state is PolicyState.APPROVED):
                    continue
                if approval is None:
                    to_state = state_before_approval(database, policy_sha256)
                    actor, reason = SERVER.name, "the site's list does not hold its approval"
                elif state in (PolicyState.UPLOADED, PolicyState.VALIDATED):
                    to_state, actor = PolicyState.APPROVED, approval.approved_by
                    reason = FIRST_START_REASON if actor == FIRST_START else LISTED_REASON
                else:
                    continue
                change_state(
                    database,
                    policy_sha256,
                    to_state,
                    actor=actor,
                    reason=reason,
                    evidence={
                        "list_count": self._trust.serial_count,
                        **({"is_without_validation": True} if reason == FIRST_START_REASON else {}),
                    },
                )

    @property
    def _file(self) -> Path:
        return self._folder / TRUST_FILE

    @property
    def _next_key_file(self) -> Path:
        return self._folder / f"{KEY_FILE}.next"

    def _private_key(self) -> bytes:
        text = (self._folder / KEY_FILE).read_text(encoding="ascii")
        return base64.b64decode(text.strip(), validate=True)

    def _require_own_key(self) -> None:
        own = public_key(self._private_key())
        if own not in self._trust.keys or own.key_id != self._trust.signed_by:
            raise ValueError(f"it is not signed by {own.key_id}, the key in {KEY_FILE}")

    def _note(self, action: str, policy_sha256: str, actor: Actor, reason: str = "") -> None:
        detail: dict[str, JsonValue] = {
            "policy_sha256": policy_sha256,
            "policy_id": self._policies.name_of(policy_sha256),
            "key_id": self._trust.keys[-1].key_id,
            **({"reason": reason} if reason else {}),
        }
        with self._database.write() as database:
            self._audit.append(database, Entry(actor, action, "fact", detail=detail))


def _signed(files: PolicyFiles, key: bytes, approved_by: str) -> Approval:
    """The approval of a version that was checked."""
    return approve(files, key, approved_by=approved_by, approved_utc=_utc_text())


def _utc_text() -> str:
    return utc_now().isoformat(timespec="milliseconds")


def _write(file: Path, trust: SiteTrust) -> None:
    part = file.with_suffix(".part")
    with part.open("w", encoding="utf-8") as out:
        out.write(trust.model_dump_json(indent=2) + "\n")
        out.flush()
        os.fsync(out.fileno())
    part.replace(file)
    folder = os.open(file.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)
