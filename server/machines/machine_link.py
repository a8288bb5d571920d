"""The Zenoh link to the machines: commands out, states, joints and events in.

A command is sent once and waits for exactly one answer (`COMMAND_TIMEOUT_S`); nothing is repeated or
stored. Zenoh keeps the newest state of each machine for a thread that fetches and parses them, so that a slow
server sees fewer states, not older ones. Its callbacks only queue what arrives.
"""

import logging
import queue
import threading
import time
from collections import Counter
from collections.abc import Callable
from typing import Any

import zenoh
from pydantic import BaseModel

from machine.channels import KEY_ROOT, KEYS, machine_key
from machine.messages import (
    Command,
    CommandReply,
    EventAck,
    EventBatch,
    OperatorHeartbeat,
    StopRequest,
    command_json,
)
from server.machines.incoming import (
    IncomingError,
    check_size,
    read_batch,
    read_joints,
    read_reply,
    read_state,
)
from server.machines.machine_registry import MachineRegistry
from server.metrics import ServiceMetrics

logger = logging.getLogger(__name__)

COMMAND_TIMEOUT_S = 2.0
"""A machine stores an event before it answers, and its disk may be slow. It executes no command that is older
than `runtime.throw.freshness.COMMAND_AGE_MAX_NS`; a late answer only says what it has done already."""
STOP_TIMEOUT_S = 0.5
"""STOP is repeated instead."""
EVENT_QUEUE_LENGTH = 256
"""Batches waiting for the database; a machine repeats what was not acknowledged."""
MACHINE_BATCH_COUNT = 8
"""Batches of one machine that may wait, so that it leaves room for the others. One is usual."""
WARNING_PERIOD_S = 10.0
"""Shortest time between two log lines about refused messages of one machine."""
RENEWAL_WAIT_S = 2.0
"""Machines are back on a router that was opened anew after 0.3 s (benchmarks/router_renewal.py)."""
FETCH_PERIOD_S = 0.02
"""Between two looks for new states and joints: one thread for all machines. Calling Python for every message
would take more of a core with 100 machines than reading them does (benchmarks/fleet_scale.py)."""
SWEEP_PERIOD_S = 0.1
SETTLED_S = 1.0
"""The link is at rest when no command was sent for so long: the states show what the last one did."""


class MachineLostError(Exception):
    """The machine is not there: nothing was sent."""


class NoAnswerError(Exception):
    """Sent, but not exactly one usable answer came back: what the machine did is not known."""


