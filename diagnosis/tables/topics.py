"""Columns from recorded messages: ROS 1 and 2 bags and MCAP files, by topic and field.

ROS messages need the package rosbags (the extra ``rosbags``); JSON messages in MCAP files do not.
"""

import importlib
import json
import re
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, NamedTuple

from mcap.exceptions import McapError
from mcap.reader import make_reader

from diagnosis.tables.cells import RefusedTableError

MCAP_MARK: Final = b"\x89MCAP0\r\n"
KINDS: Final = (
    (MCAP_MARK, "an MCAP (rosbag) file", ".mcap"),
    (b"#ROSBAG V", "a ROS 1 bag", ".bag"),
    (b"SQLite format 3", "an SQLite file, such as a ROS 2 bag", ".db3"),
)
"""First bytes of recordings, their kinds and the endings of their names."""
EXPORT: Final = "export the topics as CSV, e.g. with PlotJuggler"
INSTALL: Final = "`uv sync --extra rosbags` or `pip install rosbags`"
TIME_COLUMN: Final = "time, s"
_STEP: Final = re.compile(r"([^.\[\]]+)|\[([^\]]+)\]")
_NS: Final = 1_000_000_000
_SHOWN_TOPICS: Final = 30
"""Most topics that a message lists."""


class TopicField(NamedTuple):
    """One number of each message of a topic."""

    topic: str
    field: str
    """As ``twist.linear.x`` or ``position[1]``; a joint's name stands for its number, ``position[boom]``."""

    def column(self) -> str:
        """Name of the column, as PlotJuggler writes it."""
        return f"{self.topic}/{self.field}"


class Messages(NamedTuple):
    """An open recording."""

    topics: dict[str, str]
    """Type of message by topic."""
    read: Callable[[str], Iterator[tuple[int, Any]]]
    """Time of reception, ns, and message, for a topic."""


class TopicColumns(NamedTuple):
    """A row for each message, in the order of time."""

    cells: dict[str, list[str]]
    """By name of the column; blank in the rows of other topics."""
    units: dict[str, str]
    notes: list[str]


def is_recording(path: Path) -> bool:
    """Whether a file or a folder holds recorded messages."""
    return _find_kind(path) is not None


def _find_kind(path: Path) -> tuple[str, str] | None:
    """Kind of a recording and the ending of its name; None if it is none."""
    if path.is_dir():
        return ("a ROS 2 bag", path.suffix) if (path / "metadata.yaml").exists() else None
    if not path.is_file():
        return None
    with path.open("rb") as file:
        start = file.read(16)
    return next(((kind, end) for mark, kind, end in KINDS if start.startswith(mark)), None)


def _kind(path: Path) -> str:
    return (_find_kind(path) or ("no recording", ""))[0]


def read_topics(path: Path, wanted: Sequence[TopicField]) -> TopicColumns:
    """Read fields of topics from a ROS 1 bag, a ROS 2 bag (folder or file) or an MCAP file.

    Times are those in the messages' headers if every message has one, else those of reception.

    Raises:
        RefusedTableError: the file is damaged, rosbags is needed and missing, no field is given, or a topic
            or field is not there or is no number.
    """
    with _open(path) as messages:
        if not wanted:
            raise RefusedTableError(
                f"{path.name} is {_kind(path)}: give --topic and --field for each column, as in --topic "
                f"/joint_states --field position[1], or {EXPORT}. {_list_topics(messages)}"
            )
        rows: list[_Row] = []
        for topic in dict.fromkeys(one.topic for one in wanted):
            if topic not in messages.topics:
                raise RefusedTableError(
                    f"{path.name} has no topic {topic!r}. {_list_topics(messages)}"
                )
            fields = [one for one in wanted if one.topic == topic]
            for received_ns, message in messages.read(topic):
                cells = {one: _cell(path, message, one) for one in fields}
                rows.append(_Row(received_ns, _header_time_ns(message), cells))
        types = {one: messages.topics[one.topic] for one in wanted}
    if not rows:
        raise RefusedTableError(f"{path.name} holds no message of {wanted[0].topic}")
    return _make_columns(rows, types)


class _Row(NamedTuple):
    """A message."""

    received_ns: int
    sent_ns: int
    """0 without a header."""
    cells: dict[TopicField, str]


