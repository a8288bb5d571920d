"""Runs the drift test over the measured throws of each machine with the versions on board, for its alert."""

import logging
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Final

from machine.messages import EventKind, MachineEvent
from server.alerts.alert_rules import Judgement, Subject
from server.deployments.machine_policies import MachinePolicies
from server.drift.drift_test import FALSE_ALARM_THROWS
from server.drift.found_drift import CHANGE_WORDS, FoundDrift, found_drifts
from server.machines.machine_registry import MachineRegistry
from server.schemas.alerts import AlertRule
from server.store.database import Database

logger = logging.getLogger(__name__)

RETRY_S: Final = 30.0
"""From a failed test of a machine to the next."""


class DriftWatch:
    """Judges machines that have thrown since it last looked; thread-safe."""

    def __init__(
        self, database: Database, registry: MachineRegistry, machine_policies: MachinePolicies
    ) -> None:
        self._database = database
        self._registry = registry
        self._machine_policies = machine_policies
        self._lock = threading.Lock()
        self._due = {known.machine_id for known in registry.all()}
        self._retry_s: dict[str, float] = {}
        self.on_found: list[Callable[[str, Sequence[FoundDrift]], None]] = []
        """Called with the drifts of a machine that was judged, often with none."""

    def note(self, machine_id: str) -> None:
        """A throw of a machine has news."""
        with self._lock:
            self._due.add(machine_id)

    def take_event(self, event: MachineEvent) -> None:
        """An event that has been stored may say that another version is on board."""
        if event.kind in (EventKind.BOOTED, EventKind.POLICY_SWITCHED, EventKind.POLICY_REFUSED):
            self.note(event.machine_id)

    def verdicts(self) -> Iterator[Judgement]:
        """What the test says of machines with news."""
        now_s = time.monotonic()
        with self._lock:
            due, self._due = self._due, set()
            due |= {machine_id for machine_id, at_s in self._retry_s.items() if at_s <= now_s}
        for machine_id in sorted(due):
            try:
                is_listed = self._registry.get(machine_id).is_listed
                drifts = self._drifts(machine_id) if is_listed else []
            except Exception:
                logger.exception("the throws of %s could not be tested for drift", machine_id)
                with self._lock:
                    self._retry_s[machine_id] = now_s + RETRY_S
                continue
            with self._lock:
                self._retry_s.pop(machine_id, None)
            if is_listed:
                text = " ".join(_text(drift) for drift in drifts)
                yield Judgement(Subject(AlertRule.DRIFT, machine_id), text or None)
                for listener in self.on_found:
                    listener(machine_id, drifts)

    def _drifts(self, machine_id: str) -> list[FoundDrift]:
        return list(found_drifts(self._database, self._machine_policies, machine_id))


def _text(drift: FoundDrift) -> str:
    return (
        f"{drift.mode.value.upper()} throws land {CHANGE_WORDS[drift.change]}, for about "
        f"{len(drift.since)} throws (false alarm: 1 in {FALSE_ALARM_THROWS:.0f} throws)."
    )
