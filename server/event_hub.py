"""Distributes events to browsers through one bounded queue each, so that a slow browser delays no other.

States of machines replace each other in the queue and are limited in rate; everything else is kept in
order. A queue that overflows is closed: the browser reconnects and reads the present state anew.
"""

import asyncio
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from server.schemas.events import (
    AlertEvent,
    AlertUpdatedEvent,
    GapUpdatedEvent,
    JobUpdatedEvent,
    LeaseChangedEvent,
    MachineLostEvent,
    MachineRetiredEvent,
    MachineStateEvent,
    PlanUpdatedEvent,
    PointPickedEvent,
    RolloutUpdatedEvent,
    SiteUpdatedEvent,
    TargetProposedEvent,
    ThrowUpdatedEvent,
    TwinUpdatedEvent,
    ZonesUpdatedEvent,
)

DiscreteEvent = (
    MachineLostEvent
    | MachineRetiredEvent
    | LeaseChangedEvent
    | TargetProposedEvent
    | PointPickedEvent
    | PlanUpdatedEvent
    | ThrowUpdatedEvent
    | GapUpdatedEvent
    | TwinUpdatedEvent
    | SiteUpdatedEvent
    | ZonesUpdatedEvent
    | AlertEvent
    | AlertUpdatedEvent
    | RolloutUpdatedEvent
    | JobUpdatedEvent
)

QUEUE_LENGTH = 512
WATCHED_PERIOD_S = 0.075
"""State of the machine that the browser watches: all of the 10 Hz, with room for jitter of 20 ms."""
OTHER_PERIOD_S = 0.95
GATHER_S = 0.02
"""From the first new state to the message that takes it along; anything else is sent at once."""


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

    def period_s(self, machine_id: str) -> float:
        """How often this browser gets a machine's state."""
        return WATCHED_PERIOD_S if machine_id == self.machine_id else OTHER_PERIOD_S

    def push(self, frame: Frame) -> None:
        """Queue an event that must not be left out."""
        with self._lock:
            is_woken = self._has_frames()
            if len(self._frames) >= QUEUE_LENGTH:
                self.is_closed, is_woken = True, False
            elif not self.is_closed:
                self._frames.append(frame)
        if not is_woken:
            self._wake()

    def push_state(self, machine_id: str, frame: Frame) -> None:
        """Queue a machine's state in place of an older one that was not sent yet."""
        with self._lock:
            if self.is_closed:
                return
            is_woken = self._has_frames()
            self._states[machine_id] = frame
        if not is_woken:
            self._wake()

    def _has_frames(self) -> bool:
        """Whether something is queued, and the event loop so knows already."""
        return bool(self._frames or self._states)

    def close(self) -> None:
        """End the stream after what is queued."""
        with self._lock:
            self.is_closed = True
        self._wake()

    async def wait(self, timeout_s: float) -> list[Frame]:
        """Queued frames, or those that arrive within the timeout; empty if none do."""
        try:
            await asyncio.wait_for(self._ready.wait(), timeout_s)
        except TimeoutError:
            return []
        if not self._frames:
            # States of other machines come within moments: one message for all of them.
            await asyncio.sleep(GATHER_S)
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
        self._sent_s: dict[tuple[str, float], float] = {}
        """When a machine's state was last sent to browsers that get it with a period, by machine and period.

        Of all browsers together: a state is made and encoded once for all that are due.
        """

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

    def publish(self, event: DiscreteEvent, session_id: str | None = None) -> None:
        """Queue an event for all browsers, or for those of one session; from any thread."""
        with self._lock:
            clients = [c for c in self._clients if session_id in (None, c.session_id)]
        if not clients:
            return
        frame = Frame(event.kind, event.model_dump_json())
        for client in clients:
            client.push(frame)

    def publish_state(
        self, machine_id: str, make: Callable[[], MachineStateEvent], *, is_urgent: bool = False
    ) -> None:
        """Send a machine's state to the browsers that are due; it is made only if there is one."""
        now_s = time.monotonic()
        with self._lock:
            if not self._clients:
                return
            due = {
                period_s
                for period_s in (WATCHED_PERIOD_S, OTHER_PERIOD_S)
                if is_urgent or now_s - self._sent_s.get((machine_id, period_s), -1e9) >= period_s
            }
            clients = [c for c in self._clients if due and c.period_s(machine_id) in due]
            self._sent_s.update({(machine_id, period_s): now_s for period_s in due})
        if not clients:
            return
        event = make()
        frame = Frame(event.kind, event.model_dump_json())
        for client in clients:
            client.push_state(machine_id, frame)

    def alert(
        self, code: str, text: str, *, severity: str = "warning", machine_id: str | None = None
    ) -> None:
        """Send an alert to all browsers."""
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
