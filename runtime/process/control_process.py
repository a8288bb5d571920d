"""The control process: the 100 Hz loop around one machine, and its end of the socket to the link process.

One thread, no allocation-heavy work, no waiting for anybody: what the link process does not take is kept
(events, until they are on disk) or dropped and counted (rows). Run by machine_process.py.
"""

import json
import logging
import sys
import uuid
from collections import OrderedDict, deque
from typing import Any, Final

import numpy as np
from pydantic import TypeAdapter, ValidationError

from machine import calibration
from machine.conventions import CONTROL_PERIOD_NS, Mode
from machine.errors import DownrangeError, PolicyError
from machine.messages import Command, OperatorHeartbeat, StopRequest, ThrowState
from machine.site.zones import ZoneSet
from machine.spec import MachineSpec, load_spec
from runtime.control.policy import PolicyRunner
from runtime.link.ipc import (
    TICK_ROW,
    TICK_TAGS,
    Kind,
    Packet,
    PacketSocket,
    PeerGoneError,
    pack_rows,
)
from runtime.policies.on_board import OnBoardPolicies
from runtime.policies.puller import PolicyOffer
from runtime.policies.slots import PolicySlots
from runtime.process.alive_counter import AliveCounter
from runtime.process.driver_loader import load_driver
from runtime.process.machine_control import MachineControl, MachineSetup, TickReport
from runtime.process.machine_settings import MachineSettings
from runtime.process.policy_switch import PolicySwitch
from runtime.process.real_time import IdleGarbageCollector, become_real_time
from runtime.process.supervisor_connection import SupervisorConnection
from runtime.process.ticker import Clock, RealTimeClock, Ticker
from runtime.records.outbox import utc_now
from runtime.software import software_version
from runtime.throw.protocol import Latch, LinkLost, ThrowEvent
from runtime.throw.states import Message

logger = logging.getLogger(__name__)

PACKETS_PER_TICK_COUNT: Final = 32
"""Read at most so many packets a tick: a flood must not stretch the tick."""
KEPT_EVENTS_COUNT: Final = 2000
"""Events kept while the link process is away; far more than it takes to restart it."""
IDLE_DECIMATION: Final = 4
"""Without an open log only every fourth tick's rows are sent: the 25 Hz of the joint stream."""
STATUS_DECIMATION: Final = 10
CLOSING_LIMIT_TICKS: Final = 6000
"""A throw that has not ended a minute after the supervisor left is not going to."""

_COMMANDS: TypeAdapter[Command] = TypeAdapter(Command)
_STATE_CODES: Final = {state: code for code, state in enumerate(ThrowState)}


