"""The life of a policy version: uploaded, validating, validated, approved, retired.

Every step is a row that says who, when, why and on what evidence; `change_state` is the only place that adds
one, and refuses what `NEXT_STATES` does not list.
"""

from collections.abc import Mapping
from typing import Any, Final

from sqlalchemy import func, select
from sqlalchemy.orm import Session as DatabaseSession

from server.clock import utc_now
from server.errors import ConflictError, NotFoundError
from server.schemas.policies import PolicyState, PolicyTransitionView
from server.store.models import Policy, PolicyTransition

NEXT_STATES: Final[Mapping[PolicyState | None, frozenset[PolicyState]]] = {
    None: frozenset({PolicyState.UPLOADED}),
    PolicyState.UPLOADED: frozenset(
        {PolicyState.VALIDATING, PolicyState.APPROVED, PolicyState.RETIRED}
    ),
    # Back to uploaded: the validation was cancelled, or a gate refused.
    PolicyState.VALIDATING: frozenset({PolicyState.VALIDATED, PolicyState.UPLOADED}),
    PolicyState.VALIDATED: frozenset(
        {PolicyState.VALIDATING, PolicyState.APPROVED, PolicyState.RETIRED}
    ),
    # Back: the approval was withdrawn.
    PolicyState.APPROVED: frozenset(
        {PolicyState.UPLOADED, PolicyState.VALIDATED, PolicyState.RETIRED}
    ),
    PolicyState.RETIRED: frozenset(),
}
"""State -> the states that may follow."""


def change_state(
    database: DatabaseSession,
    policy_sha256: str,
    to_state: PolicyState,
    *,
    actor: str,
    reason: str,
    evidence: Mapping[str, Any] | None = None,
) -> PolicyTransition:
    """Move a version on, inside the caller's transaction.

    Args:
        database: a write transaction.
        policy_sha256: the version.
        to_state: where to.
        actor: account name, or who else acts.
        reason: why, for people.
        evidence: facts that the step rests on, as JSON.

    Raises:
        NotFoundError: the server never met such a version.
        ConflictError: the step is not allowed from the state that the version is in.
    """
    # Locked on PostgreSQL until the commit: two steps from one state cannot both happen.
    policy = database.get(Policy, policy_sha256, with_for_update=True)
    if policy is None:
        raise NotFoundError("no_policy", f"No policy has sha256 {policy_sha256[:16]}...")
    from_state = state_of(database, policy_sha256)
    if to_state not in NEXT_STATES[from_state]:
        raise ConflictError("policy_state", _refusal(policy.policy_id, from_state, to_state))
    row = PolicyTransition(
        policy_sha256=policy_sha256,
        from_state=None if from_state is None else from_state.value,
        to_state=to_state.value,
        actor=actor[:64],
        reason=reason[:300],
        evidence=dict(evidence or {}),
        at_utc=utc_now(),
    )
    database.add(row)
    # One insert each: the order in which rows added together are numbered is not defined.
    database.flush()
    return row


def _refusal(policy_id: str, from_state: PolicyState | None, to_state: PolicyState) -> str:
    if from_state is None:
        return f"{policy_id} is not known here yet, so it cannot become {to_state.value}."
    following = sorted(state.value for state in NEXT_STATES[from_state])
    can = f"it can become {' or '.join(following)}" if following else "that is for good"
    return f"{policy_id} is {from_state.value} and cannot become {to_state.value}; {can}."


def state_of(database: DatabaseSession, policy_sha256: str) -> PolicyState | None:
    """The state of a version; None before the server has met it."""
    newest = _newest(database, policy_sha256)
    return None if newest is None else PolicyState(newest.to_state)


def states(database: DatabaseSession) -> dict[str, PolicyState]:
    """sha256 of every version that the server has met -> its state."""
    newest = select(func.max(PolicyTransition.transition_count)).group_by(
        PolicyTransition.policy_sha256
    )
    rows = database.scalars(
        select(PolicyTransition).where(PolicyTransition.transition_count.in_(newest))
    )
    return {row.policy_sha256: PolicyState(row.to_state) for row in rows}


def state_before_approval(database: DatabaseSession, policy_sha256: str) -> PolicyState:
    """The state that a version goes back to when its approval is withdrawn."""
    row = database.scalars(
        select(PolicyTransition)
        .where(
            PolicyTransition.policy_sha256 == policy_sha256,
            PolicyTransition.to_state == PolicyState.APPROVED.value,
        )
        .order_by(PolicyTransition.transition_count.desc())
        .limit(1)
    ).first()
    is_validated = row is not None and row.from_state == PolicyState.VALIDATED
    return PolicyState.VALIDATED if is_validated else PolicyState.UPLOADED


def history(database: DatabaseSession, policy_sha256: str) -> list[PolicyTransitionView]:
    """The steps of a version, oldest first.

    Raises:
        NotFoundError: the server never met it.
    """
    if database.get(Policy, policy_sha256) is None:
        raise NotFoundError("no_policy", f"No policy has sha256 {policy_sha256[:16]}...")
    rows = database.scalars(
        select(PolicyTransition)
        .where(PolicyTransition.policy_sha256 == policy_sha256)
        .order_by(PolicyTransition.transition_count)
    )
    return [
        PolicyTransitionView(
            from_state=None if row.from_state is None else PolicyState(row.from_state),
            to_state=PolicyState(row.to_state),
            actor=row.actor,
            at_utc=row.at_utc,
            reason=row.reason,
            evidence=row.evidence,
        )
        for row in rows
    ]


def uploader_of(database: DatabaseSession, policy_sha256: str) -> str | None:
    """Who brought a version; None before the server has met it."""
    return database.scalars(
        select(PolicyTransition.actor)
        .where(
            PolicyTransition.policy_sha256 == policy_sha256,
            PolicyTransition.from_state.is_(None),
        )
        .order_by(PolicyTransition.transition_count)
        .limit(1)
    ).first()


def was_withdrawn(database: DatabaseSession, policy_sha256: str, except_by: str) -> bool:
    """Whether anyone but one actor ever took a version's approval back."""
    query = select(PolicyTransition.transition_count).where(
        PolicyTransition.policy_sha256 == policy_sha256,
        PolicyTransition.from_state == PolicyState.APPROVED.value,
        PolicyTransition.actor != except_by,
    )
    return database.scalars(query.limit(1)).first() is not None


def _newest(database: DatabaseSession, policy_sha256: str) -> PolicyTransition | None:
    return database.scalars(
        select(PolicyTransition)
        .where(PolicyTransition.policy_sha256 == policy_sha256)
        .order_by(PolicyTransition.transition_count.desc())
        .limit(1)
    ).first()
