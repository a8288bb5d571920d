"""Every throw is reported ended exactly once, whatever dies when."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from machine.messages import EventKind
from machine.site.zones import ZoneSet
from runtime.records.journal import Journal
from runtime.records.log_writer import StoredLog
from runtime.records.outbox import EventDraft, Outbox
from tests.machine.site.test_zones import zone


def draft(kind: EventKind, throw_id: str | None = None, **data) -> EventDraft:
    return EventDraft(kind, 7, throw_id, "plan" if throw_id else None, data, "2026-01-01T00:00:00Z")


def booted() -> EventDraft:
    return draft(EventKind.BOOTED)


@pytest.fixture
def outbox(tmp_path: Path) -> Iterator[Outbox]:
    outbox = Outbox(tmp_path / "machine.db", "m001")
    yield outbox
    outbox.close()


def events(outbox: Outbox) -> list[tuple[str, str | None]]:
    found: list[tuple[str, str | None]] = []
    while (batch := outbox.batch()) is not None:
        found += [(event.kind.value, event.throw_id) for event in batch.events]
        outbox.acknowledge(batch, batch.boot_id, batch.events[-1].sequence_count)
    return found


def test_epoch_only_rises(outbox):
    journal = Journal(outbox)
    for epoch in (3, 2, 7, 0):
        journal.raise_epoch(epoch)
    assert journal.memory().epoch_count == 7


def test_throw_begun_in_an_earlier_boot_is_reported_interrupted_once(outbox):
    journal = Journal(outbox)
    journal.begin_boot("a", booted())
    assert journal.intend_throw("t1")
    journal.record("a", 1, draft(EventKind.THROW_ACCEPTED, "t1"))
    assert journal.begin_boot("b", booted()) == ("t1",)
    assert journal.begin_boot("b", booted()) == ()
    assert journal.begin_boot("c", booted()) == ()
    assert events(outbox) == [
        ("booted", None),
        ("throw_accepted", "t1"),
        ("booted", None),
        ("throw_ended", "t1"),
        ("booted", None),
    ]
    assert journal.memory().throw_ids == ("t1",)


def test_intended_fire_without_answer_is_reported_too(outbox):
    journal = Journal(outbox)
    journal.begin_boot("a", booted())
    journal.intend_throw("t1")
    assert journal.begin_boot("b", booted()) == ("t1",)
    batch = outbox.batch()
    outbox.acknowledge(batch, "a", 1)
    end = outbox.batch().events[1]
    assert (end.kind, end.data["outcome"]) == (EventKind.THROW_ENDED, "interrupted")
    assert "before it answered" in end.data["detail"]


def test_refused_fire_leaves_no_trace_but_an_accepted_one_cannot_be_forgotten(outbox):
    journal = Journal(outbox)
    journal.begin_boot("a", booted())
    journal.intend_throw("t1")
    journal.forget_intent("t1")
    assert journal.memory().throw_ids == ()
    journal.intend_throw("t2")
    journal.record("a", 1, draft(EventKind.THROW_ACCEPTED, "t2"))
    journal.forget_intent("t2")
    assert journal.memory().throw_ids == ("t2",)
    assert not journal.intend_throw("t2")


def test_late_end_after_interruption_is_not_a_second_end(outbox):
    journal = Journal(outbox)
    journal.begin_boot("a", booted())
    journal.record("a", 1, draft(EventKind.THROW_ACCEPTED, "t1"))
    journal.begin_boot("b", booted())
    assert journal.record("a", 2, draft(EventKind.THROW_ENDED, "t1", outcome="landed")) is None
    assert [kind for kind, _ in events(outbox)].count("throw_ended") == 1


def test_log_is_reported_once_and_stays_queued_until_uploaded(outbox, tmp_path):
    journal = Journal(outbox)
    journal.begin_boot("a", booted())
    journal.record("a", 1, draft(EventKind.THROW_ACCEPTED, "t1"))
    log = StoredLog("t1", tmp_path / "t1.mcap", "ab" * 32, 10)
    assert journal.add_log("a", log, 9).data == {"log_sha256": "ab" * 32, "size_bytes": 10}
    assert journal.add_log("a", log, 9) is None
    assert journal.to_upload() == ("t1",)
    journal.mark_uploaded("t1")
    assert journal.to_upload() == ()


STEPS = st.lists(
    st.sampled_from(["fire", "accept", "refuse", "end", "repeat_end", "crash", "link_restart"]),
    max_size=40,
)


@settings(deadline=None, max_examples=40)
@given(STEPS)
def test_each_throw_ends_exactly_once_under_any_order_of_crashes(tmp_path_factory, steps):
    path = tmp_path_factory.mktemp("journal") / "m.db"
    outbox, boot, number, throw = Outbox(path, "m001"), 0, 0, 0
    journal = Journal(outbox)
    journal.begin_boot("boot-0", booted())
    state = "idle"
    began: set[str] = set()
    for step in steps:
        throw_id = f"t{throw}"
        if step == "fire" and state == "idle":
            assert journal.intend_throw(throw_id)
            state = "intended"
        elif step == "accept" and state == "intended":
            number += 1
            journal.record(f"boot-{boot}", number, draft(EventKind.THROW_ACCEPTED, throw_id))
            began.add(throw_id)
            state = "running"
        elif step == "refuse" and state == "intended":
            journal.forget_intent(throw_id)
            state = "idle"
        elif step == "end" and state == "running":
            number += 1
            journal.record(f"boot-{boot}", number, draft(EventKind.THROW_ENDED, throw_id))
            throw, state = throw + 1, "idle"
        elif step == "repeat_end" and number:
            journal.record(f"boot-{boot}", number, draft(EventKind.THROW_ENDED, f"t{throw - 1}"))
        elif step in ("crash", "link_restart"):
            outbox.close()
            outbox = Outbox(path, "m001")
            journal = Journal(outbox)
            if step == "crash":
                if state != "idle":
                    began.add(throw_id)
                    throw += 1
                boot, number, state = boot + 1, 0, "idle"
                journal.begin_boot(f"boot-{boot}", booted())
    if state == "running":
        began.discard(f"t{throw}")
    ended = [throw_id for kind, throw_id in events(outbox) if kind == "throw_ended"]
    outbox.close()
    assert sorted(ended) == sorted(began)


def test_zones_outlive_a_restart_and_damage_is_seen(tmp_path):
    office = ZoneSet(version_count=2, approved_by="sue", zones=(zone(),))
    path = tmp_path / "machine.db"
    first = Outbox(path, "m001")
    assert Journal(first).zone_set() == ZoneSet(version_count=0)
    Journal(first).keep_zones(office)
    first.close()
    second = Outbox(path, "m001")
    journal = Journal(second)
    assert journal.zone_set() == office
    for damaged in (
        second.meta("zones", "").replace("3.0", "2.0"),
        second.meta("zones", "")[:-9],
        "\0",
    ):
        second.set_meta("zones", damaged)
        with pytest.raises(ValueError, match=r"zones|JSON"):
            journal.zone_set()
    journal.forget_zones()
    with pytest.raises(ValueError, match="JSON"):
        journal.zone_set()
    journal.keep_zones(ZoneSet(version_count=3))
    assert journal.zone_set().sha256 == ""
    second.close()
