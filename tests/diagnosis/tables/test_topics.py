"""Columns from ROS bags and MCAP files, written by rosbags' and mcap's own writers."""

import importlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import Writer
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_typestore

from cli import diagnose
from diagnosis.tables.cells import RefusedTableError
from diagnosis.tables.columns import find_command_column, find_output_columns, find_time_column
from diagnosis.tables.joint_record import read_joint_record
from diagnosis.tables.table import ReadOptions, read_table
from diagnosis.tables.topics import TopicField
from machine.errors import UsageError

ROWS = 200
PERIOD_NS = 20_000_000
START_NS = 1_700_000_000_123_456_789
COMMAND, ARM = TopicField("/valve_cmd", "data"), TopicField("/joint_states", "position[1]")
BOOM = TopicField("/joint_states", "position[boom]")


def arm_rad(k: int) -> float:
    return 0.4 * float(np.sin(0.05 * k))


def lever(k: int) -> float:
    return float(k // 40 % 3 - 1)


def write_ros(path: Path, writer: Any, store: Stores, serialize: str, delay_ns: int) -> Path:
    """Joint states with a header, and commands without one half a period later."""
    types = get_typestore(store)
    kinds = types.types
    encode: Callable[[object, str], bytes] = getattr(types, serialize)
    number = {"seq": 0} if store is Stores.ROS1_NOETIC else {}
    joint, command = "sensor_msgs/msg/JointState", "std_msgs/msg/Float64"
    with writer as bag:
        joints = bag.add_connection(ARM.topic, joint, typestore=types)
        commands = bag.add_connection(COMMAND.topic, command, typestore=types)
        for k in range(ROWS):
            now_ns = START_NS + k * PERIOD_NS
            stamp = kinds["builtin_interfaces/msg/Time"](*divmod(now_ns, 10**9))
            header = kinds["std_msgs/msg/Header"](**number, stamp=stamp, frame_id="")
            nothing = np.array([])
            state = kinds[joint](
                header, ["boom", "arm"], np.array([0.5, arm_rad(k)]), nothing, nothing
            )
            bag.write(joints, now_ns + delay_ns, encode(state, joint))
            sent = kinds[command](lever(k))
            bag.write(commands, now_ns + PERIOD_NS // 2, encode(sent, command))
    return path


def recordings(folder: Path, delay_ns: int = 0) -> list[Path]:
    """A ROS 1 bag, a ROS 2 bag as folder and as file, and an MCAP file."""
    old = folder / "ros1.bag"
    write_ros(old, Ros1Writer(old), Stores.ROS1_NOETIC, "serialize_ros1", delay_ns)
    found = [old]
    for name, plugin in (("sqlite", StoragePlugin.SQLITE3), ("mcap", StoragePlugin.MCAP)):
        path = folder / name
        writer = Ros2Writer(path, version=9, storage_plugin=plugin)
        write_ros(path, writer, Stores.ROS2_HUMBLE, "serialize_cdr", delay_ns)
        found += [path, next(path.glob(f"{name}.*"))]
    return found


def test_topics_of_bags_become_columns_of_a_joint(tmp_path: Path) -> None:
    for path in recordings(tmp_path):
        table = read_table(path, ReadOptions(topics=(COMMAND, ARM, BOOM)))
        assert list(table.columns)[1:] == [
            "/valve_cmd/data",
            "/joint_states/position[1]",
            "/joint_states/position[boom]",
        ]
        time = find_time_column(table, None)
        command = find_command_column(table, time, None)
        outputs, is_speed = find_output_columns(table, [time, command, BOOM.column()])
        record, audit = read_joint_record(table, time, command, outputs[0], is_speed, [""] * 400)
        assert (command, outputs) == ("/valve_cmd/data", ["/joint_states/position[1]"]), path
        assert audit.rate_hz == pytest.approx(50.0, rel=0.01), path
        assert record.unit == "rad"
        rows = np.arange(ROWS)
        assert np.allclose(record.time_s - record.time_s[0], 0.02 * rows, atol=1e-6), path
        assert np.allclose(record.output, [arm_rad(k) for k in rows], atol=1e-12), path
        shown = [lever(k) for k in rows]
        assert np.mean(record.command[1:] == np.array(shown[:-1])) > 0.95, path
        assert np.all(table.numbers(BOOM.column())[::2] == 0.5)


def test_times_are_the_headers_where_all_messages_have_one(tmp_path: Path) -> None:
    late_ns = 7_000_000
    path = recordings(tmp_path, late_ns)[0]
    alone = read_table(path, ReadOptions(topics=(ARM,)))
    assert any("headers" in note for note in alone.notes)
    both = read_table(path, ReadOptions(topics=(ARM, COMMAND)))
    assert any("reception" in note for note in both.notes)
    assert both.numbers("time, s")[:2].tolist() == [0.0, 0.003]


def test_json_in_mcap_is_read_without_rosbags(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(name: str) -> Any:
        raise ModuleNotFoundError(name=name)

    monkeypatch.setattr(importlib, "import_module", fail)
    for encoding in ("json", "protobuf"):
        path = tmp_path / f"{encoding}.mcap"
        with path.open("wb") as file:
            writer = Writer(file)
            writer.start()
            schema = writer.register_schema("Pose", "jsonschema", b"{}")
            channel = writer.register_channel("/ball", encoding, schema)
            for k in range(40):
                data = json.dumps({"pose": {"z": k / 8, "seen": k > 3}}).encode()
                writer.add_message(channel, k * PERIOD_NS, data, k * PERIOD_NS)
            writer.finish()
    wanted = (TopicField("/ball", "pose.z"), TopicField("/ball", "pose.seen"))
    table = read_table(tmp_path / "json.mcap", ReadOptions(topics=wanted))
    assert table.numbers("/ball/pose.z").tolist() == [k / 8 for k in range(40)]
    assert table.numbers("/ball/pose.seen")[:5].tolist() == [0, 0, 0, 0, 1]
    with pytest.raises(RefusedTableError, match="protobuf messages"):
        read_table(tmp_path / "protobuf.mcap", ReadOptions(topics=wanted))
    for path in recordings(tmp_path):
        with pytest.raises(RefusedTableError, match="uv sync --extra rosbags"):
            read_table(path, ReadOptions(topics=(ARM,)))


def test_what_is_not_there_is_named(tmp_path: Path) -> None:
    every = recordings(tmp_path)
    for path in every:
        for topics, words in (
            ((), r"--topic and --field.*/joint_states \(sensor_msgs/JointState\), /valve_cmd"),
            ((TopicField("/arm", "q"),), "no topic '/arm'"),
            ((TopicField("/joint_states", "angle[0]"),), "among header, name, position"),
            ((TopicField("/joint_states", "position"),), r"position\[0\] to position\[1\]"),
            ((TopicField("/joint_states", "position[7]"),), "holds a number in 0% of its rows"),
        ):
            with pytest.raises(RefusedTableError, match=words):
                read_table(path, ReadOptions(topics=topics)).numbers("/joint_states/position[7]")
    for path in (every[0], every[-1]):
        cut = tmp_path / f"cut{path.suffix}"
        cut.write_bytes(path.read_bytes()[: 3 * path.stat().st_size // 5])
        with pytest.raises(RefusedTableError, match="cut off"):
            read_table(cut, ReadOptions(topics=(ARM,)))
    every[0].rename(tmp_path / "ros1.csv")
    with pytest.raises(RefusedTableError, match=r"the ending \.bag"):
        read_table(tmp_path / "ros1.csv")
    text = tmp_path / "a.csv"
    text.write_text("t,q\n" + "1,2\n" * 40)
    with pytest.raises(RefusedTableError, match="no recorded messages"):
        read_table(text, ReadOptions(topics=(ARM,)))
    with pytest.raises(UsageError, match="one --field after each --topic"):
        diagnose.actuation(text, topic=("/a", "/b"), field=("q",))