class ControlProcess:
    """The loop; everything in one thread."""

    def __init__(
        self,
        control: MachineControl,
        supervisor: SupervisorConnection,
        clock: Clock,
        alive: AliveCounter,
        policies: PolicySwitch,
    ) -> None:
        self._control = control
        self._policies = policies
        self._supervisor = supervisor
        self._clock = clock
        self._alive = alive
        self._port: PacketSocket | None = None
        self._has_memory = False
        self._zones: ZoneSet | None = None
        """As the link process read them; None = they cannot be read."""
        self._is_connected = False
        self._event_number = 0
        self._kept: OrderedDict[int, bytes] = OrderedDict()
        self._waiting: deque[tuple[Kind, bytes]] = deque()
        self._packet_count = 0
        self._log_context: dict[str, Any] | None = None
        self._log_result: dict[str, Any] | None = None

    def run(self) -> None:
        """Until the supervisor leaves and the machine rests; the valves are closed whatever ends it."""
        try:
            self._loop()
        finally:
            self._control.close()

    def _loop(self) -> None:
        rest = IdleGarbageCollector()
        ticker = Ticker(self._clock, CONTROL_PERIOD_NS)
        start_ns = self._control.driver.now_ns()
        closing_ticks = 0
        while closing_ticks < CLOSING_LIMIT_TICKS:
            tick = ticker.next()
            self._alive.add()
            messages = self._messages()
            if self._supervisor.is_gone:
                if closing_ticks == 0:
                    messages.append((0, LinkLost("the supervisor has ended")))
                elif self._control.is_waiting:
                    break
                closing_ticks += 1
            loaded = self._policies.next(self._control.throw.state)
            if loaded is not None:
                self._control.use_policy(loaded)
            due_ns = start_ns + tick.period_count * CONTROL_PERIOD_NS
            report = self._control.tick(due_ns, messages, tick.skipped_count)
            self._send(report, tick.period_count)
            if tick.period_count % STATUS_DECIMATION == 0:
                self._control.host.late_tick_ratio = ticker.lateness.late_tick_ratio
                if self._control.is_waiting:
                    rest.collect()

    # In -------------------------------------------------------------------------------------------

    def _messages(self) -> list[tuple[int, Message]]:
        new_port = self._supervisor.poll()
        messages: list[tuple[int, Message]] = []
        if new_port is not None:
            self._connect(PacketSocket(new_port))
        port = self._port
        if port is None:
            return messages
        try:
            for _ in range(PACKETS_PER_TICK_COUNT):
                packet = port.receive()
                if packet is None:
                    break
                self._take(packet, messages)
        except PeerGoneError:
            self._disconnect()
            messages.append((0, LinkLost("the link process has ended")))
        return messages

    def _take(self, packet: Packet, messages: list[tuple[int, Message]]) -> None:
        try:
            if packet.kind is Kind.HEARTBEAT:
                messages.append((0, OperatorHeartbeat.model_validate_json(packet.body)))
            elif packet.kind is Kind.COMMAND:
                body = packet.json
                command = _COMMANDS.validate_python(body["command"])
                # Until the journal has come, nobody knows which throws must not be repeated.
                if self._has_memory or isinstance(command, StopRequest):
                    messages.append((int(body["request"]), command))
            elif packet.kind is Kind.EVENT_ACK:
                self._forget_events(int(packet.json["number"]))
            elif packet.kind is Kind.LINK:
                self._take_link(packet.json, messages)
            elif packet.kind is Kind.ZONES:
                found = packet.json["zone_set"]
                self._zones = None if found is None else ZoneSet.model_validate(found)
            elif packet.kind is Kind.POLICY:
                self._policies.take(PolicyOffer.model_validate(packet.json))
            elif packet.kind is Kind.JOURNAL:
                self._take_journal(packet.json)
        except (ValidationError, ValueError, KeyError) as error:
            logger.error("a packet of the link process cannot be read: %s", error)

    def _take_link(self, body: dict[str, Any], messages: list[tuple[int, Message]]) -> None:
        host = self._control.host
        host.outbox_count = int(body["outbox_count"])
        host.recorder_dropped_count = int(body["recorder_dropped_count"])
        if self._is_connected and not body["is_connected"]:
            messages.append((0, LinkLost()))
        self._is_connected = bool(body["is_connected"])

    def _take_journal(self, body: dict[str, Any]) -> None:
        if self._has_memory:
            return
        latch = body["latch"]
        known = latch and Latch(latch["latch_id"], ThrowState(latch["state"]), latch["reason"])
        self._control.remember(
            int(body["epoch_count"]), tuple(body["throw_ids"]), known or None, self._zones
        )
        self._has_memory = True

    def _forget_events(self, number: int) -> None:
        while self._kept and next(iter(self._kept)) <= number:
            self._kept.popitem(last=False)

    # Out ------------------------------------------------------------------------------------------

    def _connect(self, port: PacketSocket) -> None:
        self._disconnect()
        self._port = port
        hello = {
            "state": self._control.machine_state().model_dump(mode="json"),
            "log": self._log_context,
            "is_log_open": self._control.log_throw_id is not None,
            "has_memory": self._has_memory,
        }
        self._queue(Kind.HELLO, hello)
        self._waiting.extend((Kind.EVENT, body) for body in self._kept.values())
        if self._log_result is not None:
            self._queue(Kind.LOG_END, self._log_result)

    def _disconnect(self) -> None:
        if self._port is not None:
            self._port.close()
        self._port = None
        self._is_connected = False
        self._waiting.clear()

    def _send(self, report: TickReport, period_count: int) -> None:
        if report.log_begins is not None:
            self._log_context, self._log_result = report.log_begins, None
            self._queue(Kind.LOG_BEGIN, report.log_begins)
        for event in report.events:
            self._keep(event)
        for request, reply in report.replies:
            body = {"request": request, "reply": reply.model_dump(mode="json")}
            self._queue(Kind.REPLY, body)
        if report.log_ends is not None:
            self._log_result = report.log_ends
        try:
            self._flush()
            self._send_rows(report, period_count)
            if report.log_ends is not None:
                self._queue(Kind.LOG_END, report.log_ends)
                self._flush()
            if period_count % STATUS_DECIMATION == 0 and self._port is not None:
                state = self._control.machine_state().model_dump_json().encode()
                self._port.send(Kind.STATUS, state)
        except PeerGoneError:
            # Noticed again, with its consequences, when the next tick reads.
            return

    def _keep(self, event: ThrowEvent) -> None:
        self._event_number += 1
        body = json.dumps(
            {
                "number": self._event_number,
                "kind": event.kind.value,
                "t_mono_ns": self._control.driver.now_ns(),
                "t_utc": utc_now(),
                "throw_id": event.throw_id,
                "plan_id": event.plan_id,
                "data": event.data,
            }
        ).encode()
        self._kept[self._event_number] = body
        if len(self._kept) > KEPT_EVENTS_COUNT:
            self._kept.popitem(last=False)
        if self._port is not None:
            self._waiting.append((Kind.EVENT, body))

    def _queue(self, kind: Kind, body: dict[str, Any]) -> None:
        if self._port is not None:
            self._waiting.append((kind, json.dumps(body).encode()))

    def _flush(self) -> None:
        """Send what must arrive in order; what does not fit waits for the next tick."""
        while self._waiting and self._port is not None:
            kind, body = self._waiting[0]
            if not self._port.send(kind, body):
                return
            self._waiting.popleft()

    def _send_rows(self, report: TickReport, period_count: int) -> None:
        is_logged = self._control.log_throw_id is not None or report.log_ends is not None
        if self._port is None or not report.rows:
            return
        if not is_logged and period_count % IDLE_DECIMATION:
            return
        self._packet_count += 1
        head = np.zeros(1, TICK_ROW)
        head["t_mono_ns"] = report.rows["control"]["t_mono_ns"]
        head["packet_count"] = self._packet_count
        head["state_code_count"] = _STATE_CODES[self._control.throw.state]
        head["is_logged"] = is_logged
        parts = {TICK_TAGS[name]: rows for name, rows in report.rows.items()}
        self._port.send(Kind.TICK, pack_rows({TICK_TAGS["tick"]: head, **parts}))


