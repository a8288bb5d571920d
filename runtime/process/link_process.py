"""The link process: everything of a machine that may be slow. Zenoh, disk, records, uploads.

The control process never waits for it; when it dies it is started anew and loses nothing that it has
acknowledged. Order of duties for what control sends: to the disk first, then onward.
"""

import logging
import selectors
import sys
import time
import uuid
from collections import deque
from contextlib import ExitStack
from dataclasses import asdict
from typing import Any, Final

import zenoh
from pydantic import ValidationError

from machine.errors import DownrangeError
from machine.messages import (
    CommandReply,
    EventKind,
    ImpactSurvey,
    JointStream,
    MachineEvent,
    MachineState,
    StopRequest,
    ThrowState,
)
from runtime.link import ipc
from runtime.link.command_inbox import COMMANDS, CommandInbox
from runtime.link.ipc import Kind, Packet, PacketSocket, PeerGoneError
from runtime.link.server_link import ReplySlot, ServerLink
from runtime.link.zenoh_config import client_config
from runtime.policies.puller import PolicyPuller
from runtime.process.alive_counter import AliveCounter
from runtime.process.machine_settings import MachineSettings
from runtime.process.supervisor_connection import SupervisorConnection
from runtime.records.event_intake import ControlEvent, EventIntake
from runtime.records.event_sender import EventSender
from runtime.records.hour_counter import HourCounter
from runtime.records.journal import Journal
from runtime.records.latch_file import LatchFile
from runtime.records.log_upload import LogUploader, UploadTarget
from runtime.records.outbox import EventDraft, Outbox, OutboxError, set_damaged_aside, utc_now
from runtime.records.records import Records
from runtime.throw.protocol import Latch

logger = logging.getLogger(__name__)

BEAT_S: Final = 0.1
"""Period of what the link does by itself: report to control, state while control is gone."""
CONTROL_SILENCE_S: Final = 0.2
"""Five missed packets of rows (25 Hz at rest): the control process hangs."""
LAST_EVENTS_S: Final = 2.0
"""At the end, so long for the last events to reach the server."""
JOINTS_PERIOD_NS: Final = 40_000_000
_STATES: Final = list(ThrowState)


