"""The machine's end of the Zenoh link: token, state, joints, commands, stop, heartbeat, event batches.

It carries bytes and decides nothing. Callbacks run on Zenoh's threads and never wait for Zenoh; replies and
questions are sent from ours. Losing the link is normal: it comes back by itself, and puts meanwhile are lost.
"""

import logging
import threading
import time
from collections.abc import Callable
from typing import Any, Final, Protocol

import zenoh

from machine.channels import machine_key

logger = logging.getLogger(__name__)

REOPEN_WAIT_S: Final = 0.5
"""Between attempts to open the first session; each attempt itself takes up to a second."""
WARN_PERIOD_S: Final = 10.0
ASK_TIMEOUT_S: Final = 3.0
CLOSE_TIMEOUT_S: Final = 3.0
"""Zenoh may wait for a peer that no longer answers; we do not."""


class LinkListener(Protocol):
    """Receives what came in. Called on Zenoh's threads; must return at once."""

    def command(self, payload: bytes, slot: "ReplySlot") -> None:
        """A command; answer through the slot, from any thread but this one."""
        ...

    def stop(self, payload: bytes) -> None:
        """A repeated STOP."""
        ...

    def heartbeat(self, payload: bytes) -> None:
        """An operator's heartbeat."""
        ...


class ReplySlot:
    """Takes the one answer to one query; without an answer the asker sees an unknown outcome."""

    def __init__(self, query: zenoh.Query) -> None:
        self._query: zenoh.Query | None = query
        self._lock = threading.Lock()

    def answer(self, payload: bytes) -> None:
        """Send the answer; a second one, or one to an asker who has gone, does nothing."""
        with self._lock:
            query, self._query = self._query, None
        if query is None:
            return
        try:
            with query:
                query.reply(
                    query.key_expr,
                    payload,
                    encoding=zenoh.Encoding.APPLICATION_JSON,
                    congestion_control=zenoh.CongestionControl.BLOCK,
                    priority=zenoh.Priority.REAL_TIME,
                    express=True,
                )
        except zenoh.ZError as error:
            logger.info("an answer found nobody: %s", error)

    def give_up(self) -> None:
        """Leave the query without an answer."""
        with self._lock:
            query, self._query = self._query, None
        if query is not None:
            query.drop()


class ServerLink:
    """One Zenoh session of one machine."""

    def __init__(
        self,
        site: str,
        machine_id: str,
        make_config: Callable[[], zenoh.Config],
        listener: LinkListener,
    ) -> None:
        self._site = site
        self._machine_id = machine_id
        self._make_config = make_config
        self._listener = listener
        self._session: zenoh.Session | None = None
        self._declared: list[Any] = []
        self._publishers: dict[str, zenoh.Publisher] = {}
        self._is_closing = threading.Event()
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._run_open, name="link-open", daemon=True)

    def start(self) -> None:
        """Begin to open the session; returns at once, and goes on trying."""
        self._thread.start()

    def close(self) -> None:
        """Undeclare everything and close the session within a few seconds, whatever the peer does."""
        self._is_closing.set()
        self._thread.join(CLOSE_TIMEOUT_S)
        closer = threading.Thread(target=self._close_session, name="link-close", daemon=True)
        closer.start()
        closer.join(CLOSE_TIMEOUT_S)
        if closer.is_alive():
            logger.warning("Zenoh did not close within %g s; left behind", CLOSE_TIMEOUT_S)

    @property
    def is_connected(self) -> bool:
        """Whether there is a router at the other end just now."""
        session = self._session
        return session is not None and not session.is_closed() and bool(session.info.routers_zid())

    # Out ------------------------------------------------------------------------------------------

    def publish(self, name: str, payload: bytes) -> None:
        """Put on ``state`` or ``joints``: dropped rather than delayed."""
        publisher = self._publishers.get(name)
        if publisher is not None:
            publisher.put(payload, encoding=zenoh.Encoding.APPLICATION_JSON)

    def ask_events(self, payload: bytes) -> bytes | None:
        """Hand a batch to the server; its answer, or None when nobody answered in time.

        Blocks for up to `ASK_TIMEOUT_S`: never call it from a Zenoh callback.
        """
        session = self._session
        if session is None or session.is_closed():
            return None
        try:
            replies = list(
                session.get(
                    self._key("events"),
                    payload=payload,
                    encoding=zenoh.Encoding.APPLICATION_JSON,
                    target=zenoh.QueryTarget.ALL,
                    consolidation=zenoh.ConsolidationMode.NONE,
                    timeout=ASK_TIMEOUT_S,
                    congestion_control=zenoh.CongestionControl.BLOCK,
                    priority=zenoh.Priority.DATA,
                )
            )
        except zenoh.ZError as error:
            logger.info("events could not be handed over: %s", error)
            return None
        answers = [reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None]
        # Two answers mean two servers: neither may be taken as the commit of the other.
        return answers[0] if len(answers) == 1 else None

    # Session --------------------------------------------------------------------------------------

    def _key(self, name: str) -> str:
        return machine_key(self._site, self._machine_id, name)

    def _run_open(self) -> None:
        warned_s = -WARN_PERIOD_S
        while not self._is_closing.is_set():
            try:
                session = zenoh.open(self._make_config())
            except zenoh.ZError as error:
                if time.monotonic() - warned_s >= WARN_PERIOD_S:
                    warned_s = time.monotonic()
                    logger.warning(
                        "no session with the server: it is unreachable, or refuses the name or password"
                        " of %s (%s); trying on",
                        self._machine_id,
                        str(error).split(" at /", maxsplit=1)[0],
                    )
                self._is_closing.wait(REOPEN_WAIT_S)
                continue
            self._declare(session)
            logger.info("link of %s is open", self._machine_id)
            return

    def _declare(self, session: zenoh.Session) -> None:
        with self._lock:
            self._session = session
            drop, low = zenoh.CongestionControl.DROP, zenoh.Priority.DATA_LOW
            for name in ("state", "joints"):
                self._publishers[name] = session.declare_publisher(
                    self._key(name), congestion_control=drop, priority=low, express=True
                )
            self._declared = [
                *self._publishers.values(),
                session.declare_subscriber(self._key("stop"), self._take_stop),
                session.declare_subscriber(self._key("heartbeat"), self._take_heartbeat),
                session.declare_queryable(self._key("command"), self._take_command),
                # Last: who sees the token may send commands.
                session.liveliness().declare_token(self._key("alive")),
            ]

    def _close_session(self) -> None:
        with self._lock:
            session, self._session = self._session, None
            declared, self._declared = self._declared, []
            self._publishers = {}
        try:
            for item in reversed(declared):
                item.undeclare()
            if session is not None:
                session.close()
        except zenoh.ZError as error:
            logger.info("closing the link: %s", error)

    # In: on Zenoh's threads -------------------------------------------------------------------------

    def _take_command(self, query: zenoh.Query) -> None:
        payload = b"" if query.payload is None else query.payload.to_bytes()
        self._listener.command(payload, ReplySlot(query))

    def _take_stop(self, sample: zenoh.Sample) -> None:
        self._listener.stop(sample.payload.to_bytes())

    def _take_heartbeat(self, sample: zenoh.Sample) -> None:
        self._listener.heartbeat(sample.payload.to_bytes())
