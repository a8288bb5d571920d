"""STOP: sent at once and repeated ten times a second until the machine confirms that it is latched.

STOP does not wait for the disk: if the audit row is not written within 50 ms, STOP is sent and the row
follows. A stop that is not confirmed survives a restart of the server.
"""

import asyncio
import logging
import threading
import time
from collections.abc import Callable, Generator
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures import TimeoutError as FutureTimeoutError
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TypeVar

from sqlalchemy import select, update

from machine.messages import CommandReply, MachineState, StopRequest
from server.accounts.audit_chain import SERVER, Actor, AuditChain, Entry, intent_of
from server.clock import new_id, utc_now
from server.errors import ConflictError
from server.event_hub import EventHub
from server.machines.machine_link import MachineLink, MachineLostError, NoAnswerError
from server.machines.machine_registry import KnownMachine, MachineRegistry
from server.schemas.console import StopView
from server.store.database import Database
from server.store.models import Machine

logger = logging.getLogger(__name__)

REPEAT_S = 0.1
AUDIT_WAIT_S = 0.05
STATE_DELAY_S = 0.3
_PERSIST_AFTER_S = 0.5
_Answer = TypeVar("_Answer")


@dataclass(slots=True)
class PendingStop:
    """A stop that the machine has not confirmed."""

    request: StopRequest
    actor: Actor
    since_s: float
    earlier_latch_id: str = ""
    """The machine's latch when STOP was pressed: it confirms nothing. Empty: none or unknown."""
    is_persisted: bool = False


