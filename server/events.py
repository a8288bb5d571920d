"""Hands events to browsers: a bounded queue for each, so that a slow one costs nobody else anything.

States of machines replace each other in the queue and are limited in rate; everything else is kept in
order. A queue that overflows is closed: the browser reconnects and reads the present state anew.
"""

import asyncio
import threading
import time
from collections import deque
from typing import NamedTuple

from server.schemas_history import (
    AlertEvent,
    LeaseChangedEvent,
    MachineLostEvent,
    MachineStateEvent,
    PlanUpdatedEvent,
    TargetProposedEvent,
    ThrowUpdatedEvent,
)

AnyEvent = (
    MachineStateEvent
    | MachineLostEvent
    | LeaseChangedEvent
    | TargetProposedEvent
    | PlanUpdatedEvent
    | ThrowUpdatedEvent
    | AlertEvent
)

QUEUE_LENGTH = 512
WATCHED_PERIOD_S = 0.095
"""State of the machine that the browser watches: all of the 10 Hz, with room for jitter."""
OTHER_PERIOD_S = 0.95


class Frame(NamedTuple):
    """An event ready to be sent."""

    name: str
    data: str


class HubClient:
    """One browser's queue; filled from any thread, emptied in the event loop."""

    def __init__(self, session_id: str, machine_id: str | None) -> None:
        self.session_id = session_id
        self.machine_id = machine_id
        self.is_closed = False
        self._loop = asyncio.get_running_loop()
        self._ready = asyncio.Event()
        self._lock = threading.Lock()
        self._frames: deque[Frame] = deque()
        self._states: dict[str, Frame] = {}
        self._sent_s: dict[str, float] = {}

    def push(self, frame: Frame, state_of: str | None) -> None:
        """Queue an event; `state_of` names the machine whose older state it replaces."""
        with self._lock:
            if self.is_closed:
                return
            if state_of is not None:
                now_s = time.monotonic()
                period = WATCHED_PERIOD_S if state_of == self.machine_id else OTHER_PERIOD_S
                if (
                    state_of not in self._states
                    and now_s - self._sent_s.get(state_of, -1e9) < period
                ):
                    return
                self._sent_s.setdefault(state_of, now_s)
                if state_of not in self._states:
                    self._sent_s[state_of] = now_s
                self._states[state_of] = frame
            elif len(self._frames) >= QUEUE_LENGTH:
                self.is_closed = True
            else:
                self._frames.append(frame)
        self._wake()

    def close(self) -> None:
        """End the stream after what is queued."""
        with self._lock:
            self.is_closed = True
        self._wake()

    async def wait(self, timeout_s: float) -> list[Frame]:
        """What has come in, at once or within the timeout; empty when nothing did."""
        try:
            await asyncio.wait_for(self._ready.wait(), timeout_s)
        except TimeoutError:
            return []
        with self._lock:
            self._ready.clear()
            frames = [*self._frames, *self._states.values()]
            self._frames.clear()
            self._states.clear()
        return frames

    def _wake(self) -> None:
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._ready.set)


class EventHub:
    """All browsers that listen."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._clients: set[HubClient] = set()

    @property
    def client_count(self) -> int:
        """Browsers listening now."""
        with self._lock:
            return len(self._clients)

    def subscribe(self, session_id: str, machine_id: str | None) -> HubClient:
        """Add a browser; call in the event loop."""
        client = HubClient(session_id, machine_id)
        with self._lock:
            self._clients.add(client)
        return client

    def unsubscribe(self, client: HubClient) -> None:
        """Forget a browser."""
        client.close()
        with self._lock:
            self._clients.discard(client)

    def publish(self, event: AnyEvent, session_id: str | None = None) -> None:
        """Queue an event for all browsers, or for those of one session; from any thread."""
        with self._lock:
            clients = [c for c in self._clients if session_id in (None, c.session_id)]
        if not clients:
            return
        frame = Frame(event.kind, event.model_dump_json())
        state_of = event.machine.machine_id if isinstance(event, MachineStateEvent) else None
        for client in clients:
            client.push(frame, state_of)

    def alert(
        self, code: str, text: str, *, severity: str = "warning", machine_id: str | None = None
    ) -> None:
        """Tell everybody about something to look at."""
        level = "error" if severity == "error" else "info" if severity == "info" else "warning"
        self.publish(AlertEvent(severity=level, code=code, text=text, machine_id=machine_id))

    def end_session(self, session_id: str) -> None:
        """Close the streams of a session that ended."""
        with self._lock:
            clients = [c for c in self._clients if c.session_id == session_id]
        for client in clients:
            client.close()

    def close(self) -> None:
        """Close all streams."""
        with self._lock:
            clients = list(self._clients)
        for client in clients:
            client.close()
