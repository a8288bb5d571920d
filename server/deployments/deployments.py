"""Which version each machine is to have: who asked for it, when and why, and what became of it.

The server proposes: a machine asks what is wanted, fetches and checks it, and switches with no plan armed.
Rows are only added; how a deployment ended is written beside it, once.
"""

import threading
from collections.abc import Callable, Iterator
from hashlib import sha256
from pathlib import Path
from typing import Any, Final

from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession

from machine.conventions import Mode
from machine.messages import EventKind, MachineEvent
from machine.policy_card import CARD_FILE, GOLDEN_FILE, POLICY_FILE
from machine.spec import MachineSpec
from server.accounts.accounts import Session
from server.accounts.audit_chain import AuditChain, Entry
from server.clock import utc_now
from server.deployments.asker import Asker
from server.deployments.machine_policies import policy_aboard, rollback_of
from server.deployments.site_approvals import SiteApprovals
from server.deployments.site_keys import TrustReport, keep_report
from server.errors import ConflictError, NotFoundError
from server.machines.machine_registry import MachineRegistry
from server.plans.policy_life import state_of
from server.plans.policy_store import PolicyStore, StoredPolicy
from server.schemas.deployments import (
    ChangeCause,
    DeploymentOutcome,
    DeploymentView,
    DeployRequest,
    VersionFileView,
    WantedPoliciesView,
    WantedPolicyView,
)
from server.schemas.policies import PolicyState
from server.store.database import Database
from server.store.models import Deployment, MachinePolicy, Policy

LISTED_COUNT: Final = 100
FILES: Final = (POLICY_FILE, CARD_FILE, GOLDEN_FILE)


