"""Events survive, stay in order and leave only when acknowledged."""

import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from machine.messages import EventKind
from runtime.records.outbox import BATCH_LIMIT_COUNT, EventDraft, Outbox, OutboxError


def draft(kind: EventKind = EventKind.THROW_ENDED, t_ns: int = 5, throw_id: str | None = "t"):
    return EventDraft(kind, t_ns, throw_id, None, {"n": t_ns}, "2026-01-01T00:00:00+00:00")


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "machine.db"


def test_events_outlive_the_process_and_keep_their_order(path):
    outbox = Outbox(path, "m001")
    for n in range(3):
        outbox.add("boot-a", draft(t_ns=n))
    outbox.close()
    outbox = Outbox(path, "m001")
    outbox.add("boot-a", draft(t_ns=3))
    outbox.add("boot-b", draft(t_ns=4))
    batch = outbox.batch()
    assert batch.boot_id == "boot-a"
    assert [e.sequence_count for e in batch.events] == [1, 2, 3, 4]
    assert [e.t_mono_ns for e in batch.events] == [0, 1, 2, 3]
    assert outbox.acknowledge(batch, "boot-a", 4) == 4
    assert [e.sequence_count for e in outbox.batch().events] == [1]
    outbox.close()


def test_killed_process_loses_nothing_that_returned(path):
    code = (
        "import os, signal\n"
        "from pathlib import Path\n"
        "from machine.messages import EventKind\n"
        "from runtime.records.outbox import EventDraft, Outbox\n"
        f"outbox = Outbox(Path({str(path)!r}), 'm001')\n"
        "for n in range(50):\n"
        "    outbox.add('b', EventDraft(EventKind.IMPACT, n, None, None, {}, 'now'))\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == -9
    outbox = Outbox(path, "m001")
    assert [e.t_mono_ns for e in outbox.batch().events] == list(range(50))
    outbox.close()


@settings(deadline=None, max_examples=25)
@given(st.lists(st.integers(0, 40), max_size=12), st.integers(0, 30))
def test_acknowledgements_delete_exactly_what_was_sent_and_committed(tmp_path_factory, acks, total):
    outbox = Outbox(tmp_path_factory.mktemp("outbox") / "m.db", "m001")
    for n in range(total):
        outbox.add("b", draft(t_ns=n))
    left = list(range(1, total + 1))
    for ack in acks:
        batch = outbox.batch()
        if batch is None:
            break
        outbox.acknowledge(batch, "b", ack)
        left = [n for n in left if n > min(ack, batch.events[-1].sequence_count)]
    assert outbox.count() == len(left)
    batch = outbox.batch()
    found = [] if batch is None else [e.sequence_count for e in batch.events]
    assert found == left[:BATCH_LIMIT_COUNT]
    outbox.close()


def test_acknowledgement_of_another_boot_deletes_nothing(path):
    outbox = Outbox(path, "m001")
    outbox.add("b", draft())
    assert outbox.acknowledge(outbox.batch(), "other", 10) == 0
    assert outbox.count() == 1
    outbox.close()


def test_sequences_are_never_reused_after_deletion(path):
    outbox = Outbox(path, "m001")
    outbox.add("b", draft())
    outbox.acknowledge(outbox.batch(), "b", 1)
    assert outbox.add("b", draft()).sequence_count == 2
    outbox.close()


def test_full_outbox_drops_the_unimportant_only_and_says_so(path):
    outbox = Outbox(path, "m001", limit_count=2)
    for _ in range(2):
        assert outbox.add("b", draft(EventKind.COMMAND_REFUSED)) is not None
    assert outbox.add("b", draft(EventKind.COMMAND_REFUSED)) is None
    assert outbox.add("b", draft(EventKind.THROW_ENDED)) is not None
    assert (outbox.count(), outbox.dropped_count()) == (3, 1)
    outbox.close()


def test_control_events_are_stored_once(path):
    outbox = Outbox(path, "m001")
    with outbox.transaction():
        assert outbox.is_new_control_event("b", 1)
    with outbox.transaction():
        assert not outbox.is_new_control_event("b", 1)
        assert outbox.is_new_control_event("b", 2)
        assert outbox.is_new_control_event("c", 1)
    outbox.close()


def test_failed_transaction_leaves_nothing(path):
    outbox = Outbox(path, "m001")
    with pytest.raises(RuntimeError), outbox.transaction():
        outbox.add("b", draft())
        raise RuntimeError
    assert outbox.count() == 0
    outbox.close()


def test_foreign_and_broken_files_are_refused(path, tmp_path):
    Outbox(path, "m001").close()
    with pytest.raises(OutboxError, match="belongs to machine m001"):
        Outbox(path, "m002")
    broken = tmp_path / "broken.db"
    broken.write_bytes(b"not a database, but long enough to be looked at" * 40)
    with pytest.raises(OutboxError, match="cannot open"):
        Outbox(broken, "m001")