def _make_columns(rows: list[_Row], types: dict[TopicField, str]) -> TopicColumns:
    """Columns of messages; those of several topics are merged in the order of time."""
    is_sent = all(row.sent_ns > 0 for row in rows)
    stamps = [row.sent_ns if is_sent else row.received_ns for row in rows]
    order = list(range(len(rows)))
    if len({one.topic for one in types}) > 1:
        order.sort(key=lambda k: stamps[k])
    cells = {TIME_COLUMN: [f"{(stamps[k] - stamps[order[0]]) / _NS:.9f}" for k in order]}
    for one in types:
        cells[one.column()] = [rows[k].cells.get(one, "") for k in order]
    units = {one.column(): unit for one, kind in types.items() if (unit := _unit(kind, one.field))}
    origin = "headers" if is_sent else "reception: not all of them have a header"
    notes = [f"times are those of the messages' {origin}"]
    if any(kind.endswith("/JointState") for kind in types.values()):
        notes.append("joint states taken in rad and rad/s, ROS's units of joints that turn")
    return TopicColumns(cells, units, notes)


def _unit(kind: str, field: str) -> str:
    """Unit that ROS fixes for a field (REP 103); empty if it fixes none."""
    first = field.split("[")[0].split(".")
    if kind.endswith("/JointState"):
        return {"position": "rad", "velocity": "rad/s"}.get(first[0], "")
    if "angular" in first or "angular_velocity" in first:
        return "rad/s"
    return "m/s" if kind.startswith("geometry_msgs/") and "linear" in first else ""


def _header_time_ns(message: Any) -> int:
    """Time in the message's header, ns; 0 without one."""
    stamp = _child(_child(message, "header"), "stamp")
    seconds, rest = _child(stamp, "sec"), _child(stamp, "nanosec")
    rest = _child(stamp, "nsec") if rest is None else rest
    return int(seconds) * _NS + int(rest or 0) if isinstance(seconds, int) else 0


def _child(message: Any, name: str) -> Any:
    return message.get(name) if isinstance(message, dict) else getattr(message, name, None)


def _cell(path: Path, message: Any, one: TopicField) -> str:
    """A field of a message as text; blank where an array is too short.

    Raises:
        RefusedTableError: there is no such field, or it is no number.
    """
    found = message
    for name, index in _STEP.findall(one.field):
        above, found = found, _child(found, name) if name else _element(message, found, index)
        if found is None and name:
            raise RefusedTableError(
                f"messages of {one.topic} in {path.name} have no field {one.field!r}: "
                f"{name!r} is not among {', '.join(_names(above)) or 'nothing'}"
            )
        if found is None:
            return ""
    if hasattr(found, "item"):  # numbers of numpy
        found = found.item() if getattr(found, "size", 1) == 1 else found
    if isinstance(found, bool):
        return str(int(found))
    if not isinstance(found, int | float):
        raise RefusedTableError(
            f"{one.field!r} of {one.topic} in {path.name} is no number: "
            f"give one of its parts ({_parts(one.field, found)})"
        )
    return repr(found)


def _element(message: Any, array: Any, index: str) -> Any:
    """An array's element by number, or by a joint's name in the message's field ``name``; else None."""
    if not index.isdigit():
        joints = list(_child(message, "name") or [])
        if index not in joints:
            return None
        index = str(joints.index(index))
    return array[int(index)] if hasattr(array, "__len__") and int(index) < len(array) else None


def _names(message: Any) -> list[str]:
    if isinstance(message, dict):
        return [str(name) for name in message]
    return [name for name in getattr(message, "__dataclass_fields__", {}) if name[0] != "_"]


def _parts(field: str, found: Any) -> str:
    if hasattr(found, "__len__") and not isinstance(found, dict | str):
        return f"{field}[0] to {field}[{len(found) - 1}]"
    return ", ".join(f"{field}.{name}" for name in _names(found)) or "it is text"


def _list_topics(messages: Messages) -> str:
    shown = [f"{name} ({kind})" for name, kind in sorted(messages.topics.items())]
    more = f" and {len(shown) - _SHOWN_TOPICS} more" if len(shown) > _SHOWN_TOPICS else ""
    return f"Its topics: {', '.join(shown[:_SHOWN_TOPICS])}{more}"


