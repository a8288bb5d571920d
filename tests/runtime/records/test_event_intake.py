"""Latches before events, events in order, nothing lost while the disk refuses."""

import sqlite3

import pytest

from machine.messages import EventKind, ThrowState
from runtime.records import event_intake
from runtime.records.event_intake import ControlEvent, EventIntake
from runtime.records.journal import Journal
from runtime.records.latch_file import LatchFile
from runtime.records.outbox import EventDraft, Outbox, OutboxError, set_damaged_aside
from runtime.throw.protocol import Latch


class Disk:
    def __init__(self, folder):
        self.outbox = Outbox(folder / "machine.db", "m001")
        self.journal = Journal(self.outbox)
        self.latches = LatchFile(folder / "latch", is_new_machine=True)
        self.stored = []
        self.intake = EventIntake(self.journal, self.latches, self.stored.append)
        self.number = 0

    def take(self, kind, **data):
        self.number += 1
        draft = EventDraft(kind, self.number, None, None, data, "2026-01-01T00:00:00+00:00")
        return self.intake.take(ControlEvent("boot", self.number, draft))

    def kinds(self):
        return [event.kind for event in self.outbox.batch().events]


@pytest.fixture
def disk(tmp_path):
    made = Disk(tmp_path)
    yield made
    made.outbox.close()


def refuse(disk, monkeypatch):
    def fail(*_):
        raise OutboxError("the machine's database refuses (disk full); check the disk")

    monkeypatch.setattr(disk.journal, "record", fail)


def test_a_latch_that_stands_is_not_replaced_by_the_link_process(disk):
    stop = Latch("link-1", ThrowState.STOPPED, "STOP by anna")
    died = Latch("link-2", ThrowState.STOPPED, "the control process died")
    assert disk.intake.latch(stop)
    assert not disk.intake.latch_unless_latched(died)
    assert disk.latches.latch == stop
    disk.latches.write(None)
    assert disk.intake.latch_unless_latched(died)
    assert disk.latches.latch == died


def test_stop_and_fault_are_latched_and_cleared_by_name(disk):
    assert disk.take(EventKind.STOP_LATCHED, latch_id="b.1", reason="STOP by anna")
    assert disk.latches.latch == Latch("b.1", ThrowState.STOPPED, "STOP by anna")
    assert disk.intake.is_durable("b.1") and not disk.intake.is_durable("")
    disk.take(EventKind.FAULT, latch_id="b.2", reason="a hose burst")
    assert disk.latches.latch.state is ThrowState.FAULT
    disk.take(EventKind.STOP_CLEARED, latch_id="b.1")
    assert disk.latches.latch.latch_id == "b.2"
    disk.take(EventKind.STOP_CLEARED, latch_id="b.2")
    assert disk.latches.latch is None and disk.intake.is_durable("")
    disk.take(EventKind.FAULT, reason="without a latch")
    assert disk.latches.latch is None
    assert len(disk.stored) == 5


def test_a_latch_that_is_over_was_on_the_disk(disk, monkeypatch):
    """Answers wait for their latch, in order: one that never counted as written would block all others."""
    disk.take(EventKind.STOP_LATCHED, latch_id="b.1", reason="r")
    disk.take(EventKind.STOP_CLEARED, latch_id="b.1")
    assert disk.intake.is_durable("b.1") and disk.intake.is_durable("")

    def fail(_):
        raise OutboxError("no")

    with monkeypatch.context() as broken:
        broken.setattr(disk.latches, "write", fail)
        for latch_id in ("b.2", "b.3"):
            disk.take(EventKind.STOP_LATCHED, latch_id=latch_id, reason="r")
            assert not disk.intake.is_durable(latch_id)
    assert disk.intake.retry()
    assert disk.latches.latch.latch_id == "b.3"
    assert disk.intake.is_durable("b.2") and disk.intake.is_durable("b.3")
    assert not disk.intake.is_durable("b.4")


def test_a_full_disk_keeps_the_latch_and_loses_no_event(disk, monkeypatch):
    with monkeypatch.context() as full:
        refuse(disk, full)
        assert not disk.take(EventKind.STOP_LATCHED, latch_id="b.1", reason="STOP by anna")
        assert not disk.take(EventKind.ABORTED)
        assert "disk full" in disk.intake.failure
        assert disk.intake.waiting_count == 2
        assert disk.latches.latch.latch_id == "b.1" and disk.stored == []
    assert disk.intake.retry()
    assert disk.intake.failure == "" and disk.intake.waiting_count == 0
    assert disk.kinds() == [EventKind.STOP_LATCHED, EventKind.ABORTED]