class MachineLink:
    """One Zenoh session for all machines of the site."""

    def __init__(
        self,
        site: str,
        registry: MachineRegistry,
        take_events: Callable[[EventBatch], EventAck],
        metrics: ServiceMetrics,
    ) -> None:
        self._site = site
        self._registry = registry
        self._take_events = take_events
        self._metrics = metrics
        self._session: zenoh.Session | None = None
        self._declared: list[Any] = []
        self._threads: list[threading.Thread] = []
        self._is_closing = threading.Event()
        self._news = threading.Condition()
        self._newest: list[tuple[str, str, Any]] = []
        """Machine, channel and the subscriber that keeps its newest message."""
        self._tokens: dict[str, bool] = {}
        self._tokens_seen: set[str] = set()
        """Machines that have called in since the session began."""
        self._waiting: Counter[str] = Counter()
        self._warned_s: dict[str, float] = {}
        self._batches: queue.Queue[zenoh.Query | None] = queue.Queue(EVENT_QUEUE_LENGTH)
        self._gate = threading.Condition()
        """Commands and a renewal of the router exclude each other."""
        self._sending_count = 0
        self._is_renewing = False
        self._sent_s = -1e9
        self.renewals_count = 0
        """How often the router was opened anew."""

    # Life -----------------------------------------------------------------------------------------

    def open(self, config: zenoh.Config) -> None:
        """Open the session and start listening."""
        self._begin_session(config)
        for target, name in ((self._run_news, "link-news"), (self._run_events, "link-events")):
            thread = threading.Thread(target=target, name=name, daemon=True)
            thread.start()
            self._threads.append(thread)

    def _begin_session(self, config: zenoh.Config) -> None:
        session = self._session = zenoh.open(config)
        for known in self._registry.all():
            self._listen_to(session, known.machine_id)
        every_token = f"{KEY_ROOT}/{self._site}/m/*/{KEYS['alive'].suffix}"
        self._declared.append(
            session.liveliness().declare_subscriber(every_token, self._note_token, history=True)
        )

    def _listen_to(self, session: zenoh.Session, machine_id: str) -> None:
        """One declaration a machine and channel.

        A machine's access rule covers its own keys only: a wildcard subscription over all machines is
        not announced to it, and publishers send nothing without a subscriber.
        """
        for name in ("state", "joints"):
            key = machine_key(self._site, machine_id, name)
            subscriber = session.declare_subscriber(key, zenoh.handlers.RingChannel(1))
            self._declared.append(subscriber)
            self._newest.append((machine_id, name, subscriber))
        key = machine_key(self._site, machine_id, "events")
        self._declared.append(session.declare_queryable(key, self._note_batch))

    def renew(self, config: zenoh.Config) -> bool:
        """Open the router anew with other accounts; whether the moment was quiet enough to do it.

        Machines reconnect by themselves within `RENEWAL_WAIT_S`; commands wait until they have. The caller
        makes sure that no machine is armed or throws.

        Raises:
            zenoh.ZError: the port could not be opened; call again.
        """
        with self._gate:
            is_at_rest = time.monotonic() - self._sent_s > SETTLED_S and not self._sending_count
            if not is_at_rest or self._is_closing.is_set():
                return False
            self._is_renewing = True
        try:
            awaited = {known.machine_id for known in self._registry.all() if known.is_connected}
            self._end_session()
            with self._news:
                self._tokens_seen.clear()
            self._begin_session(config)
            with self._news:
                self._news.wait_for(lambda: self._tokens_seen >= awaited, RENEWAL_WAIT_S)
            self.renewals_count += 1
        finally:
            with self._gate:
                self._is_renewing = False
                self._gate.notify_all()
        return True

    def close(self) -> None:
        """Stop listening and close the session; never hangs on a machine that is gone."""
        self._is_closing.set()
        with self._news:
            self._news.notify_all()
        self._batches.put(None)
        for thread in self._threads:
            thread.join(timeout=5.0)
        self._end_session()

    def _end_session(self) -> None:
        # Undeclared first: the end of the session must not read as the loss of every machine.
        for declared in self._declared:
            declared.undeclare()
        self._declared, self._newest = [], []
        if self._session is not None:
            session, self._session = self._session, None
            # Closing may wait for peers that no longer answer; the process must not.
            closer = threading.Thread(target=session.close, daemon=True)
            closer.start()
            closer.join(timeout=3.0)

    @property
    def is_open(self) -> bool:
        """Whether machines can call in."""
        session = self._session
        return self._is_renewing or (session is not None and not session.is_closed())

    @staticmethod
    def _machine_of(key: str) -> str:
        return key.split("/")[-2]

    # Out ------------------------------------------------------------------------------------------

    def send(self, command: Command) -> CommandReply:
        """Send one command and wait for its answer; from any thread but Zenoh's.

        Raises:
            MachineLostError: the machine is not connected; nothing was sent.
            NoAnswerError: no, more than one, or an unreadable answer.
        """
        with self._gate:
            self._gate.wait_for(lambda: not self._is_renewing, RENEWAL_WAIT_S)
            self._sending_count += 1
        try:
            return self._send(command)
        finally:
            with self._gate:
                self._sending_count -= 1
                self._sent_s = time.monotonic()

    def _send(self, command: Command) -> CommandReply:
        session = self._session
        if session is None or not self._registry.is_connected(command.machine_id):
            raise MachineLostError
        began_s = time.monotonic()
        timeout_s = STOP_TIMEOUT_S if isinstance(command, StopRequest) else COMMAND_TIMEOUT_S
        replies = list(
            session.get(
                machine_key(self._site, command.machine_id, "command"),
                payload=command_json(command, self._protocol_version(command.machine_id)),
                target=zenoh.QueryTarget.ALL,
                consolidation=zenoh.ConsolidationMode.NONE,
                timeout=timeout_s,
                congestion_control=zenoh.CongestionControl.BLOCK,
                priority=zenoh.Priority.REAL_TIME,
                express=True,
            )
        )
        seconds = time.monotonic() - began_s
        reply = self._only_reply(command, replies, timeout_s)
        self._registry.note_round_trip(command.machine_id, seconds)
        self._metrics.command_round_trip_s.labels(kind=command.kind).observe(seconds)
        return reply

    def _protocol_version(self, machine_id: str) -> int:
        """Of the machine as it last said; an older one refuses fields that it does not know."""
        state = self._registry.get(machine_id).state
        return 1 if state is None else state.protocol_version

    def _only_reply(
        self, command: Command, replies: list[zenoh.Reply], timeout_s: float
    ) -> CommandReply:
        answers = [reply.ok for reply in replies if reply.ok is not None]
        if len(answers) != 1:
            raise NoAnswerError(
                f"{len(answers)} answers within {timeout_s} s"
                + ("; two machines use one name" if len(answers) > 1 else "")
            )
        try:
            check_size("command", len(answers[0].payload))
            reply = read_reply(answers[0].payload.to_bytes())
        except IncomingError as error:
            raise NoAnswerError(f"the answer cannot be read ({error})") from error
        if (reply.command_id, reply.machine_id) != (command.command_id, command.machine_id):
            raise NoAnswerError(f"the answer belongs to command {reply.command_id}")
        return reply

    def put_stop(self, request: StopRequest) -> None:
        """Send STOP once, without waiting; the caller repeats it."""
        self._put("stop", request.machine_id, request, zenoh.CongestionControl.BLOCK)

    def put_heartbeat(self, heartbeat: OperatorHeartbeat) -> None:
        """Pass on that the operator holds, or not; dropped rather than delayed."""
        self._put("heartbeat", heartbeat.machine_id, heartbeat, zenoh.CongestionControl.DROP)

    def _put(
        self, name: str, machine_id: str, message: BaseModel, congestion: zenoh.CongestionControl
    ) -> None:
        session = self._session
        if session is None:
            return
        try:
            session.put(
                machine_key(self._site, machine_id, name),
                message.model_dump_json(),
                congestion_control=congestion,
                priority=zenoh.Priority.REAL_TIME,
                express=True,
            )
        except zenoh.ZError:
            # A STOP is repeated, and nobody holds while the router is opened anew.
            if self._session is session:
                raise

    # In: callbacks only queue ------------------------------------------------------------------

    def _note_token(self, sample: zenoh.Sample) -> None:
        machine_id = self._machine_of(str(sample.key_expr))
        with self._news:
            self._tokens[machine_id] = sample.kind == zenoh.SampleKind.PUT
            if self._tokens[machine_id]:
                self._tokens_seen.add(machine_id)
            self._news.notify_all()

    def _note_batch(self, query: zenoh.Query) -> None:
        machine_id = self._machine_of(str(query.key_expr))
        with self._news:
            is_room = self._waiting[machine_id] < MACHINE_BATCH_COUNT
            self._waiting[machine_id] += is_room
        try:
            if not is_room:
                raise queue.Full
            self._batches.put_nowait(query)
        except queue.Full:
            self._metrics.event_batches_refused_count.inc()
            if is_room:
                self._end_wait(machine_id)

    def _end_wait(self, machine_id: str) -> None:
        with self._news:
            self._waiting[machine_id] -= 1

    def _refuse(self, machine_id: str, error: IncomingError) -> None:
        """Count a refused message; the log says so now and then only."""
        self._metrics.unreadable_count.inc()
        now_s = time.monotonic()
        with self._news:
            is_quiet = now_s - self._warned_s.get(machine_id, -1e9) < WARNING_PERIOD_S
            if not is_quiet:
                self._warned_s[machine_id] = now_s
        if not is_quiet:
            logger.warning("refused of %s: %s", machine_id, error)

    # In: threads work --------------------------------------------------------------------------------

    def _run_news(self) -> None:
        swept_s = 0.0
        while not self._is_closing.is_set():
            with self._news:
                self._news.wait_for(
                    lambda: bool(self._tokens) or self._is_closing.is_set(), FETCH_PERIOD_S
                )
                tokens, self._tokens = self._tokens, {}
            for machine_id, is_alive in tokens.items():
                _guarded(lambda m=machine_id, a=is_alive: self._registry.set_token(m, a))
            _guarded(self._fetch)
            if time.monotonic() - swept_s >= SWEEP_PERIOD_S:
                swept_s = time.monotonic()
                _guarded(self._registry.sweep)

    def _fetch(self) -> None:
        """Take the newest message of every machine and channel that has a new one."""
        for machine_id, name, subscriber in self._newest:
            sample = subscriber.try_recv()
            if sample is not None:
                payload = sample.payload.to_bytes()
                _guarded(lambda m=machine_id, n=name, p=payload: self._take(m, n, p))

    def _take(self, machine_id: str, name: str, payload: bytes) -> None:
        try:
            if name == "state":
                self._registry.take_state(read_state(payload, machine_id))
            else:
                self._registry.take_joints(read_joints(payload, machine_id))
        except IncomingError as error:
            self._refuse(machine_id, error)

    def _run_events(self) -> None:
        while (query := self._batches.get()) is not None:
            _guarded(lambda q=query: self._answer_batch(q))
            # A query is answered finally only when it is dropped.
            del query

    def _answer_batch(self, query: zenoh.Query) -> None:
        machine_id = self._machine_of(str(query.key_expr))
        self._end_wait(machine_id)
        with query:
            try:
                check_size("events", 0 if query.payload is None else len(query.payload))
                batch = read_batch(
                    b"" if query.payload is None else query.payload.to_bytes(), machine_id
                )
            except IncomingError as error:
                self._refuse(machine_id, error)
                query.reply_err(f"the batch is refused: {error}")
                return
            ack = self._take_events(batch)
            query.reply(query.key_expr, ack.model_dump_json())


def _guarded(job: Callable[[], None]) -> None:
    # An error in one message or listener must not end the thread that serves all machines.
    try:
        job()
    except Exception:
        logger.exception("a message from a machine could not be worked on")
