"""The recorder: whole files, bounded queue, a disk that fails, and files that others can read."""

import json
import threading
from pathlib import Path

import pytest
from mcap.reader import make_reader

from machine.channels import LOG_CHANNELS
from machine.errors import LogError
from machine.messages import ImpactSurvey
from runtime.records.log_reader import read_throw_log
from runtime.records.log_writer import StoredLog, write_throw_log
from runtime.records.recorder import RESERVED_COUNT, ThrowRecorder, part_path
from runtime.records.throw_log import ROW_TYPES
from tests.runtime.log_samples import event, random_log, random_rows, same_rows


class Store:
    def __init__(self) -> None:
        self.logs: list[StoredLog] = []
        self.news = threading.Event()

    def __call__(self, stored: StoredLog) -> None:
        self.logs.append(stored)
        self.news.set()


def test_offline_writer_and_reader_round_trip(tmp_path):
    log = random_log(mode="2d", spec={"a": [1.0, 2.5]})
    stored = write_throw_log(tmp_path / "deep" / "t1.mcap", log)
    back = read_throw_log(stored.path)
    assert same_rows(log, back)
    assert back.events == log.events
    assert (back.impact, back.impact_t_mono_ns) == (log.impact, 6_000_000_000)
    assert back.metadata["spec"] == {"a": [1.0, 2.5]}
    assert back.is_complete
    assert stored.size_bytes == stored.path.stat().st_size
    assert [path.name for path in stored.path.parent.iterdir()] == ["t1.mcap"]
    # Reading and writing again gives the same content: nothing piles up in the metadata.
    again = write_throw_log(tmp_path / "again.mcap", back)
    assert again.log_sha256 == stored.log_sha256


def test_file_is_an_indexed_mcap_with_embedded_schemas(tmp_path):
    stored = write_throw_log(tmp_path / "t1.mcap", random_log())
    with stored.path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert {c.topic for c in summary.channels.values()} == {
            channel.topic for channel in LOG_CHANNELS.values()
        }
        assert all(schema.encoding == "jsonschema" for schema in summary.schemas.values())
        assert all(json.loads(s.data)["type"] == "object" for s in summary.schemas.values())
        assert {chunk.compression for chunk in summary.chunk_indexes} == {"zstd"}
        assert [record.name for record in reader.iter_metadata()] == ["throw", "result"]
        times = [message.log_time for _, _, message in reader.iter_messages(log_time_order=False)]
    assert times == sorted(times)


def test_recorder_writes_what_it_is_given(tmp_path):
    store = Store()
    recorder = ThrowRecorder(tmp_path, store)
    log = random_log()
    recorder.begin("t1", log.metadata)
    for name in ROW_TYPES:
        recorder.add_rows(name, getattr(log, name), 1)
    for item in log.events:
        recorder.add_event(item)
    recorder.add_impact(log.impact, log.impact_t_mono_ns)
    recorder.end({"outcome": "landed"})
    assert store.news.wait(10.0)
    recorder.close()
    back = read_throw_log(store.logs[0].path)
    assert same_rows(log, back)
    assert back.events == log.events
    assert back.metadata["result"]["outcome"] == "landed"
    assert back.is_complete
    assert recorder.dropped_count == 0


def test_full_queue_drops_rows_counts_them_and_keeps_begin_and_end(tmp_path):
    is_open = threading.Event()

    class SlowStore(Store):
        def __call__(self, stored: StoredLog) -> None:
            if not self.logs:
                is_open.wait(10.0)
            super().__call__(stored)

    store = SlowStore()
    recorder = ThrowRecorder(tmp_path, store, queue_length=RESERVED_COUNT + 50)
    rows = random_rows("imu", 1, 0)
    recorder.begin("t1", {"throw_id": "t1"})
    recorder.end({})
    # Its thread now hangs in the first report: what comes meanwhile fills the queue.
    recorder.begin("t2", {"throw_id": "t2"})
    for _ in range(500):
        recorder.add_rows("imu", rows, 1)
    recorder.add_event(event(1))
    recorder.end({"outcome": "landed"})
    assert recorder.dropped_count >= 450 - RESERVED_COUNT
    dropped = recorder.dropped_count
    is_open.set()
    recorder.close()
    back = read_throw_log(tmp_path / "t2.mcap")
    assert len(back.imu) == 500 - dropped
    assert len(back.events) == 1
    assert not back.is_complete
    assert back.metadata["result"]["dropped_count"] == dropped


def test_disk_that_refuses_is_said_and_the_next_throw_is_recorded(tmp_path):
    folder, store = tmp_path / "throws", Store()
    recorder = ThrowRecorder(folder, store)
    part_path(folder, "bad").mkdir()
    recorder.begin("bad", {"throw_id": "bad"})
    recorder.add_event(event(1))
    recorder.end({})
    recorder.begin("good", {"throw_id": "good"})
    recorder.end({})
    recorder.close()
    assert [stored.throw_id for stored in store.logs] == ["good"]
    assert recorder.dropped_count == 1
    assert recorder.failure == ""


def test_a_new_throw_closes_the_log_that_nobody_ended(tmp_path):
    store = Store()
    recorder = ThrowRecorder(tmp_path, store)
    recorder.begin("t1", {"throw_id": "t1"})
    recorder.begin("t2", {"throw_id": "t2"})
    recorder.end({"outcome": "landed"})
    recorder.close()
    assert [stored.throw_id for stored in store.logs] == ["t1", "t2"]
    assert read_throw_log(tmp_path / "t1.mcap").metadata["result"]["outcome"] == "interrupted"


def test_log_of_a_recorder_that_died_goes_on_with_a_gap(tmp_path):
    store = Store()
    recorder = ThrowRecorder(tmp_path, store)
    earlier = random_log(ticks=80)
    recorder.begin("t1", earlier.metadata, earlier, has_gap=True)
    later = random_rows("control", 30, 9)
    recorder.add_rows("control", later, 1)
    recorder.add_impact(ImpactSurvey(position_m=(1.0, 2.0, 0.0), sd_m=0.1, source="survey"), 7)
    recorder.end({"outcome": "landed"})
    recorder.close()
    back = read_throw_log(tmp_path / "t1.mcap")
    assert len(back.control) == 110
    assert not back.is_complete
    assert back.metadata["result"]["outcome"] == "landed"
    assert back.impact.position_m == (1.0, 2.0, 0.0)


def test_unwritable_path_is_a_log_error(tmp_path: Path):
    (tmp_path / "file").write_text("x", encoding="utf-8")
    with pytest.raises(LogError, match="check the disk"):
        write_throw_log(tmp_path / "file" / "t1.mcap", random_log())
