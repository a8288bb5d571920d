"""Hands the outbox's events to the server, batch by batch, and deletes what the server has committed."""

import logging
import threading
from collections.abc import Callable
from typing import Final

from pydantic import ValidationError

from machine.messages import EventAck
from runtime.records.outbox import Outbox, OutboxError

logger = logging.getLogger(__name__)

RETRY_S: Final = 0.5
"""Between attempts while nobody answers; an attempt without a link costs microseconds."""


class EventSender:
    """A thread with one question: does the server have everything?"""

    def __init__(self, outbox: Outbox, ask: Callable[[bytes], bytes | None]) -> None:
        self._outbox = outbox
        self._ask = ask
        self._news = threading.Event()
        self._is_closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="event-sender", daemon=True)

    def start(self) -> None:
        """Begin, with what an earlier start left over."""
        self._thread.start()

    def wake(self) -> None:
        """An event was added."""
        self._news.set()

    def close(self, timeout_s: float = 4.0) -> None:
        """Stop; unacknowledged events stay in the outbox."""
        self._is_closing.set()
        self._news.set()
        self._thread.join(timeout_s)

    def _run(self) -> None:
        while not self._is_closing.is_set():
            self._news.clear()
            try:
                is_progress = self.hand_over()
            except OutboxError as error:
                logger.error("%s", error)
                is_progress = False
            if is_progress is None:
                self._news.wait()
            elif not is_progress:
                self._is_closing.wait(RETRY_S)

    def hand_over(self) -> bool | None:
        """Hand over the oldest batch: whether some of it was committed; None when there is none."""
        batch = self._outbox.batch()
        if batch is None:
            return None
        answer = self._ask(batch.model_dump_json().encode())
        if answer is None:
            return False
        try:
            ack = EventAck.model_validate_json(answer)
        except ValidationError as error:
            logger.warning("the server's acknowledgement cannot be read: %s", error)
            return False
        return self._outbox.acknowledge(batch, ack.boot_id, ack.sequence_count) > 0
