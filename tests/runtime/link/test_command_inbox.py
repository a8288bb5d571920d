"""Commands are written down before they are passed on, and refused only when they certainly were not."""

import queue
from collections.abc import Iterator
from pathlib import Path

import pytest

from machine.messages import (
    CommandReply,
    EventKind,
    FireRequest,
    LeaseNotice,
    StopRequest,
    ThrowState,
)
from runtime.link.command_inbox import CommandInbox
from runtime.link.ipc import Kind
from runtime.records.journal import Journal
from runtime.records.outbox import EventDraft, Outbox, OutboxError
from tests.cases import each
from tests.runtime.machine_bench import make


class Slot:
    def __init__(self) -> None:
        self.answers: queue.Queue[bytes | None] = queue.Queue()

    def answer(self, payload: bytes) -> None:
        self.answers.put(payload)

    def give_up(self) -> None:
        self.answers.put(None)

    def reply(self) -> CommandReply | None:
        payload = self.answers.get(timeout=10.0)
        return None if payload is None else CommandReply.model_validate_json(payload)


class Control:
    """The other end: notes what is sent, and what was on the disk at that moment."""

    def __init__(self, journal: Journal) -> None:
        self.is_running = True
        self.sent: queue.Queue[tuple[int, dict, tuple[str, ...]]] = queue.Queue()
        self._journal = journal

    def send(self, kind: Kind, body: dict) -> bool:
        assert kind is Kind.COMMAND
        if self.is_running:
            self.sent.put((body["request"], body["command"], self._journal.memory().throw_ids))
        return self.is_running


class InboxBench:
    def __init__(self, folder: Path) -> None:
        self.outbox = Outbox(folder / "m.db", "m001")
        self.journal = Journal(self.outbox)
        self.control = Control(self.journal)
        self.inbox = CommandInbox("m001", self.journal, self.control.send, self.stop_alone)

    def stop_alone(self, command: StopRequest) -> CommandReply | None:
        if self.control.is_running:
            return None
        reply = {"command_id": command.command_id, "machine_id": "m001", "accepted": True}
        return CommandReply(**reply, state=ThrowState.STOPPED, epoch_count=4, latch_id="link-1")

    def take(self, command) -> Slot:
        slot = Slot()
        self.inbox.take(command.model_dump_json().encode(), slot)
        return slot

    def next_sent(self) -> tuple[int, dict, tuple[str, ...]]:
        return self.control.sent.get(timeout=10.0)

    def answer(self, request: int, command: dict, *, accepted: bool, epoch: int = 4) -> None:
        reply = CommandReply(
            command_id=command["command_id"],
            machine_id="m001",
            accepted=accepted,
            state=ThrowState.DISARMED,
            epoch_count=epoch,
        )
        self.inbox.take_reply(request, reply)


@pytest.fixture
def inbox(tmp_path: Path) -> Iterator[InboxBench]:
    inbox = InboxBench(tmp_path)
    yield inbox
    inbox.inbox.close()
    inbox.outbox.close()


def fire(throw_id: str = "t1"):
    return make(FireRequest, epoch_count=4, throw_id=throw_id, nonce="n", plan_hash="h")


def test_fire_is_on_the_disk_before_it_is_passed_on(inbox):
    slot = inbox.take(fire())
    request, command, known = inbox.next_sent()
    assert known == ("t1",)
    inbox.answer(request, command, accepted=True)
    assert slot.reply().accepted
    assert inbox.journal.epoch_count() == 4


def test_refused_fire_is_taken_back(inbox):
    slot = inbox.take(fire())
    request, command, _ = inbox.next_sent()
    inbox.answer(request, command, accepted=False)
    assert not slot.reply().accepted
    assert inbox.journal.memory().throw_ids == ()


