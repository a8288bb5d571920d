"""Sends commands to machines. The audit's intent row is on disk before a command is sent, the outcome after.

A command whose answer was lost is reported as unknown; it is not sent again.
"""

import logging
from collections.abc import Callable

from pydantic import JsonValue
from sqlalchemy.orm import Session as DatabaseSession

from machine.messages import Command, CommandReply, RejectReason, StopRequest
from server.accounts.audit_chain import Actor, AuditChain, Entry, intent_of
from server.clock import utc_now
from server.errors import UnavailableError, UnknownOutcomeError, from_reason
from server.machines.machine_link import MachineLink, MachineLostError, NoAnswerError
from server.machines.machine_registry import MachineRegistry
from server.metrics import ServiceMetrics
from server.store.database import Database

logger = logging.getLogger(__name__)

Change = Callable[[DatabaseSession], None]


class MachineCommands:
    """The only way a command reaches a machine (STOP has its own, which may never wait)."""

    def __init__(
        self,
        database: Database,
        audit: AuditChain,
        link: MachineLink,
        registry: MachineRegistry,
        metrics: ServiceMetrics,
    ) -> None:
        self._database = database
        self._audit = audit
        self._link = link
        self._registry = registry
        self._metrics = metrics

    def send(
        self,
        command: Command,
        actor: Actor,
        *,
        throw_id: str | None = None,
        with_intent: Change | None = None,
        with_acceptance: Change | None = None,
    ) -> CommandReply:
        """Send a command that the machine must accept.

        Args:
            command: what to send.
            actor: who wants it.
            throw_id: for the audit.
            with_intent: what else is written in the transaction of the intent, or nothing is sent.
            with_acceptance: what else is written in the transaction of the outcome when it is accepted.

        Raises:
            UnavailableError: the audit could not be written, or the machine is lost; nothing was sent.
            UnknownOutcomeError: sent, but no answer.
            ApiError: the machine refused.
        """
        command = self._with_age(command)
        self._record_intent(command, actor, throw_id, with_intent)
        try:
            reply = self._link.send(command)
        except MachineLostError as error:
            self._note(command, actor, throw_id, "lost", {})
            raise from_reason(
                RejectReason.MACHINE_LOST, self.lost_text(command.machine_id)
            ) from error
        except NoAnswerError as error:
            self._note(command, actor, throw_id, "unknown", {"cause": str(error)})
            raise UnknownOutcomeError(
                RejectReason.UNKNOWN_OUTCOME.value,
                f"{command.machine_id} did not confirm '{command.kind}': {error}. "
                "It is not known whether it acted; look at the machine.",
            ) from error
        result = "accepted" if reply.accepted else "refused"
        self._note(
            command,
            actor,
            throw_id,
            result,
            {
                "reason": reply.reason,
                "text": reply.detail,
                "state": reply.state,
                "is_repeat": reply.is_repeat,
            },
            with_acceptance if reply.accepted else None,
        )
        if not reply.accepted:
            reason = reply.reason or RejectReason.MALFORMED
            raise from_reason(
                reason,
                reply.detail or f"{command.machine_id} refused '{command.kind}': {reason}.",
                {"machine_state": reply.state, "epoch_count": reply.epoch_count},
            )
        return reply

    def _with_age(self, command: Command) -> Command:
        """The command with the machine's time that was last seen: the machine refuses one that got old."""
        if isinstance(command, StopRequest) or command.seen_t_mono_ns is not None:
            return command
        seen_ns = self._registry.seen_t_mono_ns(command.machine_id)
        return command.model_copy(update={"seen_t_mono_ns": seen_ns})

    def lost_text(self, machine_id: str) -> str:
        """Since when a machine is lost, and what to do."""
        seen = self._registry.get(machine_id).last_seen_utc
        since = (
            "was never seen"
            if seen is None
            else (f"is lost since {(utc_now() - seen).total_seconds():.0f} s")
        )
        return f"{machine_id} {since}; nothing was sent. Check its computer and its network."

    def _record_intent(
        self, command: Command, actor: Actor, throw_id: str | None, change: Change | None
    ) -> None:
        try:
            with self._database.write() as session:
                if change is not None:
                    change(session)
                self._audit.append(session, intent_of(command, actor, throw_id))
        except Exception as error:
            logger.exception("audit cannot be written; '%s' is not sent", command.kind)
            raise UnavailableError(
                "audit_failed",
                f"The record could not be written, so '{command.kind}' was not sent. "
                "Check disk space and database.",
            ) from error

    def _note(
        self,
        command: Command,
        actor: Actor,
        throw_id: str | None,
        result: str,
        detail: dict[str, JsonValue],
        change: Change | None = None,
    ) -> None:
        self._metrics.commands_count.labels(kind=command.kind, result=result).inc()
        outcome = Entry(
            actor,
            command.kind,
            "outcome",
            machine_id=command.machine_id,
            throw_id=throw_id,
            detail={"command_id": command.command_id, "result": result, **detail},
        )
        try:
            with self._database.write() as session:
                if change is not None:
                    change(session)
                self._audit.append(session, outcome)
        except Exception:
            # The machine has acted: the caller must learn of it even if the disk is full now.
            logger.exception("outcome of '%s' could not be written to the audit", command.kind)
