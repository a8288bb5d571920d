"""Which policy each machine had on board, and since when, by the machine's own durable events.

An event arrives when the machine has a connection again, with the time at which it happened: the answer for
any moment is right also for times without a connection.
"""

from datetime import UTC, datetime
from typing import NamedTuple

from sqlalchemy import func, select
from sqlalchemy.orm import Session as DatabaseSession

from machine.conventions import Mode
from machine.messages import EventKind, MachineEvent
from server.clock import utc_now
from server.machines.machine_registry import MachineRegistry
from server.plans.policy_store import PolicyStore
from server.schemas.deployments import (
    ChangeCause,
    DeploymentOutcome,
    MachinePoliciesView,
    MachinePolicyView,
)
from server.store.database import Database
from server.store.models import Deployment, MachinePolicy


class MachinePolicies:
    """Writes and reads the history of policies on machines; thread-safe."""

    def __init__(
        self, database: Database, registry: MachineRegistry, policies: PolicyStore
    ) -> None:
        self._database = database
        self._registry = registry
        self._policies = policies

    def record(self, database: DatabaseSession, event: MachineEvent) -> None:
        """Add what a new event says about policies; inside the transaction that stores the event."""
        if event.kind is EventKind.POLICY_SWITCHED:
            mode, policy_sha256 = event.data.get("mode"), event.data.get("policy_sha256")
            if mode in list(Mode) and isinstance(policy_sha256, str):
                cause = _cause_of_switch(database, event, Mode(mode))
                _add_change(database, event, Mode(mode), policy_sha256[:64], cause)
            return
        if event.kind is EventKind.POLICY_REFUSED and event.data.get("is_removed") is True:
            if (mode := event.data.get("mode")) in list(Mode):
                _add_change(database, event, Mode(mode), None, None)
            return
        if event.kind is not EventKind.BOOTED:
            return
        aboard = event.data.get("policy_sha256")
        if not isinstance(aboard, dict):
            return  # an older machine, which does not say
        for mode in Mode:
            policy_sha256 = aboard.get(mode.value)
            known = policy_sha256[:64] if isinstance(policy_sha256, str) else None
            _add_change(database, event, mode, known, _cause_of_start(database, event, mode, known))

    def view(self, machine_id: str, at_utc: datetime | None) -> MachinePoliciesView:
        """What a machine had on board at a time; now without one.

        Raises:
            NotFoundError: there is no such machine.
        """
        self._registry.get(machine_id)
        at_utc = at_utc or utc_now()
        if at_utc.tzinfo is None:
            at_utc = at_utc.replace(tzinfo=UTC)
        ranked = (
            select(
                MachinePolicy,
                func.row_number()
                .over(
                    partition_by=MachinePolicy.mode,
                    order_by=(
                        MachinePolicy.since_utc.desc(),
                        MachinePolicy.machine_policy_count.desc(),
                    ),
                )
                .label("rank"),
            )
            .where(MachinePolicy.machine_id == machine_id, MachinePolicy.since_utc <= at_utc)
            .subquery()
        )
        newest = select(ranked).where(ranked.c.rank == 1).order_by(ranked.c.mode)
        with self._database.read() as session:
            rows = session.execute(newest).all()
            back = {row.mode: rollback_of(session, machine_id, Mode(row.mode)) for row in rows}
        return MachinePoliciesView(
            machine_id=machine_id,
            at_utc=at_utc,
            policies=tuple(
                MachinePolicyView(
                    mode=Mode(row.mode),
                    policy_sha256=row.policy_sha256,
                    policy_id=self._name_of(row.policy_sha256),
                    since_utc=row.since_utc,
                    version_before=self._name_of(back[row.mode].to_sha256),
                    rolled_back_from=self._name_of(back[row.mode].from_sha256),
                )
                for row in rows
            ),
        )

    def _name_of(self, policy_sha256: str | None) -> str | None:
        return None if policy_sha256 is None else self._policies.name_of(policy_sha256)


def policy_aboard(database: DatabaseSession, machine_id: str, mode: Mode) -> str | None:
    """sha256 of the version that a machine has in a mode, by its own events; None where it has none."""
    newest = _newest(database, machine_id, mode)
    return None if newest is None else newest.policy_sha256


class RollbackOption(NamedTuple):
    """Where a rollback asked for now leads, and whether the last change was one."""

    to_sha256: str | None
    """None: there is no version before the one on board that was not rolled back from."""
    from_sha256: str | None
    """The version that the last change took away, where that was a rollback; else None."""


def rollback_of(database: DatabaseSession, machine_id: str, mode: Mode) -> RollbackOption:
    """Which version a machine goes back to in a mode.

    A version that was rolled back from comes into question again once it is deployed anew. A change without
    a known cause, to a version that the machine has had, is one back to it.
    """
    versions, taken = list[str](), None
    for sha256, cause in _changes(database, machine_id, mode):
        before = versions[-1] if versions else None
        if sha256 is None or sha256 == before:
            continue
        is_rollback = cause in (ChangeCause.ROLLED_BACK, ChangeCause.AT_MACHINE)
        taken = before if is_rollback else None
        if sha256 in versions and cause != ChangeCause.DEPLOYED:
            del versions[versions.index(sha256) + 1 :]
        elif is_rollback:
            versions[-1:] = [sha256]
        else:
            versions = [*(one for one in versions if one != sha256), sha256]
    return RollbackOption(versions[-2] if len(versions) > 1 else None, taken)


