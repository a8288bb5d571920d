"""Whatever the bytes: a log or a LogError; a file that was cut gives all that was on the disk."""

import json
import logging
import math
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import Writer

import runtime.records.log_reader
from machine.errors import LogError
from machine.messages import ImpactSurvey
from runtime.records.log_reader import RawLog, read_throw_log, recover_log
from runtime.records.log_writer import LogWriter, write_throw_log
from runtime.records.recorder import part_path
from runtime.records.throw_log import (
    event_to_json,
    events_from_json,
    impact_to_json,
    metadata_to_text,
)
from tests.runtime.log_samples import random_log


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> bytes:
    path = tmp_path_factory.mktemp("log") / "t1.mcap"
    log = random_log(ticks=200)
    with path.open("wb") as stream:
        writer = LogWriter(stream, log.metadata)
        for row in log.control:
            writer.add_row("control", row, int(row["t_mono_ns"]))
        writer.close({"outcome": "landed", "is_complete": True})
    return path.read_bytes()


def read(tmp_path_factory, content: bytes):
    path = tmp_path_factory.getbasetemp() / "cut.mcap"
    path.write_bytes(content)
    return read_throw_log(path)


@settings(deadline=None, max_examples=60)
@given(st.data())
def test_cut_files_give_a_growing_prefix_or_a_clear_error(tmp_path_factory, whole, data):
    cut = data.draw(st.integers(0, len(whole) - 1))
    expected = read(tmp_path_factory, whole).control
    try:
        log = read(tmp_path_factory, whole[:cut])
    except LogError as error:
        assert "is not a readable throw log" in str(error)
        assert cut < 1200, "the metadata was on the disk, so the log is readable"
        return
    count = len(log.control)
    assert np.array_equal(log.control["tick_count"], expected["tick_count"][:count])
    # At most the open chunk is lost: 8 KiB before compression, about a dozen rows.
    assert count >= (cut - 9000) / len(whole) * len(expected) - 12


@settings(deadline=None, max_examples=80)
@given(st.data())
def test_damaged_bytes_never_give_another_exception(tmp_path_factory, whole, data):
    content = bytearray(whole)
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(whole) - 1))] = data.draw(st.integers(0, 255))
    try:
        log = read(tmp_path_factory, bytes(content))
    except LogError:
        return
    assert len(log.control) <= 200


@given(st.binary(max_size=300))
def test_foreign_bytes_are_a_log_error(tmp_path_factory, content):
    with pytest.raises(LogError):
        read(tmp_path_factory, content)


def test_missing_file_and_foreign_mcap_are_explained(tmp_path):
    with pytest.raises(LogError, match="cannot open"):
        read_throw_log(tmp_path / "none.mcap")
    with (tmp_path / "other.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        writer.finish()
    with pytest.raises(LogError, match="no metadata record 'throw'"):
        read_throw_log(tmp_path / "other.mcap")


def write_version(path, version) -> None:
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        writer.add_metadata("throw", metadata_to_text({"log_schema_version": version}))
        writer.finish()


def test_a_survey_without_its_precision_and_kinds_of_newer_writers_are_read(tmp_path):
    log = random_log(ticks=20)
    survey = ImpactSurvey(position_m=(8.0, 0.1, 0.0), sd_m=math.nan, source="manual")
    path = tmp_path / "t.mcap"
    write_throw_log(path, replace(log, impact=survey, impact_t_mono_ns=5))
    found = read_throw_log(path).impact
    assert found is not None
    assert found.position_m == survey.position_m
    assert math.isnan(found.sd_m)
    assert json.loads(impact_to_json(survey, 5))["sd_m"] is None
    event = json.loads(event_to_json(log.events[0]))
    newer = [json.dumps({**event, "kind": kind}).encode() for kind in ("tea_time", event["kind"])]
    assert [e.kind for e in events_from_json(newer)] == [log.events[0].kind]


def test_newer_schema_is_refused_with_the_remedy(tmp_path):
    write_version(tmp_path / "t.mcap", 2)
    with pytest.raises(LogError, match="reads up to 1; update it"):
        read_throw_log(tmp_path / "t.mcap")
    write_version(tmp_path / "t.mcap", "one")
    with pytest.raises(LogError, match="schema version 'one'"):
        read_throw_log(tmp_path / "t.mcap")


def test_older_schema_is_migrated_step_by_step(tmp_path, monkeypatch):
    def to_one(raw: RawLog) -> RawLog:
        raw.metadata["throw"]["throw_id"] = raw.metadata["throw"].pop("id")
        return raw

    with (tmp_path / "t.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        writer.add_metadata("throw", metadata_to_text({"log_schema_version": 0, "id": "old"}))
        writer.finish()
    with pytest.raises(LogError, match="never existed"):
        read_throw_log(tmp_path / "t.mcap")
    monkeypatch.setitem(runtime.records.log_reader.MIGRATIONS, 0, to_one)
    assert read_throw_log(tmp_path / "t.mcap").metadata["throw_id"] == "old"


def test_message_that_does_not_fit_is_named(tmp_path):
    with (tmp_path / "t.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        writer.add_metadata("throw", metadata_to_text({"log_schema_version": 1}))
        channel = writer.register_channel("/imu", "json", 0)
        writer.add_message(channel, 1, b'{"gyro_rad_per_s": [1]}', 1)
        writer.finish()
    with pytest.raises(LogError, match="gyro_rad_per_s"):
        read_throw_log(tmp_path / "t.mcap")


def test_killed_recorder_leaves_a_file_that_recovery_completes(tmp_path):
    code = (
        "import os, signal, time\n"
        "from pathlib import Path\n"
        "from tests.runtime.log_samples import random_log\n"
        "from runtime.records.recorder import ThrowRecorder, part_path\n"
        f"folder = Path({str(tmp_path)!r})\n"
        "recorder = ThrowRecorder(folder, print)\n"
        "log = random_log(ticks=400)\n"
        "recorder.begin('t1', log.metadata)\n"
        "recorder.add_rows('control', log.control, 1)\n"
        "while recorder._queue.qsize() or part_path(folder, 't1').stat().st_size < 50_000:\n"
        "    time.sleep(0.01)\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == -9
    stored = recover_log(tmp_path, "t1")
    assert not part_path(tmp_path, "t1").exists()
    log = read_throw_log(stored.path)
    assert log.metadata["result"] == {
        "outcome": "interrupted",
        "is_complete": False,
        "row_count": {"control": len(log.control)} | dict.fromkeys(
            ("policy", "imu", "ball", "event", "impact"), 0
        ),
    }  # fmt: skip
    assert len(log.control) >= 10
    # A second recovery, after a crash in the middle of the first, changes nothing.
    assert recover_log(tmp_path, "t1") is None
    assert read_throw_log(stored.path).metadata == log.metadata


def test_part_file_without_content_is_given_up(tmp_path, caplog):
    part_path(tmp_path, "t1").write_bytes(b"")
    with caplog.at_level(logging.WARNING):
        assert recover_log(tmp_path, "t1") is None
    assert "nothing to recover" in caplog.text
    assert not part_path(tmp_path, "t1").exists()


def test_complete_log_says_so(tmp_path):
    assert read_throw_log(write_throw_log(tmp_path / "t.mcap", random_log()).path).is_complete


def test_the_refusal_says_what_the_file_is(tmp_path_factory, whole):
    for content, words in (
        (whole[:40], "cut off at its end"),
        (b"version https://git-lfs.github.com/spec/v1", "git lfs pull"),
        (b"not a log", "another file"),
        (b"", "another file"),
    ):
        with pytest.raises(LogError, match=words):
            read(tmp_path_factory, content)