def on_board(settings: MachineSettings, spec: MachineSpec) -> OnBoardPolicies:
    """The policy versions on this machine's disk."""
    return OnBoardPolicies(PolicySlots(settings.policy_slots_dir), settings.policies_dir, spec)


def build_control(settings: MachineSettings) -> MachineControl:
    """Driver, policies and calibration of a machine.

    Raises:
        DownrangeError: something named in the settings cannot be used.
    """
    spec = load_spec()
    policies: dict[Mode, PolicyRunner] = {}
    refusals: dict[Mode, str] = {}
    versions = on_board(settings, spec)
    for mode in Mode:
        try:
            policies[mode] = versions.start(mode)
        except PolicyError as error:
            # The machine runs without it and says so in its arming checks.
            logger.warning("no %s policy on board: %s", mode.value, error)
            refusals[mode] = str(error)
    tables = (
        calibration.nominal_calibration(spec)
        if settings.calibration_file is None
        else calibration.load_calibration(settings.calibration_file)
    )
    driver = load_driver(settings.driver, settings.driver_options, settings.unit_seed_count)
    fixed = MachineSetup(
        settings.machine_id, uuid.uuid4().hex, spec, tables, policies, software_version(), refusals
    )
    return MachineControl(driver, fixed)


def main(argument: str, alive_argument: str) -> int:
    """Entry of the process; the arguments are the descriptors of the supervisor's socket and counter."""
    logging.basicConfig(level=logging.INFO, format="control: %(levelname)s %(message)s")
    supervisor = SupervisorConnection.from_argument(argument)
    try:
        settings = MachineSettings.model_validate(supervisor.settings())
        if settings.is_real_time:
            become_real_time()
        control = build_control(settings)
    except EOFError:
        return 0
    except DownrangeError as error:
        supervisor.tell(error=str(error))
        return 1
    supervisor.tell(is_ready=True)
    alive = AliveCounter(int(alive_argument))
    policies = PolicySwitch(on_board(settings, control.setup.spec).load)
    ControlProcess(control, supervisor, RealTimeClock(), alive, policies).run()
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
