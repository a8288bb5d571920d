"""Events go to the server in order, and leave the outbox only when it has committed them."""

import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from machine.messages import EventAck, EventBatch, EventKind
from runtime.records.event_sender import EventSender
from runtime.records.outbox import BATCH_LIMIT_COUNT, EventDraft, Outbox
from tests.cases import each


@pytest.fixture
def outbox(tmp_path: Path) -> Iterator[Outbox]:
    outbox = Outbox(tmp_path / "m.db", "m001")
    yield outbox
    outbox.close()


def add(outbox: Outbox, count: int, boot: str = "a") -> None:
    for n in range(count):
        outbox.add(boot, EventDraft(EventKind.IMPACT, n, "t", None, {}, "now"))


class FakeServer:
    """Commits batches; loses as many answers as a test asks for."""

    def __init__(self) -> None:
        self.rows: dict[tuple[str, int], int] = {}
        self.asked = 0
        self.lost: set[int] = set()
        self.is_done = threading.Event()
        self.wanted = 10**6

    def ask(self, payload: bytes) -> bytes | None:
        self.asked += 1
        batch = EventBatch.model_validate_json(payload)
        for event in batch.events:
            self.rows.setdefault((event.boot_id, event.sequence_count), event.t_mono_ns)
        if len(self.rows) >= self.wanted:
            self.is_done.set()
        if self.asked in self.lost:
            return None
        last = batch.events[-1].sequence_count
        return EventAck(boot_id=batch.boot_id, sequence_count=last).model_dump_json().encode()


def test_batches_are_bounded_and_boots_stay_apart(outbox):
    add(outbox, BATCH_LIMIT_COUNT + 5)
    add(outbox, 3, boot="b")
    server = FakeServer()
    sender = EventSender(outbox, server.ask)
    assert [sender.hand_over() for _ in range(4)] == [True, True, True, None]
    assert server.asked == 3
    assert list(server.rows) == [("a", n) for n in range(1, BATCH_LIMIT_COUNT + 6)] + [
        ("b", n) for n in (1, 2, 3)
    ]


def test_lost_acknowledgement_means_once_more_and_nothing_twice(outbox):
    add(outbox, 3)
    server = FakeServer()
    server.lost = {1}
    sender = EventSender(outbox, server.ask)
    assert sender.hand_over() is False
    assert outbox.count() == 3
    assert sender.hand_over() is True
    assert outbox.count() == 0
    assert len(server.rows) == 3


@each("answer", [None, b"", b"{}", b'{"boot_id": "x", "sequence_count": 9}'])
def test_unusable_answers_delete_nothing(outbox, answer):
    add(outbox, 2)
    before = outbox.count()
    assert EventSender(outbox, lambda _: answer).hand_over() is False
    assert outbox.count() == before


def test_thread_hands_over_what_was_left_and_what_comes(outbox):
    add(outbox, 2)
    server = FakeServer()
    server.wanted = 5
    sender = EventSender(outbox, server.ask)
    sender.start()
    add(outbox, 3)
    sender.wake()
    assert server.is_done.wait(10.0)
    sender.close()
    assert outbox.count() == 0
