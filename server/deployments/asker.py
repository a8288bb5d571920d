"""Who asks for a deployment, and how a part of the server asks."""

from collections.abc import Callable
from typing import NamedTuple, Protocol

from sqlalchemy.orm import Session as DatabaseSession

from machine.conventions import Mode
from server.accounts.audit_chain import Actor
from server.store.models import Deployment


class Asker(NamedTuple):
    """Who asks for a deployment, and why."""

    actor: Actor
    """For the audit."""
    name: str
    reason: str


class DeploymentAsking(Protocol):
    """What asks machines to switch (server/deployments/deployments.py)."""

    def require_usable(self, mode: Mode, policy_sha256: str, /) -> object:
        """Raise where machines may not be asked to switch to a version."""
        ...

    def ask(
        self,
        machine_id: str,
        mode: Mode,
        policy_sha256: str,
        asker: Asker,
        *,
        is_rollback: bool,
        on_add: Callable[[DatabaseSession, Deployment], None],
    ) -> object:
        """Ask a machine to switch; `on_add` is called inside the transaction that stores it."""
        ...