@contextmanager
def _open(path: Path) -> Generator[Messages]:
    """Open a recording by its kind."""
    if not path.is_dir() and (json_messages := _open_json(path)) is not None:
        yield json_messages
        return
    try:
        rosbags: Any = importlib.import_module("rosbags.highlevel")
        typesys: Any = importlib.import_module("rosbags.typesys")
    except ModuleNotFoundError:
        raise RefusedTableError(
            f"{path.name} is {_kind(path)}; to read it by --topic and --field install the package "
            f"rosbags: {INSTALL}. Or {EXPORT}"
        ) from None
    kind = _find_kind(path)
    if kind is not None and path.suffix != kind[1]:
        raise RefusedTableError(f"{path.name} is {kind[0]}: give its name the ending {kind[1]}")
    try:
        # Bags of ROS 2 before Iron hold no definitions; those of common types have not changed.
        known = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
        reader = rosbags.AnyReader([path], default_typestore=known)
        reader.open()
    except Exception as error:  # rosbags raises errors of many kinds for damaged files
        raise _damaged(path, error) from error
    try:
        topics = {
            name: str(info.msgtype).replace("/msg/", "/") for name, info in reader.topics.items()
        }
        yield Messages(topics, lambda topic: _read_ros(path, reader, topic))
    finally:
        reader.close()


def _read_ros(path: Path, reader: Any, topic: str) -> Iterator[tuple[int, Any]]:
    connections = [one for one in reader.connections if one.topic == topic]
    try:
        for connection, received_ns, raw in reader.messages(connections=connections):
            yield received_ns, reader.deserialize(raw, connection.msgtype)
    except Exception as error:  # rosbags raises errors of many kinds for damaged files
        raise _damaged(path, error) from error


def _damaged(path: Path, error: Exception) -> RefusedTableError:
    remedy = "rosbag reindex" if path.suffix == ".bag" else "mcap recover, or ros2 bag reindex"
    return RefusedTableError(
        f"{path.name} is {_kind(path)}, but cannot be read: {str(error).rstrip('.')}. If it was cut off "
        f"while it was written, repair it ({remedy})"
    )


def _open_json(path: Path) -> Messages | None:
    """An MCAP file of JSON messages; None if the file is another kind.

    Raises:
        RefusedTableError: the file is cut off, or its messages are neither ROS's nor JSON.
    """
    with path.open("rb") as file:
        if file.read(len(MCAP_MARK)) != MCAP_MARK:
            return None
        file.seek(max(path.stat().st_size - len(MCAP_MARK), 0))
        if file.read() != MCAP_MARK:
            raise RefusedTableError(
                f"{path.name} is an MCAP (rosbag) file: it is cut off at its end. Repair it with mcap recover"
            )
    channels = _read_channels(path)
    kinds = {encoding for encoding, _ in channels.values()}
    if kinds <= {"cdr", "ros1"}:
        return None
    readable = {topic: kind for topic, (encoding, kind) in channels.items() if encoding == "json"}
    if not readable:
        raise RefusedTableError(
            f"{path.name} is an MCAP (rosbag) file of {', '.join(sorted(kinds)) or 'no'} messages; only "
            f"those of ROS and JSON are read: {EXPORT}"
        )
    return Messages(readable, lambda topic: _read_json(path, topic))


def _read_channels(path: Path) -> dict[str, tuple[str, str]]:
    """Encoding and type of the messages of each topic of an MCAP file."""
    try:
        with path.open("rb") as file:
            summary = make_reader(file).get_summary()
    except (McapError, ValueError) as error:
        raise _damaged(path, error) from error
    if summary is None:
        return {}
    return {
        channel.topic: (
            channel.message_encoding,
            schema.name if (schema := summary.schemas.get(channel.schema_id)) else "no type",
        )
        for channel in summary.channels.values()
    }


def _read_json(path: Path, topic: str) -> Iterator[tuple[int, Any]]:
    try:
        with path.open("rb") as file:
            for _, _, message in make_reader(file).iter_messages(topics=[topic]):
                yield message.log_time, json.loads(message.data)
    except (McapError, ValueError) as error:
        raise _damaged(path, error) from error
