"""Stores machine events, each exactly once, and applies them to throws.

The whole batch is one transaction; only after it is on disk the machine gets its acknowledgement and
deletes what it had kept.
"""

import logging
import math
from collections.abc import Callable

from pydantic import JsonValue, ValidationError
from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession

from machine.messages import EventAck, EventBatch, EventKind, ImpactSurvey, MachineEvent, ThrowEnd
from server.clock import utc_now
from server.event_hub import EventHub
from server.metrics import ServiceMetrics
from server.schemas.history import Outcome, ThrowPhase
from server.store.database import Database
from server.store.models import Event, Throw
from server.throws.impacts import add_impact
from server.throws.throw_store import ThrowStore, move_row

logger = logging.getLogger(__name__)

_PHASES = {
    EventKind.THROW_ACCEPTED: ThrowPhase.ACCEPTED,
    EventKind.THROW_STARTED: ThrowPhase.THROWING,
    EventKind.RELEASE_COMMANDED: ThrowPhase.COMMITTED,
}
_ALERTS = {
    EventKind.BOOTED: ("info", "has started"),
    EventKind.STOP_LATCHED: ("error", "is stopped"),
    EventKind.FAULT: ("error", "has a fault"),
    EventKind.STOP_CLEARED: ("info", "is released from stop"),
    EventKind.POLICY_SWITCHED: ("info", "throws with {policy}"),
    EventKind.POLICY_REFUSED: ("error", "refuses {policy}"),
}
EndListener = Callable[[str], None]
StoreListener = Callable[[DatabaseSession, MachineEvent], None]


