"""The site's key, and the versions that it has approved; machines load nothing else.

Both lie in `DATA/policy-approvals`: the private key readable by its owner alone, and what machines are given.
"""

import base64
import logging
import os
import shutil
import threading
from pathlib import Path
from typing import Final

from pydantic import JsonValue

from machine.errors import DownrangeError, PolicyError
from machine.policy_approval import (
    Approval,
    SiteTrust,
    approve,
    new_private_key,
    public_key,
    sign_list,
)
from machine.policy_card import POLICY_FILE
from machine.spec import load_spec
from runtime.control.policy_file import check_policy_file
from server.accounts.accounts import Session
from server.accounts.audit_chain import SERVER, Actor, AuditChain, Entry
from server.clock import utc_now
from server.errors import ConflictError, NotFoundError
from server.plans.policy_store import PolicyStore, StoredPolicy
from server.secret_files import write_secret
from server.store.database import Database

logger = logging.getLogger(__name__)

KEY_FILE: Final = "site.key"
TRUST_FILE: Final = "site.json"
FIRST_START: Final = "the site's key at first start"


class ApprovalError(DownrangeError):
    """The site's key or its approvals cannot be used."""

    code = "approvals"


class SiteApprovals:
    """Approves and withdraws; thread-safe."""

    def __init__(
        self,
        database: Database,
        audit: AuditChain,
        policies: PolicyStore,
        site: str,
        data_dir: Path,
    ) -> None:
        self._database = database
        self._audit = audit
        self._policies = policies
        self._site = site
        self._folder = data_dir / "policy-approvals"
        self._lock = threading.Lock()
        self._trust = SiteTrust(site=site, keys=())

    def start(self) -> None:
        """Read key and approvals; at the first start make the key and approve every version that is there.

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
                self._require_own_key()
            except (OSError, ValueError) as error:
                raise ApprovalError(f"{self._file} cannot be used: {error}") from error
            return
        self._begin()

    def _begin(self) -> None:
        """Make the key and the first list; both come into being at once."""
        part = self._folder.with_name(f"{self._folder.name}.part")
        shutil.rmtree(part, ignore_errors=True)
        key = new_private_key()
        write_secret(part / KEY_FILE, base64.b64encode(key).decode() + "\n")
        self._trust = SiteTrust(site=self._site, keys=(public_key(key),))
        approvals: list[Approval] = []
        for policy in self._policies.present():
            try:
                approvals.append(_signed(policy, key, FIRST_START))
            except PolicyError as error:
                logger.warning("%s is not approved: %s", policy.card.policy_id, error)
            else:
                self._note("policy.approve", policy.card.policy_sha256, SERVER)
        self._trust = sign_list(self._trust.model_copy(update={"approvals": tuple(approvals)}), key)
        _write(part / TRUST_FILE, self._trust)
        part.rename(self._folder)
        logger.info("made the site's key and approved %d policy versions by it", len(approvals))

    def trust(self) -> SiteTrust:
        """What machines are given."""
        return self._trust

    def is_approved(self, policy: StoredPolicy) -> bool:
        """Whether the version, as it lies there, is approved."""
        try:
            self._trust.check(policy.folder, policy.card.mode)
        except PolicyError:
            return False
        return True

    def approve(self, policy_sha256: str, session: Session) -> Approval:
        """Approve a version.

        Raises:
            NotFoundError: no files of such a version.
            ConflictError: it is approved already, cannot be used, or the disk refuses.
        """
        policy = self._policies.find(policy_sha256)
        if policy is None:
            raise NotFoundError(
                "no_policy", f"There are no files of policy {policy_sha256[:12]} here."
            )
        with self._lock:
            if self.is_approved(policy):
                raise ConflictError("approved", f"{policy.card.policy_id} is approved already.")
            try:
                approval = _signed(policy, self._private_key(), session.username)
            except PolicyError as error:
                raise ConflictError(
                    "policy_unusable", f"It cannot be approved: {error}."
                ) from error
            others = tuple(a for a in self._trust.approvals if a.policy_sha256 != policy_sha256)
            self._change("policy.approve", policy_sha256, session, (*others, approval))
        return approval

    def withdraw(self, policy_sha256: str, session: Session) -> None:
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
            self._change("policy.withdraw", policy_sha256, session, kept)

    def _change(
        self, action: str, policy_sha256: str, session: Session, approvals: tuple[Approval, ...]
    ) -> None:
        """Take the next list into use once it is on the disk."""
        self._note(action, policy_sha256, session.actor)
        changed = self._trust.model_copy(update={"approvals": approvals})
        try:
            signed = sign_list(changed, self._private_key())
            _write(self._file, signed)
        except OSError as error:
            self._note(f"{action}.failed", policy_sha256, session.actor)
            raise ConflictError(
                "disk", f"The list of approvals cannot be written, nothing has changed: {error}"
            ) from error
        self._trust = signed

    @property
    def _file(self) -> Path:
        return self._folder / TRUST_FILE

    def _private_key(self) -> bytes:
        text = (self._folder / KEY_FILE).read_text(encoding="ascii")
        return base64.b64decode(text.strip(), validate=True)

    def _require_own_key(self) -> None:
        own = public_key(self._private_key())
        if own not in self._trust.keys:
            raise ValueError(f"its keys do not include {own.key_id}, the one in {KEY_FILE}")

    def _note(self, action: str, policy_sha256: str, actor: Actor) -> None:
        detail: dict[str, JsonValue] = {
            "policy_sha256": policy_sha256,
            "policy_id": self._policies.name_of(policy_sha256),
            "key_id": self._trust.keys[-1].key_id,
        }
        with self._database.write() as database:
            self._audit.append(database, Entry(actor, action, "fact", detail=detail))


def _signed(policy: StoredPolicy, key: bytes, approved_by: str) -> Approval:
    """The approval of a version that a machine can load.

    Raises:
        PolicyError: its network or machine model is not one that machines take.
    """
    card, spec = policy.card, load_spec()
    check_policy_file((policy.folder / POLICY_FILE).read_bytes(), card.policy_id)
    if card.model_sha256 != spec.sha256:
        raise PolicyError(
            f"{card.policy_id} is for machine model {card.model_sha256[:12]}, this server's is "
            f"{spec.sha256[:12]}"
        )
    return approve(
        policy.folder,
        key,
        approved_by=approved_by,
        approved_utc=utc_now().isoformat(timespec="milliseconds"),
    )


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
