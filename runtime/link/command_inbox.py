"""Takes commands from the link to the control process and brings the answers back.

A fire is written down before it is passed on, and nothing is passed on twice. It judges no command: what can
be read goes to the control process. A command without an answer stays unanswered, and the asker sees an
unknown outcome; only what was certainly not passed on is refused here.
"""

import json
import logging
import queue
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Final

from pydantic import TypeAdapter, ValidationError

from machine.messages import (
    Command,
    CommandReply,
    FireRequest,
    RejectReason,
    StopRequest,
    ThrowState,
    ZonesRequest,
)
from runtime.link.ipc import Kind
from runtime.link.server_link import ReplySlot
from runtime.records.journal import Journal
from runtime.records.outbox import OutboxError

logger = logging.getLogger(__name__)

WAITING_LIMIT_COUNT: Final = 64
COMMANDS: Final[TypeAdapter[Command]] = TypeAdapter(Command)

StopAlone = Callable[[StopRequest], CommandReply | None]
"""Latches a STOP by the link process and answers it; None where the control process is alive and will."""
Send = Callable[[Kind, dict[str, Any]], bool]
"""Sends a packet to the control process; whether it went."""


@dataclass(frozen=True, slots=True)
class _Pending:
    command: Command
    slot: ReplySlot
    since_s: float
    owns_intent: bool
    """This fire wrote its throw down; a repeat of it did not, and may not take it back."""


class CommandInbox:
    """One thread for the disk; STOP passes it by."""

    def __init__(
        self, machine_id: str, journal: Journal, send: Send, stop_alone: StopAlone
    ) -> None:
        """Begin.

        Args:
            machine_id: of this machine.
            journal: where fires are written down.
            send: to the control process.
            stop_alone: latches a STOP without the control process, where that does not answer.
        """
        self._machine_id = machine_id
        self._journal = journal
        self._send = send
        self._stop_alone = stop_alone
        self._stops = ThreadPoolExecutor(1, "stop")
        self._lock = threading.Lock()
        self._request = 0
        self._pending: dict[int, _Pending] = {}
        self._jobs: queue.Queue[Callable[[], None] | None] = queue.Queue(WAITING_LIMIT_COUNT)
        self._thread = threading.Thread(target=self._run, name="commands", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop; what waits stays unanswered."""
        self._stops.shutdown(wait=False, cancel_futures=True)
        self._jobs.put(None)
        self._thread.join(2.0)

    def take(self, payload: bytes, slot: ReplySlot) -> None:
        """A command from the link; returns at once, from any thread."""
        try:
            command = COMMANDS.validate_json(payload)
        except ValidationError as error:
            first = error.errors(include_url=False, include_input=False)[0]["msg"]
            detail = f"The command cannot be read: {error.error_count()} faults, first: {first}"
            refusal = self._refusal(_command_id(payload), RejectReason.MALFORMED, detail)
            self._later(lambda: slot.answer(refusal), slot)
            return
        if isinstance(command, StopRequest):
            self._pass_on(command, slot)
            self._stops.submit(self._answer_stop, command, slot)
        else:
            self._later(lambda: self._work(command, slot), slot)

    def _answer_stop(self, command: StopRequest, slot: ReplySlot) -> None:
        """The disk may be slow: not on the link's thread, and not behind other commands."""
        reply = self._stop_alone(command)
        if reply is not None:
            slot.answer(reply.model_dump_json().encode())

    def take_repeated_stop(self, command: StopRequest) -> None:
        """A STOP whose sender waits for no answer; returns at once, from any thread."""
        self._send(Kind.COMMAND, {"request": 0, "command": command.model_dump(mode="json")})
        self._stops.submit(self._stop_alone, command)

    def take_reply(self, request: int, reply: CommandReply) -> None:
        """The control process has answered; what it says is made durable before it is sent on."""
        with self._lock:
            pending = self._pending.pop(request, None)
        self._journal.raise_epoch(reply.epoch_count)
        if pending is None:
            return
        if isinstance(pending.command, FireRequest) and pending.owns_intent and not reply.accepted:
            self._journal.forget_intent(pending.command.throw_id)
        if isinstance(pending.command, ZonesRequest) and reply.accepted:
            self._journal.keep_zones(pending.command.zone_set)
        pending.slot.answer(reply.model_dump_json().encode())

    def give_up(self, age_s: float = 0.0) -> None:
        """Leave commands unanswered that have waited for this long: the control process will not answer.

        A STOP is answered without it.
        """
        now_s = time.monotonic()
        with self._lock:
            old = {n: p for n, p in self._pending.items() if now_s - p.since_s >= age_s}
            for request in old:
                del self._pending[request]
        for pending in old.values():
            if isinstance(pending.command, StopRequest):
                self._stops.submit(self._answer_stop, pending.command, pending.slot)
            else:
                pending.slot.give_up()

    def _run(self) -> None:
        while (job := self._jobs.get()) is not None:
            try:
                job()
            except OutboxError as error:
                logger.error("%s", error)

    def _later(self, job: Callable[[], None], slot: ReplySlot) -> None:
        try:
            self._jobs.put_nowait(job)
        except queue.Full:
            slot.give_up()

    def _work(self, command: Command, slot: ReplySlot) -> None:
        owns_intent = False
        try:
            if isinstance(command, FireRequest):
                owns_intent = self._journal.intend_throw(command.throw_id)
        except OutboxError as error:
            # A throw that cannot be written down must not happen.
            slot.answer(self._refusal(command.command_id, RejectReason.FAULT, str(error)))
            raise
        self._pass_on(command, slot, owns_intent)

    def _pass_on(self, command: Command, slot: ReplySlot, owns_intent: bool = False) -> None:
        pending = _Pending(command, slot, time.monotonic(), owns_intent)
        with self._lock:
            self._request += 1
            request = self._request
            self._pending[request] = pending
        body = {"request": request, "command": command.model_dump(mode="json")}
        if self._send(Kind.COMMAND, body):
            return
        with self._lock:
            self._pending.pop(request, None)
        if not isinstance(command, StopRequest):
            self._later(lambda: self._refuse_unsent(pending), slot)

    def _refuse_unsent(self, pending: _Pending) -> None:
        command = pending.command
        if isinstance(command, FireRequest) and pending.owns_intent:
            self._journal.forget_intent(command.throw_id)
        detail = "The control process does not run. It is restarted by itself; look at the state."
        pending.slot.answer(self._refusal(command.command_id, RejectReason.FAULT, detail))

    def _refusal(self, command_id: str, reason: RejectReason, detail: str) -> bytes:
        reply = CommandReply(
            command_id=command_id,
            machine_id=self._machine_id,
            accepted=False,
            state=ThrowState.FAULT,
            epoch_count=self._journal.epoch_count(),
            reason=reason,
            detail=detail,
        )
        return reply.model_dump_json().encode()


def _command_id(payload: bytes) -> str:
    try:
        body = json.loads(payload)
    except ValueError:
        return ""
    found = body.get("command_id", "") if isinstance(body, dict) else ""
    return found if isinstance(found, str) else ""