class EventIngest:
    """Takes batches of events."""

    def __init__(
        self,
        database: Database,
        throws: ThrowStore,
        hub: EventHub,
        metrics: ServiceMetrics,
        policy_name_of: Callable[[str], str],
    ) -> None:
        """Begin.

        Args:
            database: events and throws.
            throws: follows them.
            hub: tells consoles.
            metrics: counts.
            policy_name_of: id of a policy version by its sha256.
        """
        self._policy_name_of = policy_name_of
        self._database = database
        self._throws = throws
        self._hub = hub
        self._metrics = metrics
        self.on_throw_end: list[EndListener] = []
        self.on_store: list[StoreListener] = []
        """Called for each new event inside the transaction that stores it."""
        self.on_event: list[Callable[[MachineEvent], None]] = []
        """Called for each new event when it is on disk."""

    def take(self, batch: EventBatch) -> EventAck:
        """Store a batch; returns what the machine may delete."""
        with self._database.write() as database:
            fresh = [_cleaned(event) for event in self._fresh(database, batch)]
            for event in fresh:
                database.add(_row(event))
                self._apply(database, event)
                for listener in self.on_store:
                    listener(database, event)
        for event in fresh:
            self._metrics.events_count.labels(kind=event.kind.value).inc()
            self._follow(event)
        self._metrics.event_repeats_count.inc(len(batch.events) - len(fresh))
        last = max((event.sequence_count for event in batch.events), default=-1)
        return EventAck(boot_id=batch.boot_id, sequence_count=last)

    @staticmethod
    def _fresh(database: DatabaseSession, batch: EventBatch) -> list[MachineEvent]:
        by_boot: dict[str, list[int]] = {}
        for event in batch.events:
            by_boot.setdefault(event.boot_id, []).append(event.sequence_count)
        stored: set[tuple[str, int]] = set()
        for boot_id, sequences in by_boot.items():
            stored |= {
                (boot_id, sequence)
                for sequence in database.scalars(
                    select(Event.sequence_count).where(
                        Event.machine_id == batch.machine_id,
                        Event.boot_id == boot_id,
                        Event.sequence_count.in_(sequences),
                    )
                )
            }
        fresh: list[MachineEvent] = []
        for event in batch.events:
            key = (event.boot_id, event.sequence_count)
            if key not in stored:
                stored.add(key)
                fresh.append(event)
        return fresh

    def _apply(self, database: DatabaseSession, event: MachineEvent) -> None:
        if event.throw_id is None:
            return
        database.flush()
        throw = database.get(Throw, event.throw_id)
        if throw is None or throw.machine_id != event.machine_id:
            logger.warning("event %s of unknown throw %s", event.kind, event.throw_id)
            return
        try:
            self._apply_to(database, throw, event)
        except ValidationError as error:
            # The event itself is kept as it came; what it says about the throw cannot be used.
            logger.warning("data of %s of throw %s: %s", event.kind, throw.throw_id, error)

    @staticmethod
    def _apply_to(database: DatabaseSession, throw: Throw, event: MachineEvent) -> None:
        if event.kind in _PHASES:
            move_row(throw, _PHASES[event.kind])
        elif event.kind is EventKind.IMPACT:
            survey = ImpactSurvey.model_validate(event.data)
            if all(math.isfinite(value) for value in survey.position_m):
                add_impact(
                    database,
                    throw,
                    survey.position_m,
                    survey.source,
                    sd_m=survey.sd_m if math.isfinite(survey.sd_m) else None,
                    recorded_by=event.machine_id,
                    footprint=survey.footprint,
                )
        elif event.kind is EventKind.THROW_ENDED:
            end = ThrowEnd.model_validate(event.data)
            throw.phase = ThrowPhase.ENDED.value
            throw.outcome = Outcome(end.outcome).value
            throw.detail = end.detail
            throw.is_policys_own = end.is_policys_own
            throw.release_speed_m_per_s = _finite(end.release_speed_m_per_s)
            throw.throw_duration_s = _finite(end.throw_duration_s)

    def _follow(self, event: MachineEvent) -> None:
        """What happens after the events are on disk."""
        for listener in self.on_event:
            listener(event)
        if event.kind in _ALERTS:
            severity, text = _ALERTS[event.kind]
            said = event.data.get("detail") or event.data.get("fault") or _rollback_words(event)
            detail = str(said).rstrip(".")
            text = text.format(policy=self._policy_words(event))
            self._hub.alert(
                event.kind.value,
                f"{event.machine_id} {text}{f': {detail}' if detail else ''}.",
                severity=severity,
                machine_id=event.machine_id,
            )
        if event.throw_id is None:
            return
        if event.kind in _PHASES or event.kind is EventKind.THROW_ENDED:
            self._throws.resolve(event.throw_id)
        if event.kind is EventKind.THROW_ENDED:
            for end_listener in self.on_throw_end:
                end_listener(event.throw_id)
        self._throws.publish(event.throw_id)

    def _policy_words(self, event: MachineEvent) -> str:
        """Which policy an event is about, for example `2D policy m545-2d-v7 (9f8e7d6c5b4a)`."""
        mode, sha256 = event.data.get("mode"), event.data.get("policy_sha256")
        kind = f"{str(mode or '').upper()} policy".strip()
        if not isinstance(sha256, str) or not sha256:
            return f"its {kind}"
        name = self._policy_name_of(sha256)
        return (
            f"{kind} {sha256[:12]}" if sha256.startswith(name) else f"{kind} {name} ({sha256[:12]})"
        )


def _rollback_words(event: MachineEvent) -> str:
    """That a switch was a rollback at the machine itself; empty for other events."""
    is_switch = event.kind is EventKind.POLICY_SWITCHED
    is_local = event.data.get("deployment_count") is None and event.data.get("slot") is not None
    return "rolled back at the machine" if is_switch and is_local else ""


def _cleaned(event: MachineEvent) -> MachineEvent:
    """The event with data that every database takes: what follows from it is stored as well."""
    return event.model_copy(update={"data": _storable(event.data)})


def _row(event: MachineEvent) -> Event:
    return Event(
        machine_id=event.machine_id,
        boot_id=event.boot_id,
        sequence_count=event.sequence_count,
        t_mono_ns=event.t_mono_ns,
        t_utc=event.t_utc[:40],
        kind=event.kind.value,
        throw_id=event.throw_id,
        plan_id=event.plan_id,
        data=event.data,
        received_utc=utc_now(),
    )


def _storable(value: JsonValue) -> JsonValue:
    """JSON that every database takes: no NaN, no NUL characters."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, str):
        return value.replace("\x00", "")
    if isinstance(value, list):
        return [_storable(item) for item in value]
    if isinstance(value, dict):
        return {key.replace("\x00", ""): _storable(item) for key, item in value.items()}
    return value


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None
