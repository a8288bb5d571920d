"""Runs the drift test over the measured throws of each machine with the versions on board, for its alert."""

import logging
import threading
import time
from collections.abc import Iterator
from typing import Final

from sqlalchemy import select

from machine.conventions import Mode
from machine.messages import EventKind, MachineEvent
from server.alerts.alert_rules import Judgement, Subject
from server.deployments.machine_policies import MachinePolicies
from server.drift.drift_test import FALSE_ALARM_THROWS, Change, Drift, DriftTest, ThrowMiss
from server.machines.machine_registry import MachineRegistry
from server.schemas.alerts import AlertRule
from server.store.database import Database
from server.store.models import Throw

logger = logging.getLogger(__name__)

RETRY_S: Final = 30.0
"""From a failed test of a machine to the next."""
CONSIDERED_COUNT: Final = 3000
"""Newest measured throws of a mode and version."""
_WORDS: Final = {
    Change.LONG: "longer than predicted and than before",
    Change.SHORT: "shorter than predicted and than before",
    Change.LEFT: "further left than predicted and than before",
    Change.RIGHT: "further right than predicted and than before",
    Change.SPREAD_ALONG: "with more spread along than before",
    Change.SPREAD_ACROSS: "with more spread across than before",
}


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
                text = " ".join(self._texts(machine_id)) if is_listed else ""
            except Exception:
                logger.exception("the throws of %s could not be tested for drift", machine_id)
                with self._lock:
                    self._retry_s[machine_id] = now_s + RETRY_S
                continue
            with self._lock:
                self._retry_s.pop(machine_id, None)
            if is_listed:
                yield Judgement(Subject(AlertRule.DRIFT, machine_id), text or None)

    def _texts(self, machine_id: str) -> Iterator[str]:
        for entry in self._machine_policies.view(machine_id, None).policies:
            if entry.policy_sha256 is None:
                continue
            misses = self._misses(machine_id, entry.mode, entry.policy_sha256)
            test = DriftTest()
            drift: Drift | None = None
            for miss in misses:
                drift = test.add(miss)
            if drift is not None:
                since = len(misses) - drift.change_count
                yield (
                    f"{entry.mode.value.upper()} throws land {_WORDS[drift.change]}, for about "
                    f"{since} throws (false alarm: 1 in {FALSE_ALARM_THROWS:.0f} throws). "
                    "Diagnose it on page Gap."
                )

    def _misses(self, machine_id: str, mode: Mode, policy_sha256: str) -> list[ThrowMiss]:
        """Measured minus predicted misses, oldest first; throws without a prediction are left out."""
        columns = (
            Throw.measured_downrange_error_m,
            Throw.measured_crossrange_error_m,
            Throw.predicted_downrange_error_m,
            Throw.predicted_crossrange_error_m,
            Throw.predicted_sd_downrange_m,
            Throw.predicted_sd_crossrange_m,
        )
        query = (
            select(*columns)
            .where(
                Throw.machine_id == machine_id,
                Throw.mode == mode.value,
                Throw.policy_sha256 == policy_sha256,
                *(column.is_not(None) for column in columns),
                Throw.predicted_sd_downrange_m > 0.0,
                Throw.predicted_sd_crossrange_m > 0.0,
            )
            .order_by(Throw.throw_id.desc())
            .limit(CONSIDERED_COUNT)
        )
        with self._database.read() as database:
            rows = database.execute(query).all()
        found: list[ThrowMiss] = []
        for row in reversed(rows):
            # None is left out by the query.
            along, across, along_0, across_0, sd_along, sd_across = (value or 0.0 for value in row)
            along_m, across_m = along - along_0, across - across_0
            found.append(ThrowMiss(along_m / sd_along, across_m / sd_across, along_m, across_m))
        return found