class StopService:
    """Sends STOP and repeats it until the machine confirms."""

    def __init__(
        self,
        database: Database,
        audit: AuditChain,
        link: MachineLink,
        registry: MachineRegistry,
        hub: EventHub,
    ) -> None:
        self._database = database
        self._audit = audit
        self._link = link
        self._registry = registry
        self._hub = hub
        self._lock = threading.Lock()
        self._pending: dict[str, PendingStop] = {}
        self._work = threading.Event()
        self._is_closing = threading.Event()
        self._writer = ThreadPoolExecutor(1, "stop-audit")
        self._senders = ThreadPoolExecutor(16, "stop-send")
        self._stop_threads = ThreadPoolExecutor(8, "stop-request")
        self._thread = threading.Thread(target=self._run, name="stop-repeat", daemon=True)
        self.on_stop: list[Callable[[str], None]] = []
        """Called with the machine's id when STOP is pressed, before it is sent."""
        registry.on_state.append(self._take_state)

    def start(self) -> None:
        """Take up stops that were not confirmed before the restart, and begin repeating."""
        with self._database.read() as session:
            open_stops = session.scalars(
                select(Machine.machine_id).where(Machine.stop_requested_utc.is_not(None))
            ).all()
        for machine_id in open_stops:
            pending = self._begin(machine_id, SERVER)
            pending.is_persisted = True
        self._thread.start()

    def close(self) -> None:
        """Stop repeating."""
        self._is_closing.set()
        self._work.set()
        if self._thread.is_alive():
            self._thread.join(timeout=2.0)
        self._stop_threads.shutdown(wait=True, cancel_futures=True)
        self._senders.shutdown(wait=True, cancel_futures=True)
        self._writer.shutdown(wait=True)

    async def in_stop_thread(self, job: Callable[[], _Answer]) -> _Answer:
        """Run a STOP request on threads that nothing else uses."""
        return await asyncio.get_running_loop().run_in_executor(self._stop_threads, job)

    def is_pending(self, machine_id: str) -> bool:
        """Whether a stop is still being repeated."""
        with self._lock:
            return machine_id in self._pending

    def require_confirmed(self, machine_id: str) -> None:
        """Refuse to clear while a stop has not arrived: the clear would name an earlier latch.

        Raises:
            ConflictError: one is still being repeated.
        """
        if self.is_pending(machine_id):
            raise ConflictError(
                "stop_pending",
                f"STOP was pressed and {machine_id} has not confirmed it yet; it is repeated 10 times a "
                "second. Clear it when the machine shows it.",
            )

    @contextmanager
    def suspended(self, machine_id: str) -> Generator[None]:
        """Suspend the repetition while a machine is retired.

        If that fails the repetition goes on; else the stop is withdrawn.
        """
        with self._lock:
            pending = self._pending.pop(machine_id, None)
        try:
            yield
        except BaseException:
            if pending is not None:
                with self._lock:
                    self._pending.setdefault(machine_id, pending)
                self._work.set()
            raise
        if pending is not None:
            self._writer.submit(self._record_end, pending, "withdrawn", "the machine was retired")

    def stop(self, machine_ids: list[str], actor: Actor) -> list[StopView]:
        """Stop machines; answers as soon as each has confirmed or half a second has passed."""
        for machine_id in machine_ids:
            for listener in self.on_stop:
                listener(machine_id)
        intents = [
            self._writer.submit(self._audit.record, intent_of(self._request(m, actor), actor))
            for m in machine_ids
        ]
        self._wait_for_audit(intents)
        begun = [self._begin(machine_id, actor) for machine_id in machine_ids]
        self._work.set()
        return list(self._senders.map(self._ask, begun))

    @staticmethod
    def _request(machine_id: str, actor: Actor) -> StopRequest:
        return StopRequest(command_id=new_id(), machine_id=machine_id, issuer=actor.name)

    @staticmethod
    def _wait_for_audit(intents: "list[Future[int]]") -> None:
        end_s = time.monotonic() + AUDIT_WAIT_S
        for intent in intents:
            try:
                intent.result(timeout=max(end_s - time.monotonic(), 0.0))
            except FutureTimeoutError:
                logger.error("STOP is sent before its audit row is on disk")
            except Exception:
                logger.exception("STOP is sent without an audit row")

    def _begin(self, machine_id: str, actor: Actor) -> PendingStop:
        state = self._registry.get(machine_id).state
        earlier_latch_id = "" if state is None else state.latch_id
        request = self._request(machine_id, actor)
        pending = PendingStop(request, actor, time.monotonic(), earlier_latch_id)
        with self._lock:
            self._pending[machine_id] = pending
        self._link.put_stop(pending.request)
        return pending

    def _ask(self, pending: PendingStop) -> StopView:
        machine_id = pending.request.machine_id
        try:
            reply = self._link.send(pending.request)
        except MachineLostError:
            detail = "not connected; STOP is repeated until it confirms"
        except NoAnswerError as error:
            detail = f"no answer ({error}); STOP is repeated until it confirms"
        else:
            if reply.accepted:
                self._confirm(machine_id, pending, _reply_text(reply))
                return StopView(
                    machine_id=machine_id, is_latched=True, is_pending=False, detail=reply.detail
                )
            detail = f"{reply.detail}; STOP is repeated until it confirms"
        is_pending = self.is_pending(machine_id)
        return StopView(
            machine_id=machine_id, is_latched=not is_pending, is_pending=is_pending, detail=detail
        )

    def _take_state(self, known: KnownMachine, state: MachineState) -> None:
        with self._lock:
            pending = self._pending.get(known.machine_id)
        if pending is None or not state.stop_latched:
            return
        # Every STOP makes a latch of its own. That of an earlier one may be cleared by somebody who has not
        # seen this press.
        is_earlier = bool(state.latch_id) and state.latch_id == pending.earlier_latch_id
        # A state that was on its way when STOP was pressed may tell of an earlier latch as well.
        if not is_earlier and time.monotonic() - pending.since_s > STATE_DELAY_S:
            self._confirm(known.machine_id, pending, "seen in its state")

    def _confirm(self, machine_id: str, pending: PendingStop, text: str) -> None:
        with self._lock:
            if self._pending.get(machine_id) is not pending:
                return
            del self._pending[machine_id]
        self._writer.submit(self._record_end, pending, "latched", text)

    def _record_end(self, pending: PendingStop, result: str, text: str) -> None:
        machine_id = pending.request.machine_id
        seconds = time.monotonic() - pending.since_s
        try:
            with self._database.write() as session:
                self._audit.append(
                    session,
                    Entry(
                        pending.actor,
                        "stop",
                        "outcome",
                        machine_id=machine_id,
                        detail={
                            "command_id": pending.request.command_id,
                            "result": result,
                            "text": text,
                            "seconds": round(seconds, 3),
                        },
                    ),
                )
                session.execute(
                    update(Machine)
                    .where(Machine.machine_id == machine_id)
                    .values(stop_requested_utc=None)
                )
        except Exception:
            logger.exception("the end of the STOP of %s could not be recorded", machine_id)

    def _run(self) -> None:
        while not self._is_closing.is_set():
            with self._lock:
                waiting = list(self._pending.values())
            if not waiting:
                self._work.wait()
                self._work.clear()
                continue
            self._is_closing.wait(REPEAT_S)
            for pending in waiting:
                self._repeat(pending)

    def _repeat(self, pending: PendingStop) -> None:
        machine_id = pending.request.machine_id
        if not self.is_pending(machine_id):
            return
        try:
            self._link.put_stop(pending.request)
        except Exception:
            logger.exception("STOP could not be repeated to %s", machine_id)
        if not pending.is_persisted and time.monotonic() - pending.since_s > _PERSIST_AFTER_S:
            pending.is_persisted = True
            self._writer.submit(self._persist, machine_id)
            self._hub.alert(
                "stop_pending",
                f"{machine_id} has not confirmed STOP yet; it is repeated 10 times a second.",
                severity="error",
                machine_id=machine_id,
            )

    def _persist(self, machine_id: str) -> None:
        if not self.is_pending(machine_id):
            return
        try:
            with self._database.write() as session:
                session.execute(
                    update(Machine)
                    .where(Machine.machine_id == machine_id)
                    .values(stop_requested_utc=utc_now())
                )
        except Exception:
            logger.exception("the open STOP of %s could not be stored", machine_id)


def _reply_text(reply: CommandReply) -> str:
    return reply.detail or "answered"