class Deployments:
    """Asks for versions, hands them out to machines, and notes what machines did; thread-safe."""

    def __init__(
        self,
        database: Database,
        audit: AuditChain,
        registry: MachineRegistry,
        policies: PolicyStore,
        approvals: SiteApprovals,
        spec: MachineSpec,
    ) -> None:
        self._database = database
        self._audit = audit
        self._registry = registry
        self._policies = policies
        self._approvals = approvals
        self._spec = spec
        self._lock = threading.Lock()
        self._hashes: dict[tuple[Path, int, int], str] = {}
        self.on_change: list[Callable[[DatabaseSession, DeploymentView], None]] = []
        """Called inside the transaction that stores or ends a deployment."""

    # People ---------------------------------------------------------------------------------------

    def deploy(
        self, machine_id: str, mode: Mode, body: DeployRequest, session: Session
    ) -> DeploymentView:
        """Ask a machine to switch to a version.

        Raises:
            NotFoundError: no such machine, or no files of such a version.
            ConflictError: the version is for another mode or machine type, or not approved.
        """
        self._registry.get(machine_id)
        policy = self.require_usable(mode, body.policy_sha256)
        asker = Asker(session.actor, session.username, body.reason)
        return self._add(machine_id, mode, policy, asker, is_rollback=False)

    def roll_back(
        self, machine_id: str, mode: Mode, reason: str, session: Session
    ) -> DeploymentView:
        """Ask a machine to go back to the version that it had before.

        Raises:
            NotFoundError: no such machine, or the version's files are gone.
            ConflictError: it has had no other version, or none that was not rolled back from.
        """
        self._registry.get(machine_id)
        with self._database.read() as database:
            back = rollback_of(database, machine_id, mode)
            aboard = policy_aboard(database, machine_id, mode)
        if back.to_sha256 is None:
            text = f"{machine_id} has had no other version in {mode.value}."
            if aboard is not None and back.from_sha256 is not None:
                now, taken = map(self._policies.name_of, (aboard, back.from_sha256))
                text = (
                    f"{machine_id} has no version before {now} in {mode.value}: {taken} was rolled back. "
                    "Deploy the version that it is to have."
                )
            raise ConflictError("no_version_before", text)
        policy = self.require_usable(mode, back.to_sha256)
        asker = Asker(session.actor, session.username, reason)
        return self._add(machine_id, mode, policy, asker, is_rollback=True)

    def ask(
        self,
        machine_id: str,
        mode: Mode,
        policy_sha256: str,
        asker: Asker,
        *,
        is_rollback: bool,
        on_add: Callable[[DatabaseSession, Deployment], None],
    ) -> DeploymentView:
        """Ask a machine for a part of the server, for example a rollout.

        Args:
            machine_id: machine.
            mode: mode.
            policy_sha256: version.
            asker: for whom, and why.
            is_rollback: it goes back to what it had.
            on_add: called inside the transaction that stores the deployment.

        Raises:
            NotFoundError: no files of such a version.
            ConflictError: the version is for another mode or machine type, or not approved.
        """
        policy = self.require_usable(mode, policy_sha256)
        return self._add(machine_id, mode, policy, asker, is_rollback=is_rollback, on_add=on_add)

    def list(self, machine_id: str) -> list[DeploymentView]:
        """The newest hundred of a machine and its rollbacks without the server, newest first.

        Raises:
            NotFoundError: no such machine.
        """
        self._registry.get(machine_id)
        query = (
            select(Deployment)
            .where(Deployment.machine_id == machine_id)
            .order_by(Deployment.created_utc.desc(), Deployment.deployment_count.desc())
            .limit(LISTED_COUNT)
        )
        local = (
            select(MachinePolicy)
            .where(
                MachinePolicy.machine_id == machine_id,
                MachinePolicy.cause == ChangeCause.AT_MACHINE.value,
            )
            .order_by(MachinePolicy.machine_policy_count.desc())
            .limit(LISTED_COUNT)
        )
        with self._database.read() as database:
            found = [self._view(row) for row in database.scalars(query)]
            found += [self._view_of_local(row) for row in database.scalars(local)]
        return sorted(found, key=lambda one: one.created_utc, reverse=True)[:LISTED_COUNT]

    # Machines -------------------------------------------------------------------------------------

    def wanted(self, machine_id: str, report: TrustReport | None = None) -> WantedPoliciesView:
        """The newest deployment of each mode, with the files to fetch.

        Args:
            machine_id: who asks.
            report: what it says that it trusts; None where it does not say so.
        """
        if report is not None:
            keep_report(self._database, self._audit, machine_id, report)
        found: list[WantedPolicyView] = []
        with self._database.read() as database:
            rows = [row for mode in Mode if (row := _newest(database, machine_id, mode))]
        for row in rows:
            policy = self._policies.find(row.policy_sha256)
            files = () if policy is None else self._files(policy)
            found.append(
                WantedPolicyView(
                    mode=Mode(row.mode),
                    deployment_count=row.deployment_count,
                    policy_sha256=row.policy_sha256,
                    is_rollback=row.is_rollback,
                    age_s=max(0.0, (utc_now() - row.created_utc).total_seconds()),
                    files=files,
                )
            )
        return WantedPoliciesView(policies=tuple(found), trust=self._approvals.trust())

    def file(self, policy_sha256: str, name: str) -> Path:
        """Where a file of a version lies.

        Raises:
            NotFoundError: no files of such a version.
        """
        policy = self._policies.find(policy_sha256)
        if policy is None or name not in FILES or not (policy.folder / name).is_file():
            raise NotFoundError(
                "no_policy", f"There are no files of policy {policy_sha256[:12]} here."
            )
        return policy.folder / name

    def record(self, database: DatabaseSession, event: MachineEvent) -> None:
        """Note how a deployment ended; inside the transaction that stores the machine's event."""
        if event.kind is EventKind.BOOTED:
            for row in _note_aboard(database, event):
                self._tell(database, row)
        if event.kind not in (EventKind.POLICY_SWITCHED, EventKind.POLICY_REFUSED):
            return
        count, mode = event.data.get("deployment_count"), event.data.get("mode")
        if not isinstance(count, int) or not isinstance(mode, str):
            return  # a rollback at the machine itself
        row = database.get(Deployment, (event.machine_id, mode[:2], count))
        if row is None or row.outcome in (DeploymentOutcome.SWITCHED, DeploymentOutcome.REFUSED):
            return
        is_switched = event.kind is EventKind.POLICY_SWITCHED
        row.outcome = (
            DeploymentOutcome.SWITCHED if is_switched else DeploymentOutcome.REFUSED
        ).value
        row.detail = str(event.data.get("detail", ""))[:1000]
        row.ended_utc = utc_now()
        self._tell(database, row)

    # Parts ----------------------------------------------------------------------------------------

    def require_usable(self, mode: Mode, policy_sha256: str) -> StoredPolicy:
        """A version that machines may be asked to switch to.

        Raises:
            NotFoundError: no files of such a version.
            ConflictError: the version is for another mode or machine type, or not approved.
        """
        policy = self._policies.find(policy_sha256)
        if policy is None:
            raise NotFoundError(
                "no_policy", f"There are no files of policy {policy_sha256[:12]} here."
            )
        if policy.card.mode is not mode:
            raise ConflictError(
                "wrong_mode",
                f"{policy.card.policy_id} is for mode {policy.card.mode.value}, not {mode.value}.",
            )
        if policy.card.model_sha256 != self._spec.sha256:
            raise ConflictError(
                "model_mismatch",
                f"{policy.card.policy_id} is for machine model {policy.card.model_sha256[:12]}, "
                f"the machines here are {self._spec.sha256[:12]}.",
            )
        if not self._approvals.is_approved(policy):
            raise ConflictError(
                "not_approved",
                f"{policy.card.policy_id} is not approved, or its card was altered since: no machine "
                "loads it. An engineer approves it.",
            )
        self._approvals.catch_up()
        return policy

    def _add(
        self,
        machine_id: str,
        mode: Mode,
        policy: StoredPolicy,
        asker: Asker,
        *,
        is_rollback: bool,
        on_add: Callable[[DatabaseSession, Deployment], None] = lambda _database, _row: None,
    ) -> DeploymentView:
        with self._lock, self._database.write() as database:
            _require_approved(database, policy)
            newest = _newest(database, machine_id, mode)
            if newest is not None and newest.outcome == DeploymentOutcome.PENDING:
                newest.outcome, newest.ended_utc = DeploymentOutcome.REPLACED.value, utc_now()
                self._tell(database, newest)
            row = Deployment(
                machine_id=machine_id,
                mode=mode.value,
                deployment_count=1 + (0 if newest is None else newest.deployment_count),
                policy_sha256=policy.card.policy_sha256,
                is_rollback=is_rollback,
                reason=asker.reason[:300],
                created_by=asker.name[:64],
                created_utc=utc_now(),
                outcome=DeploymentOutcome.PENDING.value,
                detail="",
                ended_utc=None,
            )
            database.add(row)
            detail: dict[str, Any] = {
                "mode": row.mode,
                "deployment_count": row.deployment_count,
                "policy_sha256": row.policy_sha256,
                "reason": asker.reason,
            }
            action = "policy.roll_back" if is_rollback else "policy.deploy"
            entry = Entry(asker.actor, action, "fact", machine_id=machine_id, detail=detail)
            self._audit.append(database, entry)
            on_add(database, row)
            self._tell(database, row)
        return self._view(row)

    def _tell(self, database: DatabaseSession, row: Deployment) -> None:
        for listener in self.on_change:
            listener(database, self._view(row))

    def _view(self, row: Deployment) -> DeploymentView:
        return DeploymentView(
            machine_id=row.machine_id,
            mode=Mode(row.mode),
            deployment_count=row.deployment_count,
            policy_sha256=row.policy_sha256,
            policy_id=self._policies.name_of(row.policy_sha256),
            is_rollback=row.is_rollback,
            reason=row.reason,
            created_by=row.created_by,
            created_utc=row.created_utc,
            outcome=DeploymentOutcome(row.outcome),
            detail=row.detail,
            ended_utc=row.ended_utc,
        )

    def _view_of_local(self, row: MachinePolicy) -> DeploymentView:
        """A rollback at the machine itself, which no deployment asked for."""
        policy_sha256 = row.policy_sha256 or ""
        return DeploymentView(
            machine_id=row.machine_id,
            mode=Mode(row.mode),
            deployment_count=None,
            policy_sha256=policy_sha256,
            policy_id=self._policies.name_of(policy_sha256),
            is_rollback=True,
            reason="rolled back at the machine",
            created_by=row.machine_id,
            created_utc=row.since_utc,
            outcome=DeploymentOutcome.SWITCHED,
            detail="",
            ended_utc=row.since_utc,
        )

    def _files(self, policy: StoredPolicy) -> tuple[VersionFileView, ...]:
        there = (name for name in FILES if (policy.folder / name).is_file())
        return tuple(self._file(policy, name) for name in there)

    def _file(self, policy: StoredPolicy, name: str) -> VersionFileView:
        path = policy.folder / name
        status = path.stat()
        key = (path, status.st_mtime_ns, status.st_size)
        known = self._hashes.get(key)
        if known is None:
            known = self._hashes[key] = sha256(path.read_bytes()).hexdigest()
        return VersionFileView(name=name, sha256=known, size_bytes=status.st_size)