def test_a_latch_that_cannot_be_written_is_tried_again(disk, monkeypatch):
    def fail(_):
        raise OutboxError("no")

    with monkeypatch.context() as broken:
        broken.setattr(disk.latches, "write", fail)
        assert not disk.take(EventKind.STOP_LATCHED, latch_id="b.1", reason="r")
        assert not disk.intake.is_durable("b.1")
        disk.take(EventKind.STOP_CLEARED, latch_id="b.0")
    assert disk.intake.retry() and disk.intake.is_durable("b.1")


def test_a_clear_that_cannot_be_written_comes_up_stopped(disk, monkeypatch):
    def fail(_):
        raise OutboxError("no")

    disk.intake.latch(Latch("b.1", ThrowState.STOPPED, "r"))
    monkeypatch.setattr(disk.latches, "write", fail)
    assert disk.take(EventKind.STOP_CLEARED, latch_id="b.1")
    assert disk.latches.latch.latch_id == "b.1"


def test_events_beyond_the_memory_are_counted(disk, monkeypatch):
    refuse(disk, monkeypatch)
    monkeypatch.setattr(event_intake, "WAITING_LIMIT_COUNT", 2)
    for _ in range(3):
        disk.take(EventKind.ABORTED)
    assert (disk.intake.waiting_count, disk.intake.dropped_count) == (2, 1)


def test_repeated_events_of_control_are_stored_once_and_the_link_s_own_always(disk):
    draft = EventDraft(EventKind.ABORTED, 1, None, None, {}, "now")
    for number in (1, 1, 0, 0):
        disk.intake.take(ControlEvent("boot", number, draft))
    assert len(disk.stored) == 3


# Damaged databases


def test_a_sound_database_stays(tmp_path):
    path = tmp_path / "machine.db"
    assert set_damaged_aside(path) == ""
    Outbox(path, "m001").close()
    assert set_damaged_aside(path) == "" and path.exists()


def test_damaged_databases_are_kept_aside(tmp_path):
    def empty(path):
        path.write_bytes(b"")

    def no_database(path):
        path.write_bytes(b"rubbish" * 1000)

    def flipped(path):
        content = bytearray(path.read_bytes())
        content[4096:8192] = bytes(b ^ 0xFF for b in content[4096:8192])
        path.write_bytes(bytes(content))

    def odd_epoch(path):
        with sqlite3.connect(path) as database:
            database.execute("INSERT OR REPLACE INTO meta VALUES ('epoch_count', '1x')")
        database.close()

    def huge_epoch(path):
        with sqlite3.connect(path) as database:
            database.execute("INSERT OR REPLACE INTO meta VALUES ('epoch_count', ?)", (str(2**63),))
        database.close()

    def without_tables(path):
        path.unlink()
        with sqlite3.connect(path) as database:
            database.execute("CREATE TABLE other (a)")
        database.close()

    for damage in (empty, no_database, flipped, odd_epoch, huge_epoch, without_tables):
        folder = tmp_path / damage.__name__
        path = folder / "machine.db"
        Outbox(path, "m001").close()
        damage(path)
        content = path.read_bytes()
        said = set_damaged_aside(path)
        (kept,) = [p for p in folder.iterdir() if "damaged" in p.name and "-wal" not in p.name]
        assert kept.name in said and not path.exists(), damage.__name__
        assert kept.read_bytes() == content
        Outbox(path, "m001").close()


def test_a_damaged_event_is_reported_in_its_place(disk):
    disk.take(EventKind.ABORTED)
    disk.take(EventKind.IMPACT)
    with disk.outbox.transaction() as database:
        database.execute("UPDATE events SET body='{broken' WHERE sequence=1")
    batch = disk.outbox.batch()
    assert [event.kind for event in batch.events] == [EventKind.FAULT, EventKind.IMPACT]
    assert batch.events[0].data["record"] == "{broken"
    assert disk.outbox.acknowledge(batch, "boot", 2) == 2
