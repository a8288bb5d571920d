"""Watches machines and server and lets the rules judge: twice a second, and at once at a loss."""

import logging
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Final

from cryptography import x509

from machine.messages import MachineEvent
from server.alerts.alert_rules import (
    RULES,
    Judgement,
    MachineRecord,
    Subject,
    judge_certificate,
    judge_disk,
    judge_link,
    judge_machine,
)
from server.alerts.alerts import Alerts
from server.clock import utc_now
from server.limits.disk_space import disk_standing
from server.machines.machine_registry import KnownMachine, MachineRegistry
from server.settings import Settings

logger = logging.getLogger(__name__)

PERIOD_S: Final = 0.5
SLOW_PERIOD_S: Final = 30.0
"""Between looks at disk and certificate."""
START_S: Final = 20.0
"""After a start a machine has this long to connect again before it counts as lost; it tries every second."""


class AlertWatch:
    """One thread that judges; listeners only note what they hear."""

    def __init__(self, alerts: Alerts, registry: MachineRegistry, settings: Settings) -> None:
        self._alerts = alerts
        self._registry = registry
        self._settings = settings
        self.sources: list[Callable[[], Iterator[Judgement]]] = []
        """Further rules, asked at every look."""
        self._failed: list[Judgement] = []
        """Verdicts that could not be stored; judged again at the next look."""
        self._lock = threading.Lock()
        self._records: dict[str, MachineRecord] = {}
        self._found: set[str] = set()
        self._started_s = time.monotonic()
        self._slow_s = -1e9
        self._wake = threading.Event()
        self._is_closing = False
        self._thread: threading.Thread | None = None
        registry.on_lost.append(lambda _: self._wake.set())
        registry.on_found.append(self._note_found)

    def start(self) -> None:
        """Begin to judge."""
        self._started_s = time.monotonic()
        self._alerts.start()
        self._thread = threading.Thread(target=self._run, name="alert-watch", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop judging."""
        self._is_closing = True
        self._wake.set()
        if self._thread is not None:
            self._thread.join(timeout=5.0)

    def take_event(self, event: MachineEvent) -> None:
        """Note a machine's event that has been stored."""
        state = self._registry.get(event.machine_id).state
        is_of_now = state is not None and state.boot_id == event.boot_id
        machine_now_ns = self._registry.machine_t_mono_ns(event.machine_id) if is_of_now else None
        with self._lock:
            self._record(event.machine_id).take_event(event, machine_now_ns, utc_now())

    def _note_found(self, machine_id: str) -> None:
        with self._lock:
            self._found.add(machine_id)

    def _record(self, machine_id: str) -> MachineRecord:
        return self._records.setdefault(machine_id, MachineRecord(machine_id))

    def _run(self) -> None:
        while not self._is_closing:
            try:
                self.look()
            except Exception:
                logger.exception("alerts could not be judged")
            self._wake.wait(PERIOD_S)
            self._wake.clear()

    def look(self) -> None:
        """Judge everything once; a rule that fails holds up no other."""
        # Of a subject only the newest verdict counts.
        verdicts = {verdict.subject: verdict for verdict in (*self._failed, *self._verdicts())}
        self._failed = self._alerts.judge(verdicts.values())

    def _verdicts(self) -> Iterator[Judgement]:
        now_s = time.monotonic()
        for known in self._registry.listed():
            yield from _asked(partial(self._judge, known, now_s))
        for known in self._registry.retired():
            # Out of service: whatever was wrong with it concerns nobody any more.
            yield from (Judgement(Subject(rule, known.machine_id), None) for rule in RULES)
        for source in self.sources:
            yield from _asked(source)
        if now_s - self._slow_s < SLOW_PERIOD_S:
            return
        self._slow_s = now_s
        yield from _asked(self._judge_disk)
        yield from _asked(self._judge_certificate)

    def _judge_disk(self) -> Iterator[Judgement]:
        yield judge_disk(disk_standing(self._settings.data_dir, self._settings.min_free_bytes))

    def _judge_certificate(self) -> Iterator[Judgement]:
        certificate = self._settings.link_certificate
        if certificate is not None and (expires_utc := expiry(certificate)) is not None:
            yield from judge_certificate(expires_utc, utc_now())

    def _judge(self, known: KnownMachine, now_s: float) -> Iterator[Judgement]:
        machine_id, is_lost = known.machine_id, known.is_marked_lost
        with self._lock:
            record = self._record(machine_id)
            is_known = machine_id in self._found or now_s - self._started_s > START_S
            record.take_state(None if is_lost else known.state, now_s)
            verdicts = list(
                judge_machine(record, known.state, is_connected=not is_lost, now_s=now_s)
            )
        if is_known and known.last_seen_utc is not None:
            yield judge_link(machine_id, is_lost=is_lost)
        yield from verdicts


def _asked(source: Callable[[], Iterable[Judgement]]) -> Iterator[Judgement]:
    """What a source says, up to where it fails."""
    try:
        yield from source()
    except Exception:
        logger.exception("a rule of alerts failed")


def expiry(certificate: Path) -> datetime | None:
    """When the first certificate of a PEM file runs out; None if it cannot be read."""
    try:
        return x509.load_pem_x509_certificate(certificate.read_bytes()).not_valid_after_utc
    except (OSError, ValueError):
        logger.warning("%s cannot be read as a certificate", certificate)
        return None
