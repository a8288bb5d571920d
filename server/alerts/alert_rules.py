"""The rules of alerts as pure functions: what the server knows of a machine, and what is wrong with it.

A rule that cannot be judged now, as of a machine that says nothing, is undecided: its alert stays as it is.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from types import MappingProxyType
from typing import Final, NamedTuple

from machine.messages import EventKind, MachineEvent, MachineState, ThrowState
from server.schemas.alerts import AlertRule, AlertSeverity

ARM_REFUSED_COUNT: Final = 3
"""Refused arms in a row."""
RECORDS_AFTER_S: Final = 60.0
"""A machine with a connection delivers its records within a second; a throw's log takes a few."""
CLOCK_OFFSET_S: Final = 5.0
"""Times in the history are compared to about a second; a synchronised clock is right to 0.1 s."""
CERTIFICATE_DAYS: Final = 30.0
"""A usual time to renew certificates in."""


class Rule(NamedTuple):
    """How an alert of a rule behaves."""

    severity: AlertSeverity
    clear_after_s: float
    """So long its condition has to be gone: one that comes and goes is one alert, not many."""


RULES: Final = MappingProxyType(
    {
        AlertRule.LOST: Rule("error", 3.0),
        AlertRule.STOPPED: Rule("error", 0.0),
        AlertRule.FAULT: Rule("error", 0.0),
        AlertRule.ARM_REFUSED: Rule("warning", 0.0),
        AlertRule.RECORDS: Rule("warning", 5.0),
        AlertRule.CLOCK: Rule("warning", 0.0),
        AlertRule.DISK: Rule("error", 60.0),
        AlertRule.CERTIFICATE: Rule("warning", 0.0),
        AlertRule.EXPIRED: Rule("error", 0.0),
        AlertRule.DRIFT: Rule("warning", 0.0),
        AlertRule.ROLLOUT: Rule("warning", 0.0),
    }
)


class Subject(NamedTuple):
    """What an alert is about; at most one of each is open."""

    rule: AlertRule
    machine_id: str | None


@dataclass(frozen=True, slots=True)
class Judgement:
    """What a rule says now: a text where its condition holds, None where it does not."""

    subject: Subject
    text: str | None


@dataclass(slots=True)
class MachineRecord:
    """What rules remember of a machine between its messages."""

    machine_id: str
    refused_arms_count: int | None = None
    """In a row; None before the machine has said anything about arming."""
    last_refusal: str = ""
    clock_offset_s: float | None = None
    """Machine's wall clock minus the server's; None before it is known."""
    waiting_since_s: float | None = None
    """Since when records have been waiting on the machine without a pause, monotonic."""

    def take_state(self, state: MachineState | None, now_s: float) -> None:
        """Note the present state; None: the machine says nothing."""
        if state is None or state.outbox_count == 0:
            self.waiting_since_s = None
        elif self.waiting_since_s is None:
            self.waiting_since_s = now_s

    def take_event(
        self, event: MachineEvent, machine_now_ns: int | None, now_utc: datetime
    ) -> None:
        """Note an event.

        Args:
            event: of this machine.
            machine_now_ns: the machine's own monotonic time now; None if the event is of another boot.
            now_utc: server's time.
        """
        if event.kind is EventKind.ARMED:
            self.refused_arms_count = 0
        elif event.kind is EventKind.COMMAND_REFUSED and event.data.get("command") == "arm":
            self.refused_arms_count = (self.refused_arms_count or 0) + 1
            self.last_refusal = str(event.data.get("detail", ""))[:300]
        if machine_now_ns is None:
            return
        try:
            happened_utc = datetime.fromisoformat(event.t_utc)
        except ValueError:
            return
        if happened_utc.tzinfo is not None:
            age_s = (machine_now_ns - event.t_mono_ns) * 1e-9
            self.clock_offset_s = (happened_utc - now_utc).total_seconds() + age_s


def judge_machine(
    record: MachineRecord, state: MachineState | None, *, is_connected: bool, now_s: float
) -> Iterator[Judgement]:
    """Judgements of the rules that can be judged, but for the link's.

    Args:
        record: what is remembered of the machine.
        state: its last state.
        is_connected: whether that state is the present.
        now_s: server's monotonic time.
    """
    refused_count = record.refused_arms_count
    if refused_count == 0:
        yield _verdict(AlertRule.ARM_REFUSED, record, None)
    elif refused_count is not None and refused_count >= ARM_REFUSED_COUNT:
        # Fewer say nothing: refusals before a restart of the server are not counted.
        text = f"Refused to arm {refused_count} times in a row: {record.last_refusal}"
        yield _verdict(AlertRule.ARM_REFUSED, record, text)
    if record.clock_offset_s is not None:
        offset_s = record.clock_offset_s
        way = "ahead of" if offset_s > 0.0 else "behind"
        text = f"The machine's clock is {abs(offset_s):.0f} s {way} the server's. Synchronise both."
        yield _verdict(AlertRule.CLOCK, record, text if abs(offset_s) > CLOCK_OFFSET_S else None)
    if state is None or not is_connected:
        return
    is_stopped = state.state is ThrowState.STOPPED
    reason = state.latched_reason or "no reason was given"
    yield _verdict(AlertRule.STOPPED, record, f"Stopped: {reason}." if is_stopped else None)
    is_faulty = state.state is ThrowState.FAULT
    yield _verdict(AlertRule.FAULT, record, f"Fault: {state.fault}." if is_faulty else None)
    since_s = record.waiting_since_s
    is_waiting = since_s is not None and now_s - since_s >= RECORDS_AFTER_S
    text = f"{state.outbox_count} records have not reached the server for {RECORDS_AFTER_S:.0f} s."
    yield _verdict(AlertRule.RECORDS, record, text if is_waiting else None)


def judge_link(machine_id: str, *, is_lost: bool) -> Judgement:
    """Judgement about a machine's link."""
    text = "The link is lost. What the console shows of this machine is old." if is_lost else None
    return Judgement(Subject(AlertRule.LOST, machine_id), text)


def judge_disk(standing: str) -> Judgement:
    """Judgement about the server's disk, from its standing in words; `ok` is well."""
    text = None if standing == "ok" else f"The server's data folder: {standing}."
    return Judgement(Subject(AlertRule.DISK, None), text)


def judge_certificate(expires_utc: datetime, now_utc: datetime) -> Iterator[Judgement]:
    """Judgements about the certificate of the machines' link: it runs out soon, it has run out."""
    days = (expires_utc - now_utc).total_seconds() / 86_400.0
    end = f"{expires_utc:%Y-%m-%d}"
    text = f"The link's certificate runs out on {end}, in {days:.0f} days. Renew it."
    is_soon = 0.0 <= days < CERTIFICATE_DAYS
    yield Judgement(Subject(AlertRule.CERTIFICATE, None), text if is_soon else None)
    text = f"The link's certificate ran out on {end}: machines cannot connect anew. Renew it."
    yield Judgement(Subject(AlertRule.EXPIRED, None), text if days < 0.0 else None)


def _verdict(rule: AlertRule, record: MachineRecord, text: str | None) -> Judgement:
    return Judgement(Subject(rule, record.machine_id), text)