def version_before(database: DatabaseSession, machine_id: str, mode: Mode) -> str | None:
    """sha256 of the version that a machine goes back to in a mode; None where there is none."""
    return rollback_of(database, machine_id, mode).to_sha256


def machines_that_need(database: DatabaseSession, policy_sha256: str) -> list[str]:
    """What machines have to do with a version, a phrase each; empty where none has."""
    found: list[str] = []
    known = select(MachinePolicy.machine_id, MachinePolicy.mode).distinct()
    for machine_id, mode in database.execute(known.order_by("machine_id", "mode")):
        newest = _newest(database, machine_id, Mode(mode))
        if newest is not None and newest.policy_sha256 == policy_sha256:
            found.append(f"{machine_id} runs it")
        elif policy_sha256 in (
            version_before(database, machine_id, Mode(mode)),
            # In the machine's other slot: it is used where the one in use cannot be loaded.
            _other_version(database, machine_id, Mode(mode)),
        ):
            found.append(f"{machine_id} may go back to it")
    waiting = select(Deployment.machine_id).where(
        Deployment.policy_sha256 == policy_sha256,
        Deployment.outcome == DeploymentOutcome.PENDING.value,
    )
    found += [f"{name} is to switch to it" for name in database.scalars(waiting)]
    return found


def _other_version(database: DatabaseSession, machine_id: str, mode: Mode) -> str | None:
    """sha256 of the newest version that a machine has had beside the one it has; None if there was none."""
    known = [sha256 for sha256, _ in _changes(database, machine_id, mode) if sha256]
    return next((one for one in reversed(known) if one != known[-1]), None)


def _changes(
    database: DatabaseSession, machine_id: str, mode: Mode
) -> list[tuple[str | None, str | None]]:
    """(policy_sha256, cause) of each change of a machine in a mode, oldest first."""
    query = (
        select(MachinePolicy.policy_sha256, MachinePolicy.cause)
        .where(MachinePolicy.machine_id == machine_id, MachinePolicy.mode == mode.value)
        .order_by(MachinePolicy.machine_policy_count)
    )
    return [(sha256, cause) for sha256, cause in database.execute(query)]


def _cause_of_switch(
    database: DatabaseSession, event: MachineEvent, mode: Mode
) -> ChangeCause | None:
    """Why a machine switched, by its event."""
    count = event.data.get("deployment_count")
    if isinstance(count, int):
        return _cause_of(database.get(Deployment, (event.machine_id, mode.value, count)))
    # With neither a count nor a slot the machine took another version because approvals changed.
    return ChangeCause.AT_MACHINE if event.data.get("slot") is not None else None


def _cause_of_start(
    database: DatabaseSession, event: MachineEvent, mode: Mode, policy_sha256: str | None
) -> ChangeCause | None:
    """Why a machine started with a version: what it could not report before, or unknown."""
    pending = database.scalars(
        select(Deployment).where(
            Deployment.machine_id == event.machine_id,
            Deployment.mode == mode.value,
            Deployment.policy_sha256 == policy_sha256,
            Deployment.outcome == DeploymentOutcome.PENDING.value,
        )
    ).first()
    taken, last = event.data.get("rolled_back_from"), _newest(database, event.machine_id, mode)
    if pending is None and isinstance(taken, dict) and last is not None:
        is_taken = last.policy_sha256 is not None and taken.get(mode.value) == last.policy_sha256
        return ChangeCause.AT_MACHINE if is_taken else None
    return _cause_of(pending)


def _cause_of(deployment: Deployment | None) -> ChangeCause | None:
    if deployment is None:
        return None
    return ChangeCause.ROLLED_BACK if deployment.is_rollback else ChangeCause.DEPLOYED


def _newest(database: DatabaseSession, machine_id: str, mode: Mode) -> MachinePolicy | None:
    return database.scalars(
        select(MachinePolicy)
        .where(MachinePolicy.machine_id == machine_id, MachinePolicy.mode == mode.value)
        .order_by(MachinePolicy.machine_policy_count.desc())
        .limit(1)
    ).first()


def _add_change(
    database: DatabaseSession,
    event: MachineEvent,
    mode: Mode,
    policy_sha256: str | None,
    cause: ChangeCause | None,
) -> None:
    last = _newest(database, event.machine_id, mode)
    if last is not None and last.policy_sha256 == policy_sha256:
        return
    since_utc = _time(event)
    if last is not None:
        # Events come in their order; a clock that was set back must not hide the newer one.
        since_utc = max(since_utc, last.since_utc)
    row = MachinePolicy(
        machine_id=event.machine_id,
        mode=mode.value,
        policy_sha256=policy_sha256,
        since_utc=min(since_utc, utc_now()),
        cause=None if cause is None else cause.value,
    )
    database.add(row)
    # One insert each: the order in which rows added together are numbered is not defined.
    database.flush()


def _time(event: MachineEvent) -> datetime:
    """When an event happened, by the machine's clock; now where that cannot be read."""
    try:
        time = datetime.fromisoformat(event.t_utc)
    except ValueError:
        return utc_now()
    return time if time.tzinfo is not None else time.replace(tzinfo=UTC)