def _require_approved(database: DatabaseSession, policy: StoredPolicy) -> None:
    """Refuse a version that was retired or whose approval was withdrawn since it was looked up."""
    sha256 = policy.card.policy_sha256
    # Locked on PostgreSQL until the commit, as a change of the state is.
    database.get(Policy, sha256, with_for_update=True)
    state = state_of(database, sha256)
    if state is not PolicyState.APPROVED:
        raise ConflictError(
            "not_approved",
            f"{policy.card.policy_id} is {state.value if state else 'not known'}, only approved versions "
            "are deployed.",
        )


def _note_aboard(database: DatabaseSession, event: MachineEvent) -> Iterator[Deployment]:
    """A machine that was cut off while it switched says at its start what it has: what that ends."""
    aboard = event.data.get("policy_sha256")
    if not isinstance(aboard, dict):
        return
    for mode in Mode:
        row = _newest(database, event.machine_id, mode)
        is_open = row is not None and row.outcome == DeploymentOutcome.PENDING
        if row is not None and is_open and aboard.get(mode.value) == row.policy_sha256:
            row.outcome, row.ended_utc = DeploymentOutcome.SWITCHED.value, utc_now()
            yield row


def _newest(database: DatabaseSession, machine_id: str, mode: Mode) -> Deployment | None:
    return database.scalars(
        select(Deployment)
        .where(Deployment.machine_id == machine_id, Deployment.mode == mode.value)
        .order_by(Deployment.deployment_count.desc())
        .limit(1)
    ).first()
