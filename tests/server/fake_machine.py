"""A machine that speaks the real protocol over a real Zenoh session, and fails on demand.

It stands in for `downrange machine` where a test needs to decide what the machine does: it keeps epochs,
nonces and idempotent throw ids as a machine must, "throws" in a few hundredths of a second, and can be made
to lose replies, to refuse, to fall silent or to keep its events.
"""

import json
import threading
import time
import uuid
from contextlib import suppress

import zenoh
from pydantic import TypeAdapter

from machine.channels import machine_key
from machine.messages import (
    PROTOCOL_VERSION,
    Command,
    CommandReply,
    EventAck,
    EventBatch,
    EventKind,
    MachineEvent,
    MachineState,
    OperatorHeartbeat,
    RejectReason,
    ThrowState,
)
from machine.spec import load_spec
from machine.starts import safe_pose
from runtime.link.zenoh_config import client_config

COMMANDS = TypeAdapter(Command)
NONCE_S = 60.0
DEADMAN_S = 2.0
"""The machine's own is 0.3 s (tests/runtime): here a busy computer must not let go for the test."""


class FakeMachine:
    """One machine; use as a context manager."""

    def __init__(
        self,
        endpoint: str,
        machine_id: str,
        password: str,
        policies: dict[str, str],
        site: str = "yard",
    ) -> None:
        self.machine_id, self._site = machine_id, site
        self._endpoint, self._password, self._policies = endpoint, password, policies
        self.boot_id = uuid.uuid4().hex
        self.state = ThrowState.DISARMED
        self.epoch_count = 0
        self.nonce: str | None = None
        self.nonce_until_s = 0.0
        self.plan_hash: str | None = None
        self.plan_id: str | None = None
        self.throw_id: str | None = None
        self.executed: list[str] = []
        self.commands: list[Command] = []
        self.heartbeats: list[tuple[float, OperatorHeartbeat]] = []
        self.stops_received = 0
        self.stop_latched = False
        self.latch_id = ""
        self.zones_sha256: str | None = ""
        self.calibration_sha256: str | None = "c" * 64
        self.payload_held = True
        self.joints = tuple(float(v) for v in safe_pose())
        self.impact_error_m = (0.12, -0.05)
        self.target_m = (9.0, 0.0, 0.0)
        # What goes wrong on demand.
        self.drops_replies_of: set[str] = set()
        self.ignores: set[str] = set()
        self.refuses: dict[str, RejectReason] = {}
        self.keeps_events = False
        self.publishes_state = True
        self.needs_hold = True
        self.swing_s = 0.1
        self._lock = threading.RLock()
        self._outbox: list[MachineEvent] = []
        self._sequence = 0
        self._replies: dict[str, CommandReply] = {}
        self._stops: set[str] = set()
        self._closing = threading.Event()
        self._threads: list[threading.Thread] = []
        self._open_queries: list[zenoh.Query] = []

    def __enter__(self) -> "FakeMachine":
        self.session = zenoh.open(
            client_config(connect=(self._endpoint,), user=self.machine_id, password=self._password)
        )
        self._declared = [
            self.session.declare_queryable(self._key("command"), self._take_command),
            self.session.declare_subscriber(self._key("stop"), self._take_stop),
            self.session.declare_subscriber(self._key("heartbeat"), self._take_heartbeat),
        ]
        # Declared as the real machine does it: such a publisher sends only where it knows of a subscriber.
        self._state_publisher = self.session.declare_publisher(self._key("state"))
        self._token = self.session.liveliness().declare_token(self._key("alive"))
        self.event(EventKind.BOOTED)
        for target in (self._publish, self._deliver):
            thread = threading.Thread(target=target, daemon=True)
            thread.start()
            self._threads.append(thread)
        return self

    def __exit__(self, *_: object) -> None:
        self._closing.set()
        for thread in self._threads:
            thread.join(timeout=20.0)
        self._open_queries.clear()
        self.session.close()

    def _key(self, name: str) -> str:
        return machine_key(self._site, self.machine_id, name)

    # Out ----------------------------------------------------------------------------------------

    def state_message(self) -> MachineState:
        with self._lock:
            return MachineState(
                machine_id=self.machine_id,
                boot_id=self.boot_id,
                t_mono_ns=time.monotonic_ns(),
                state=self.state,
                epoch_count=self.epoch_count,
                plan_id=self.plan_id,
                throw_id=self.throw_id,
                joint_position_rad_m=self.joints,
                payload_held=self.payload_held,
                stop_latched=self.stop_latched,
                latch_id=self.latch_id,
                zones_sha256=self.zones_sha256,
                calibration_sha256=self.calibration_sha256,
                model_sha256=load_spec().sha256,
                policy_sha256=self._policies,
                outbox_count=len(self._outbox),
                software="fake",
                protocol_version=PROTOCOL_VERSION,
            )

    def _publish(self) -> None:
        while not self._closing.wait(0.05):
            if self.publishes_state:
                self._state_publisher.put(self.state_message().model_dump_json())

    def event(self, kind: EventKind, **data: object) -> MachineEvent:
        with self._lock:
            self._sequence += 1
            event = MachineEvent(
                machine_id=self.machine_id,
                boot_id=self.boot_id,
                sequence_count=self._sequence,
                t_mono_ns=time.monotonic_ns(),
                t_utc="2026-11-21T12:00:00+00:00",
                kind=kind,
                throw_id=self.throw_id,
                plan_id=self.plan_id,
                data=dict(data),
            )
            self._outbox.append(event)
            return event

    def deliver(self, events: list[MachineEvent]) -> EventAck | None:
        """Send a batch once, whatever is in the outbox."""
        batch = EventBatch(machine_id=self.machine_id, boot_id=self.boot_id, events=tuple(events))
        for reply in self.session.get(
            self._key("events"), payload=batch.model_dump_json(), timeout=20.0
        ):
            if reply.ok is not None:
                return EventAck.model_validate_json(reply.ok.payload.to_bytes())
        return None

    def _deliver(self) -> None:
        while not self._closing.wait(0.02):
            with self._lock:
                waiting = [] if self.keeps_events else list(self._outbox[:50])
            if not waiting:
                continue
            with suppress(zenoh.ZError):
                ack = self.deliver(waiting)
                if ack is not None:
                    with self._lock:
                        self._outbox = [
                            e for e in self._outbox if e.sequence_count > ack.sequence_count
                        ]

    # In -----------------------------------------------------------------------------------------

    def _take_command(self, query: zenoh.Query) -> None:
        command = COMMANDS.validate_python(
            json.loads(query.payload.to_bytes() if query.payload else b"{}")
        )
        with self._lock:
            self.commands.append(command)
            if command.kind in self.ignores:
                self._open_queries.append(query)  # a query that is never answered
                return
            repeat = self._replies.get(command.command_id)
            if repeat is not None:
                reply = repeat.model_copy(update={"is_repeat": True})
            else:
                reply = self._act(command)
                self._replies[command.command_id] = reply
            if command.kind in self.drops_replies_of:
                self._open_queries.append(query)
                return
        with query:
            query.reply(query.key_expr, reply.model_dump_json())

    def _reply(self, command: Command, reason: RejectReason | None = None, **extra: object):
        return CommandReply(
            command_id=command.command_id,
            machine_id=self.machine_id,
            accepted=reason is None,
            state=self.state,
            epoch_count=self.epoch_count,
            reason=reason,
            detail="" if reason is None else f"Refused: {reason.value}.",
            **extra,
        )

    def _act(self, command: Command) -> CommandReply:
        if command.kind in self.refuses:
            return self._reply(command, self.refuses[command.kind])
        if command.kind == "stop":
            self._stop(command.command_id)
            return self._reply(command)
        if command.kind == "zones":
            self.zones_sha256 = command.zone_set.sha256
            self._disarm()
            return self._reply(command)
        if command.epoch_count < self.epoch_count:
            return self._reply(command, RejectReason.STALE_EPOCH)
        if command.epoch_count > self.epoch_count:
            self.epoch_count = command.epoch_count
            self._disarm()
        if command.kind == "stop_clear":
            if command.latch_id != self.latch_id:
                return self._reply(command, RejectReason.STOP_LATCHED)
            self.stop_latched, self.state, self.latch_id = False, ThrowState.DISARMED, ""
            self.event(EventKind.STOP_CLEARED)
        elif command.kind == "arm":
            if self.stop_latched:
                return self._reply(command, RejectReason.STOP_LATCHED)
            if self.state is not ThrowState.DISARMED:
                return self._reply(command, RejectReason.NOT_DISARMED)
            if (command.plan.zones_sha256 or "") != self.zones_sha256:
                return self._reply(command, RejectReason.ZONES_MISMATCH)
            self.nonce, self.nonce_until_s = uuid.uuid4().hex, time.monotonic() + NONCE_S
            self.plan_hash, self.plan_id = command.plan.plan_hash, command.plan.plan_id
            target = command.plan.target
            self.target_m = (target.x_m, target.y_m, target.z_m)
            self.state = ThrowState.ARMED
            self.event(EventKind.ARMED)
            return self._reply(command, nonce=self.nonce, nonce_valid_s=NONCE_S)
        elif command.kind == "fire":
            return self._fire(command)
        elif command.kind == "load":
            self.payload_held = True
        elif command.kind in ("disarm", "abort"):
            self._disarm()
        return self._reply(command)

    def _fire(self, command: Command) -> CommandReply:
        if command.throw_id in self.executed:
            return self._reply(command, is_repeat=True, throw_id=command.throw_id)
        if self.state is not ThrowState.ARMED:
            return self._reply(command, RejectReason.NOT_ARMED)
        if command.nonce != self.nonce:
            return self._reply(command, RejectReason.NONCE_UNKNOWN)
        if time.monotonic() > self.nonce_until_s:
            return self._reply(command, RejectReason.NONCE_EXPIRED)
        if command.plan_hash != self.plan_hash:
            return self._reply(command, RejectReason.PLAN_MISMATCH)
        self.nonce = None
        self.throw_id = command.throw_id
        self.executed.append(command.throw_id)
        self.state = ThrowState.THROWING
        self.event(EventKind.THROW_ACCEPTED)
        thread = threading.Thread(target=self._throw, daemon=True)
        thread.start()
        self._threads.append(thread)
        return self._reply(command, throw_id=command.throw_id)

    def _held(self, since_s: float) -> bool:
        with self._lock:
            last = self.heartbeats[-1] if self.heartbeats else None
        if last is None or last[1].throw_id != self.throw_id:
            return time.monotonic() - since_s < DEADMAN_S
        return last[1].is_holding and time.monotonic() - last[0] < DEADMAN_S

    def _throw(self) -> None:
        began_s = time.monotonic()
        self.event(EventKind.THROW_STARTED)
        while time.monotonic() - began_s < self.swing_s or not self.heartbeats:
            if self.needs_hold and not self._held(began_s):
                self._end("aborted")
                return
            if not self.needs_hold and time.monotonic() - began_s >= self.swing_s:
                break
            time.sleep(0.01)
        with self._lock:
            self.state = ThrowState.COMMITTED
        self.event(EventKind.RELEASE_COMMANDED)
        time.sleep(0.05)
        with self._lock:
            self.payload_held = False
            x, y, z = self.target_m
            range_m = (x * x + y * y) ** 0.5
            along, left = self.impact_error_m
            cos, sin = x / range_m, y / range_m
            impact = (x + cos * along - sin * left, y + sin * along + cos * left, z)
        self.event(EventKind.IMPACT, position_m=impact, sd_m=0.02, source="survey")
        self._end("landed", release_speed_m_per_s=8.1, throw_duration_s=2.5)

    def _end(self, outcome: str, **data: object) -> None:
        self.event(EventKind.THROW_ENDED, outcome=outcome, **data)
        with self._lock:
            if not self.stop_latched:
                self.state = ThrowState.DISARMED
            self.throw_id = self.plan_id = None

    def _disarm(self) -> None:
        self.nonce = None
        if self.state is ThrowState.ARMED:
            self.state = ThrowState.DISARMED
            self.event(EventKind.DISARMED)

    def _stop(self, command_id: str) -> None:
        # Each STOP makes a latch of its own, once, also where the machine is stopped already.
        if command_id not in self._stops:
            self._stops.add(command_id)
            self._latch()

    def _latch(self) -> None:
        self.stop_latched, self.state, self.nonce = True, ThrowState.STOPPED, None
        self.latch_id = uuid.uuid4().hex
        self.event(EventKind.STOP_LATCHED)

    def _take_stop(self, sample: zenoh.Sample) -> None:
        with self._lock:
            self.stops_received += 1
            if "stop_put" not in self.ignores:
                self._stop(json.loads(sample.payload.to_bytes())["command_id"])

    def _take_heartbeat(self, sample: zenoh.Sample) -> None:
        heartbeat = OperatorHeartbeat.model_validate_json(sample.payload.to_bytes())
        with self._lock:
            self.heartbeats.append((time.monotonic(), heartbeat))
