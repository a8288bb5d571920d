"""Logs over crashes: recovered, reported once, and the disk does not fill with what the server has."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from machine.messages import EventKind
from runtime.records import records
from runtime.records.journal import Journal
from runtime.records.log_reader import read_throw_log
from runtime.records.log_writer import LogWriter, write_throw_log
from runtime.records.outbox import EventDraft, Outbox
from runtime.records.recorder import log_path, part_path
from runtime.records.records import Records
from tests.runtime.log_samples import random_log, random_rows


@pytest.fixture
def journal(tmp_path: Path) -> Iterator[Journal]:
    outbox = Outbox(tmp_path / "m.db", "m001")
    journal = Journal(outbox)
    journal.begin_boot("boot", EventDraft(EventKind.BOOTED, 1, None, None, {}, "now"))
    yield journal
    outbox.close()


def draft(kind: EventKind, throw_id: str) -> EventDraft:
    return EventDraft(kind, 1, throw_id, None, {}, "now")


def add_throw(journal: Journal, number: int, throw_id: str, *, has_ended: bool = True) -> None:
    journal.record("boot", 2 * number, draft(EventKind.THROW_ACCEPTED, throw_id))
    if has_ended:
        journal.record("boot", 2 * number + 1, draft(EventKind.THROW_ENDED, throw_id))


def write_part(folder: Path, throw_id: str, ticks: int = 60) -> None:
    folder.mkdir(exist_ok=True)
    with part_path(folder, throw_id).open("wb") as stream:
        writer = LogWriter(stream, {"throw_id": throw_id}, 500)
        for row in random_rows("control", ticks, 0):
            writer.add_row("control", row, 1)


def make(tmp_path: Path, journal: Journal) -> tuple[Records, list[int]]:
    news: list[int] = []
    return Records(tmp_path / "throws", journal, lambda: news.append(1)), news


def test_all_part_files_of_earlier_boots_are_recovered_and_reported(tmp_path, journal):
    for number, throw_id in enumerate(("t1", "t2"), 1):
        add_throw(journal, number, throw_id)
        write_part(tmp_path / "throws", throw_id)
    found, news = make(tmp_path, journal)
    found.resume(None, is_open=False)
    found.close()
    assert journal.to_upload() == ("t1", "t2")
    assert len(news) == 2
    log = read_throw_log(log_path(tmp_path / "throws", "t1"))
    assert (log.metadata["result"]["outcome"], log.is_complete) == ("interrupted", False)


def test_log_finished_but_not_reported_before_a_crash_is_reported_once(tmp_path, journal):
    add_throw(journal, 1, "t1")
    write_throw_log(log_path(tmp_path / "throws", "t1"), random_log())
    found, news = make(tmp_path, journal)
    found.resume(None, is_open=False)
    found.resume(None, is_open=False)
    found.close()
    assert journal.to_upload() == ("t1",)
    assert len(news) == 1


def test_running_throw_goes_on_in_the_same_file(tmp_path, journal):
    add_throw(journal, 1, "t1", has_ended=False)
    write_part(tmp_path / "throws", "t1")
    found, _ = make(tmp_path, journal)
    found.resume({"throw_id": "t1"}, is_open=True)
    found.add_rows({"control": random_rows("control", 5, 1)}, 1)
    found.end({"outcome": "landed"})
    found.close()
    log = read_throw_log(log_path(tmp_path / "throws", "t1"))
    assert len(log.control) > 40
    assert log.metadata["result"]["outcome"] == "landed"
    assert not log.is_complete
    assert not part_path(tmp_path / "throws", "t1").exists()


def test_finished_throw_with_a_whole_file_is_left_alone(tmp_path, journal):
    add_throw(journal, 1, "t1")
    path = log_path(tmp_path / "throws", "t1")
    write_throw_log(path, random_log())
    before = path.read_bytes()
    found, _ = make(tmp_path, journal)
    found.resume({"throw_id": "t1"}, is_open=False)
    found.end({"outcome": "landed"})
    found.close()
    assert path.read_bytes() == before


def test_ticks_lost_on_the_way_make_a_log_incomplete(tmp_path, journal):
    found, _ = make(tmp_path, journal)
    for throw_id, lost in (("t1", 0), ("t2", 3)):
        found.begin(throw_id, {"throw_id": throw_id})
        found.count_lost(lost)
        found.end({"outcome": "landed"})
    assert found.dropped_count == 3
    found.close()
    logs = [read_throw_log(log_path(tmp_path / "throws", name)) for name in ("t1", "t2")]
    assert [log.is_complete for log in logs] == [True, False]


def test_log_of_a_control_process_that_died_is_closed_as_interrupted(tmp_path, journal):
    add_throw(journal, 1, "t1", has_ended=False)
    found, _ = make(tmp_path, journal)
    found.begin("t1", {"throw_id": "t1"})
    found.add_rows({"control": random_rows("control", 5, 1)}, 1)
    found.resume(None, is_open=False)
    found.close()
    log = read_throw_log(log_path(tmp_path / "throws", "t1"))
    assert (log.metadata["result"]["outcome"], log.is_complete) == ("interrupted", False)


def test_uploaded_logs_beyond_the_limit_are_deleted_others_kept(tmp_path, journal, monkeypatch):
    monkeypatch.setattr(records, "KEPT_LOGS_COUNT", 2)
    found, _ = make(tmp_path, journal)
    for number in range(1, 6):
        throw_id = f"t{number}"
        add_throw(journal, number, throw_id)
        found.begin(throw_id, {"throw_id": throw_id})
        found.end({"outcome": "landed"})
        if throw_id != "t2":
            journal.mark_uploaded(throw_id)
    found.close()
    left = sorted(path.name for path in (tmp_path / "throws").iterdir())
    assert left == ["t2.mcap", "t4.mcap", "t5.mcap"]