def test_repeat_may_not_take_back_what_the_first_wrote(inbox):
    command = fire()
    first = inbox.take(command)
    inbox.next_sent()
    # Control dies between the two; whether the first was executed, nobody knows.
    inbox.control.is_running = False
    assert not inbox.take(command).reply().accepted
    assert inbox.journal.memory().throw_ids == ("t1",)
    inbox.inbox.give_up()
    assert first.reply() is None


def test_command_that_was_not_passed_on_is_refused_and_forgotten(inbox):
    inbox.control.is_running = False
    reply = inbox.take(fire()).reply()
    assert (reply.accepted, reply.reason) == (False, "fault")
    assert "restarted by itself" in reply.detail
    assert inbox.journal.memory().throw_ids == ()


def test_stop_passes_commands_that_wait_for_the_disk(inbox):
    with inbox.outbox.transaction():
        inbox.take(fire())
        stop = inbox.take(make(StopRequest))
        request, command, _ = inbox.next_sent()
        assert command["kind"] == "stop"
    inbox.answer(request, command, accepted=True)
    assert stop.reply().accepted
    assert inbox.next_sent()[1]["kind"] == "fire"


def test_throw_that_cannot_be_written_down_does_not_happen(inbox, monkeypatch):
    def refuse(_: str) -> bool:
        raise OutboxError("the disk is full")

    monkeypatch.setattr(inbox.journal, "intend_throw", refuse)
    reply = inbox.take(fire()).reply()
    assert (reply.accepted, reply.detail) == (False, "the disk is full")
    assert inbox.control.sent.empty()
    # The inbox lives on.
    inbox.take(make(LeaseNotice, epoch_count=5))
    assert inbox.next_sent()[1]["kind"] == "lease"


@each(
    ("payload", "command_id"),
    [
        (b"", ""),
        (b"[]", ""),
        (b'{"command_id": 5}', ""),
        (b'{"command_id": "c1", "kind": "explode"}', "c1"),
        (fire().model_dump_json().replace('"nonce"', '"extra": 1, "nonce"').encode(), None),
    ],
)
def test_unreadable_commands_are_refused_by_name(inbox, payload, command_id):
    slot = Slot()
    inbox.inbox.take(payload, slot)
    reply = slot.reply()
    assert (reply.accepted, reply.reason) == (False, "malformed")
    assert command_id is None or reply.command_id == command_id
    assert inbox.control.sent.empty()


def test_accepted_epoch_is_durable_before_the_answer(inbox):
    slot = inbox.take(make(LeaseNotice, epoch_count=9))
    request, command, _ = inbox.next_sent()
    inbox.answer(request, command, accepted=True, epoch=9)
    assert slot.reply().accepted
    assert inbox.journal.memory().epoch_count == 9


def test_accepted_throw_survives_a_late_refusal_of_its_repeat(inbox):
    command = fire()
    slot = inbox.take(command)
    request, body, _ = inbox.next_sent()
    draft = EventDraft(EventKind.THROW_ACCEPTED, 1, "t1", "p", {}, "now")
    inbox.journal.record("boot", 1, draft)
    inbox.answer(request, body, accepted=True)
    assert slot.reply().accepted
    repeat = inbox.take(command)
    request, body, _ = inbox.next_sent()
    inbox.answer(request, body, accepted=False)
    assert not repeat.reply().accepted
    assert inbox.journal.memory().throw_ids == ("t1",)


def test_stop_is_answered_without_the_control_process(inbox):
    inbox.control.is_running = False
    reply = inbox.take(make(StopRequest)).reply()
    assert (reply.accepted, reply.state, reply.latch_id) == (True, ThrowState.STOPPED, "link-1")
    inbox.inbox.take_repeated_stop(make(StopRequest))


def test_stop_that_waited_for_a_control_process_that_died_is_answered(inbox):
    slot = inbox.take(make(StopRequest))
    inbox.next_sent()
    inbox.control.is_running = False
    inbox.inbox.give_up()
    assert slot.reply().latch_id == "link-1"