class LinkProcess:
    """Main thread: the socket to control. Others: Zenoh's, commands, events, recorder, uploads."""

    def __init__(
        self,
        settings: MachineSettings,
        supervisor: SupervisorConnection,
        alive: AliveCounter,
        stack: ExitStack,
    ) -> None:
        self._settings = settings
        self._supervisor = supervisor
        self._alive = alive
        is_new = _is_new_machine(settings)
        damage = set_damaged_aside(settings.database_file)
        if not (is_new or damage or settings.database_file.exists()):
            damage = "the records of this machine are missing"
        self._outbox = Outbox(settings.database_file, settings.machine_id)
        stack.callback(self._outbox.close)
        self._journal = Journal(self._outbox)
        self._latches = LatchFile(settings.latch_file, is_new_machine=is_new)
        self._intake = EventIntake(self._journal, self._latches, self._event_stored)
        self._news: deque[Latch] = deque()
        """Latches that this process decided on and that have no event yet."""
        self._hello: dict[str, Any] | None = None
        """What control said first, until it is on the disk and answered."""
        self._event_number = 0
        self._held: list[tuple[int, CommandReply]] = []
        """Answers that wait for their latch to be on the disk."""
        self._stop_reply: CommandReply | None = None
        if damage:
            self._latch(damage)
            self._journal.forget_zones()
        self._port: PacketSocket | None = None
        self._state: MachineState | None = None
        self._heard_s = time.monotonic()
        self._fault = "the control process has not started yet"
        self._packet_count = self._joints_ns = 0
        self._beat_s = 0.0
        url, key = settings.server_url, settings.site_key
        target = UploadTarget(url, settings.machine_id, settings.password()) if url else None
        self._uploader = LogUploader(target, self._journal, settings.throws_dir) if target else None
        self._policies = PolicyPuller(settings.policy_slots_dir, target, self._send, key)
        self._hours = HourCounter(settings.hours_file)
        self._records = Records(settings.throws_dir, self._journal, self._log_stored)
        stack.callback(self._records.close)
        if self._uploader is not None:
            stack.callback(self._uploader.close)
            self._uploader.start()
        stack.callback(self._policies.close)
        self._policies.start()
        self._inbox = CommandInbox(settings.machine_id, self._journal, self._send, self._stop_alone)
        stack.callback(self._inbox.close)
        self._link = ServerLink(settings.site, settings.machine_id, self._config, self)
        self._sender = EventSender(self._outbox, self._link.ask_events)
        if settings.connect:
            stack.callback(self._link.close)
            self._link.start()
            stack.callback(self._sender.close)
            self._sender.start()

    def _config(self) -> zenoh.Config:
        settings = self._settings
        user = settings.username or (settings.machine_id if settings.password_file else None)
        return client_config(
            connect=settings.connect,
            user=user,
            password=settings.password(),
            root_ca_file=settings.root_ca_file,
        )

    # Main loop ------------------------------------------------------------------------------------

    def run(self) -> None:
        """Until the supervisor leaves and control has ended."""
        with selectors.DefaultSelector() as selector:
            selector.register(self._supervisor, selectors.EVENT_READ)
            while not (self._supervisor.is_gone and self._port is None):
                self._alive.add()
                events = selector.select(BEAT_S)
                if self._supervisor.is_gone:
                    # A socket that has ended is readable for ever.
                    if any(key.fileobj is self._supervisor for key, _ in events):
                        selector.unregister(self._supervisor)
                elif (new_port := self._supervisor.poll()) is not None:
                    self._connect(PacketSocket(new_port), selector)
                self._read(selector)
                if time.monotonic() - self._beat_s >= BEAT_S:
                    self._beat()
        self._hand_over_last_events()

    def _connect(self, port: PacketSocket, selector: selectors.BaseSelector) -> None:
        self._read(selector)
        self._disconnect(selector)
        self._port = port
        selector.register(port, selectors.EVENT_READ)
        self._event_number, self._hello = 0, None
        self._heard_s = time.monotonic()

    def _disconnect(self, selector: selectors.BaseSelector) -> None:
        if self._port is not None:
            selector.unregister(self._port)
            self._port.close()
        self._port = None
        self._inbox.give_up()

    def _read(self, selector: selectors.BaseSelector) -> None:
        port = self._port
        if port is None:
            return
        try:
            while (packet := port.receive()) is not None:
                self._heard_s = time.monotonic()
                self._take_guarded(packet)
        except PeerGoneError:
            self._disconnect(selector)
            if not self._supervisor.is_gone:
                self._control_died()

    def _send(self, kind: Kind, body: dict[str, Any]) -> bool:
        port = self._port
        if port is None:
            return False
        try:
            return port.send_json(kind, body)
        except (PeerGoneError, ValueError) as error:
            logger.info("a %s packet was not sent: %r", kind.name, error)
            return False

    def _hand_over_last_events(self) -> None:
        end_s = time.monotonic() + LAST_EVENTS_S
        while self._link.is_connected and self._outbox.count() and time.monotonic() < end_s:
            self._sender.wake()
            time.sleep(0.02)

    # From control ---------------------------------------------------------------------------------

    def _take_guarded(self, packet: Packet) -> None:
        try:
            self._take(packet)
        except OutboxError as error:
            # Not acknowledged: control keeps the event and gives it again when the link is new.
            self._fault = str(error)
            logger.error("%s", error)
        except (ValueError, KeyError, TypeError) as error:
            logger.error("a %s packet of control cannot be read: %s", packet.kind.name, error)

    def _take(self, packet: Packet) -> None:
        if packet.kind is Kind.TICK:
            self._take_tick(packet.body)
        elif packet.kind is Kind.STATUS:
            self._take_state(MachineState.model_validate_json(packet.body))
        elif packet.kind is Kind.EVENT:
            self._take_event(packet.json)
        elif packet.kind is Kind.REPLY:
            body = packet.json
            self._held.append((int(body["request"]), CommandReply.model_validate(body["reply"])))
            self._answer_held()
        elif packet.kind is Kind.LOG_BEGIN:
            context = packet.json
            self._records.begin(context["throw_id"], context)
        elif packet.kind is Kind.LOG_END:
            self._records.end(packet.json)
        elif packet.kind is Kind.HELLO:
            self._hello = packet.json
            self._take_hello(packet.json)

    def _take_hello(self, body: dict[str, Any]) -> None:
        state = MachineState.model_validate(body["state"])
        has_memory = bool(body["has_memory"])
        if not has_memory and self._journal.open_throws():
            self._latch("the machine's computer stopped during a throw")
        self._state, self._fault, self._packet_count = state, "", 0
        data = {
            "software": state.software,
            "model_sha256": state.model_sha256,
            "policy_sha256": state.policy_sha256,
            "rolled_back_from": self._policies.rolled_back_from(),
        }
        draft = EventDraft(EventKind.BOOTED, state.t_mono_ns, None, None, data, utc_now())
        interrupted = self._journal.begin_boot(state.boot_id, draft)
        for throw_id in interrupted:
            logger.warning("throw %s was interrupted by a restart", throw_id)
        self._report_latches()
        if not has_memory:
            memory = self._journal.memory()
            self._send(Kind.ZONES, {"zone_set": self._journal.zones_for_control()})
            latch = self._latches.latch
            answer = {
                "epoch_count": memory.epoch_count,
                "throw_ids": memory.throw_ids,
                "latch": None if latch is None else asdict(latch),
            }
            self._send(Kind.JOURNAL, answer)
        # Last: to recover broken-off logs takes a while.
        self._records.resume(body["log"], is_open=bool(body["is_log_open"]))
        self._hello = None
        self._sender.wake()

    def _answer_held(self) -> None:
        """Answers in order; one that says STOPPED waits until the latch is on the disk."""
        while self._held:
            request, reply = self._held[0]
            is_stop = reply.accepted and reply.state is ThrowState.STOPPED
            if is_stop and not self._intake.is_durable(reply.latch_id):
                return
            self._held.pop(0)
            self._inbox.take_reply(request, reply)

    def _latch(self, reason: str) -> None:
        """Latch STOPPED without the control process; an earlier latch stays."""
        latch = Latch(f"link-{uuid.uuid4().hex[:12]}", ThrowState.STOPPED, reason)
        if self._intake.latch_unless_latched(latch):
            self._news.append(latch)

    def _report_latches(self) -> None:
        """Events of the latches that this process decided on, once there is a boot to report them under."""
        state = self._state
        while self._news and state is not None:
            latch = self._news.popleft()
            data = {"reason": latch.reason, "latch_id": latch.latch_id}
            draft = EventDraft(EventKind.STOP_LATCHED, state.t_mono_ns, None, None, data, utc_now())
            self._intake.take(ControlEvent(state.boot_id, 0, draft))

    def _take_event(self, body: dict[str, Any]) -> None:
        state = self._state
        if state is None:
            return
        kind, t_ns, t_utc = EventKind(body["kind"]), int(body["t_mono_ns"]), body["t_utc"]
        draft = EventDraft(kind, t_ns, body["throw_id"], body["plan_id"], body["data"], t_utc)
        self._event_number = int(body["number"])
        is_stored = self._intake.take(ControlEvent(state.boot_id, self._event_number, draft))
        # The event first: slots that a power cut leaves behind it are what the next start tells of.
        self._policies.take_event(draft.kind, draft.data)
        # Not acknowledged while it waits for the disk: control keeps it too.
        if is_stored:
            self._send(Kind.EVENT_ACK, {"number": self._event_number})

    def _event_stored(self, event: MachineEvent) -> None:
        self._sender.wake()
        self._records.add_event(event)
        if event.kind is EventKind.IMPACT:
            t_ns = int(event.data["t_mono_ns"])
            self._records.add_impact(ImpactSurvey.model_validate(event.data), t_ns)

    def _take_tick(self, body: bytes) -> None:
        parts = ipc.unpack_rows(body, ipc.TICK_DTYPES)
        head = parts[ipc.TICK_TAGS["tick"]][0]
        count = int(head["packet_count"])
        lost = count - self._packet_count - 1 if self._packet_count else 0
        self._packet_count = count
        if head["is_logged"]:
            self._records.count_lost(lost)
            rows = {name: parts[tag] for name, tag in ipc.TICK_TAGS.items() if tag and tag in parts}
            self._records.add_rows(rows, int(head["t_mono_ns"]))
        if int(head["t_mono_ns"]) - self._joints_ns >= JOINTS_PERIOD_NS:
            self._joints_ns = int(head["t_mono_ns"])
            self._publish_joints(parts, _STATES[int(head["state_code_count"])])

    def _control_died(self) -> None:
        state = self._state
        self._fault = "the control process has died; it is being started anew"
        logger.error("%s", self._fault)
        self._latch("the control process died")
        self._held.clear()
        if state is None:
            return
        draft = EventDraft(
            EventKind.FAULT,
            state.t_mono_ns,
            state.throw_id,
            state.plan_id,
            {"reason": self._fault},
            utc_now(),
        )
        self._intake.take(ControlEvent(state.boot_id, 0, draft))
        self._report_latches()

    # To the server --------------------------------------------------------------------------------

    def _take_state(self, state: MachineState) -> None:
        self._state = state
        latch = self._latches.latch
        if latch is not None and state.state not in (ThrowState.STOPPED, ThrowState.FAULT):
            # A stop that this process answered while control was silent, and that control never read.
            command = StopRequest(
                command_id=latch.latch_id, machine_id=state.machine_id, issuer="link process"
            )
            self._send(Kind.COMMAND, {"request": 0, "command": command.model_dump(mode="json")})
        self._publish_state(state)

    def _publish_state(self, state: MachineState) -> None:
        complete = state.model_copy(
            update={
                "outbox_count": self._outbox.count(),
                "recorder_dropped_count": self._records.dropped_count,
                "fault": state.fault or self._intake.failure or self._records.failure,
                **self._hours.take(state),
            }
        )
        self._link.publish("state", complete.model_dump_json().encode())

    def _publish_joints(self, parts: dict[int, Any], state: ThrowState) -> None:
        row = parts[ipc.TICK_TAGS["control"]][0]
        ball = parts.get(ipc.TICK_TAGS["ball"])
        held = bool(row["payload_held"])
        position = None if ball is None or held else tuple(ball["position_m"][0].tolist())
        message = JointStream(
            machine_id=self._settings.machine_id,
            t_mono_ns=int(row["t_mono_ns"]),
            joint_position_rad_m=tuple(row["joint_position_rad_m"].tolist()),
            joint_velocity_rad_m_per_s=tuple(row["joint_velocity_rad_m_per_s"].tolist()),
            state=state,
            payload_held=held,
            ball_position_m=position,
        )
        self._link.publish("joints", message.model_dump_json().encode())

    def _beat(self) -> None:
        self._beat_s = time.monotonic()
        self._inbox.give_up(age_s=5.0)
        self._catch_up()
        body = {
            "is_connected": self._link.is_connected,
            "outbox_count": self._outbox.count(),
            "recorder_dropped_count": self._records.dropped_count,
        }
        self._send(Kind.LINK, body)
        fault = self._fault
        if not fault and self._beat_s - self._heard_s > CONTROL_SILENCE_S:
            fault = "the control process is silent"
        if fault and self._state is not None:
            latch = self._latches.latch
            changes = {
                "state": ThrowState.FAULT,
                "fault": fault,
                "stop_latched": latch is not None,
                "latch_id": latch.latch_id if latch else "",
                "latched_reason": latch.reason if latch else "",
            }
            self._publish_state(self._state.model_copy(update=changes))

    def _catch_up(self) -> None:
        """What the disk refused earlier, and latches of other threads."""
        had_waiting = self._intake.waiting_count > 0
        if self._intake.retry() and had_waiting and self._event_number:
            self._send(Kind.EVENT_ACK, {"number": self._event_number})
        self._report_latches()
        self._answer_held()
        if self._hello is not None:
            try:
                self._take_hello(self._hello)
            except OutboxError as error:
                self._fault = str(error)

    def _log_stored(self) -> None:
        self._sender.wake()
        if self._uploader is not None:
            self._uploader.wake()

    def _stop_alone(self, command: StopRequest) -> CommandReply | None:
        """Latch a STOP that control cannot take; it comes back STOPPED. None while control is alive."""
        if self._port is not None and time.monotonic() - self._heard_s <= CONTROL_SILENCE_S:
            return None
        known = self._stop_reply
        if known is not None and known.command_id == command.command_id:
            return known.model_copy(update={"is_repeat": True})
        reason = f"STOP by {command.issuer}"
        latch = Latch(f"link-{uuid.uuid4().hex[:12]}", ThrowState.STOPPED, reason)
        if not self._intake.latch(latch):
            return None
        self._news.append(latch)
        state = self._state
        self._stop_reply = CommandReply(
            command_id=command.command_id,
            machine_id=self._settings.machine_id,
            accepted=True,
            state=ThrowState.STOPPED,
            epoch_count=0 if state is None else state.epoch_count,
            detail="The control process does not answer; it is started again and comes back stopped.",
            latch_id=latch.latch_id,
        )
        return self._stop_reply

    # From the server, on Zenoh's threads ------------------------------------------------------------

    def command(self, payload: bytes, slot: ReplySlot) -> None:
        """A command."""
        self._inbox.take(payload, slot)

    def stop(self, payload: bytes) -> None:
        """A repeated STOP: nobody waits for an answer."""
        try:
            command = COMMANDS.validate_json(payload)
        except ValidationError as error:
            logger.warning("a STOP cannot be read: %s", error)
            return
        if isinstance(command, StopRequest):
            self._inbox.take_repeated_stop(command)

    def heartbeat(self, payload: bytes) -> None:
        """An operator's heartbeat."""
        port = self._port
        if port is not None:
            try:
                port.send(Kind.HEARTBEAT, payload)
            except (PeerGoneError, ValueError) as error:
                logger.debug("a heartbeat was lost: %s", error)


def _is_new_machine(settings: MachineSettings) -> bool:
    """Whether nothing was ever stored for this machine: only then does a missing record mean no latch."""
    known = (settings.database_file, settings.latch_file, settings.throws_dir)
    return not any(path.exists() for path in known)


def main(argument: str, alive_argument: str) -> int:
    """Entry of the process; the arguments are the descriptors of the supervisor's socket and counter."""
    logging.basicConfig(level=logging.INFO, format="link: %(levelname)s %(message)s")
    supervisor = SupervisorConnection.from_argument(argument)
    try:
        settings = MachineSettings.model_validate(supervisor.settings())
        with ExitStack() as stack:
            process = LinkProcess(settings, supervisor, AliveCounter(int(alive_argument)), stack)
            supervisor.tell(is_ready=True)
            process.run()
    except EOFError:
        return 0
    except (DownrangeError, OSError) as error:
        supervisor.tell(error=str(error))
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
