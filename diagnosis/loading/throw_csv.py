"""Whole throws as CSV: the channels of a throw log (docs/throw_csv.md) as columns, written and read.

A file holds one throw, or several with a column of throw ids. Control, IMU and load tracker have time
columns of their own, so that their columns differ in length and end in empty cells. A file that lacks
required columns is refused with their names.
"""

import csv
import io
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from machine.conventions import ACTIVE_JOINTS, CONTROL_PERIOD_S, JOINT_NAMES, Array
from machine.errors import LogError
from machine.telemetry import BALL_ROW, CONTROL_ROW, IMU_ROW
from runtime.records.log_reader import read_throw_log
from runtime.records.throw_log import (
    RESULT_RECORD,
    ThrowLog,
    impact_from_json,
    impact_values,
)

LOG_SUFFIXES: Final = (".mcap", ".csv")
THROW_COLUMN: Final = "throw_id"
"""Column of throw ids in a file of several throws."""
THROWS_KEY: Final = "throws"
"""Header line with the metadata of each throw (target, impact), by throw id."""
WITHOUT_IMU: Final = "without_imu"
"""Metadata of a throw whose file has no IMU columns."""
TRUTH: Final = {"true": 1.0, "false": 0.0}
MAX_BYTES: Final = 200_000_000
"""Largest file that is read; a throw has about 2 MB."""
MAX_NS: Final = 4_000_000_000_000_000_000
"""Largest time stamp: 126 years, so that differences fit into 64 bits."""
CONTEXT_KEYS: Final = (
    *("throw_id", "machine_id", "mode", "target", "model_sha256", "calibration", "twin_profile"),
    RESULT_RECORD,
)


def _unit(joint: str) -> str:
    return "m" if joint == "telescope" else "rad"


def _per_joint(joints: Sequence[str], middle: str, after: str = "") -> list[str]:
    return [f"{joint}_{middle}_{_unit(joint)}{after}" for joint in joints]


CONTROL_COLUMNS: Final[Mapping[str, list[str]]] = {
    "tick_count": ["tick_count"],
    "motion_code_count": ["motion_code_count"],
    "sensor_position_rad_m": _per_joint(ACTIVE_JOINTS, "sensor_position"),
    "sensor_velocity_rad_m_per_s": _per_joint(ACTIVE_JOINTS, "sensor_velocity", "_per_s"),
    "joint_position_rad_m": _per_joint(JOINT_NAMES, "position"),
    "joint_velocity_rad_m_per_s": _per_joint(JOINT_NAMES, "velocity", "_per_s"),
    "velocity_request_rad_m_per_s": _per_joint(ACTIVE_JOINTS, "velocity_request", "_per_s"),
    "velocity_reference_rad_m_per_s": _per_joint(ACTIVE_JOINTS, "velocity_reference", "_per_s"),
    "valve_requested_ratio": [f"{joint}_valve_requested_ratio" for joint in ACTIVE_JOINTS],
    "valve_applied_ratio": [f"{joint}_valve_applied_ratio" for joint in ACTIVE_JOINTS],
    "safety_code_count": ["safety_code_count"],
    "gripper_open_commanded": ["gripper_open_commanded_ratio"],
    "payload_held": ["payload_held_ratio"],
    "supply_pressure_pa": ["supply_pressure_pa"],
}
"""Columns of each field of a control row, named as in the console's time series."""
IMU_COLUMNS: Final[Mapping[str, list[str]]] = {
    "gyro_rad_per_s": [f"gyro_{axis}_rad_per_s" for axis in "xyz"],
    "accel_m_per_s2": [f"accel_{axis}_m_per_s2" for axis in "xyz"],
}
BALL_COLUMNS: Final[Mapping[str, list[str]]] = {"position_m": [f"ball_{axis}_m" for axis in "xyz"]}
OPTIONAL_FIELDS: Final = frozenset(
    {
        *("tick_count", "velocity_request_rad_m_per_s", "velocity_reference_rad_m_per_s"),
        *("valve_requested_ratio", "safety_code_count", "payload_held", "supply_pressure_pa"),
    }
)


def read_logs(path: Path, read_log: Callable[[Path], ThrowLog] = read_throw_log) -> list[ThrowLog]:
    """Read the throws of a file of either kind, by its suffix; MCAP holds one.

    Args:
        path: the file.
        read_log: reads MCAP files.

    Raises:
        LogError: it cannot be used.
    """
    return read_throw_csv(path) if path.suffix.lower() == ".csv" else [read_log(path)]


def throw_csv(log: ThrowLog) -> str:
    """A throw log as the text of a CSV file."""
    context = {key: log.metadata[key] for key in CONTEXT_KEYS if key in log.metadata}
    if log.impact is not None:
        context["impact"] = impact_values(log.impact)
    start_ns = int(log.control["t_mono_ns"][0]) if len(log.control) else 0
    context["start_t_mono_ns"] = start_ns
    context["impact_t_mono_ns"] = log.impact_t_mono_ns
    columns: dict[str, list[str]] = {}
    times = {"t_s": log.control["t_mono_ns"], "sensor_t_s": log.control["sensor_t_mono_ns"]}
    times |= {"imu_t_s": log.imu["t_mono_ns"], "ball_t_s": log.ball["t_mono_ns"]}
    for name, stamps in times.items():
        columns[name] = [_seconds(int(stamp) - start_ns) for stamp in stamps]
    groups = ((log.control, CONTROL_COLUMNS), (log.imu, IMU_COLUMNS), (log.ball, BALL_COLUMNS))
    for rows, fields in groups:
        for field, names in fields.items():
            values = rows[field].astype(np.float64).reshape(len(rows), len(names))
            for index, name in enumerate(names):
                columns[name] = [
                    repr(v) if np.isfinite(v) else "" for v in values[:, index].tolist()
                ]
    text = io.StringIO()
    for key, value in context.items():
        text.write(f"# {key}: {json.dumps(value)}\n")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    longest = max(len(cells) for cells in columns.values())
    padded = [cells + [""] * (longest - len(cells)) for cells in columns.values()]
    writer.writerows(zip(*padded, strict=True))
    return text.getvalue()


def read_throw_csv(path: Path) -> list[ThrowLog]:
    """Read the throws of a CSV file, in the order of their first rows.

    Raises:
        LogError: not such a file, or columns are missing.
    """
    try:
        if path.stat().st_size > MAX_BYTES:
            raise LogError(
                f"{path.name} is larger than {MAX_BYTES / 1e6:g} MB: give one file a throw"
            )
        lines = path.read_text(encoding="utf-8-sig", errors="replace").splitlines()
    except OSError as error:
        raise LogError(f"cannot open {path}: {error.strerror}") from error
    shared = _context(path, [line for line in lines if line.startswith("#")])
    own = _group(shared, THROWS_KEY, path)
    body = [line for line in lines if line.strip() and not line.startswith("#")]
    throws = _columns(path, body)
    unknown = ", ".join(sorted(set(own) - set(throws)))
    if unknown:
        raise LogError(
            f"the line '# {THROWS_KEY}' of {path.name} names throws without rows: {unknown}; its throws "
            f"are {', '.join(throws)}"
        )
    return [
        _throw(path, columns, _named(path, name, {**shared, **_group(own, name, path)}))
        for name, columns in throws.items()
    ]


def _named(path: Path, name: str, context: dict[str, Any]) -> dict[str, Any]:
    """With the throw's id: from its rows, else from the header lines, else the file's name."""
    return {"throw_id": path.stem} | context | ({THROW_COLUMN: name} if name else {})


def _throw(path: Path, columns: Mapping[str, Array], context: dict[str, Any]) -> ThrowLog:
    """One throw from its columns and header lines."""
    start_ns = _whole_ns(context, "start_t_mono_ns", path)
    control = _rows(CONTROL_ROW, columns, "t_s", CONTROL_COLUMNS, start_ns, path)
    ticks = columns["t_s"][: len(control)]
    sensed = columns.get("sensor_t_s", ticks)[: len(control)]
    sensed = np.where(np.isnan(sensed), ticks, sensed)
    control["sensor_t_mono_ns"] = start_ns + _nanoseconds(sensed, "sensor_t_s", path)
    if "tick_count" not in columns:
        passed = (control["t_mono_ns"] - control["t_mono_ns"][:1]) * 1e-9 / CONTROL_PERIOD_S
        control["tick_count"] = np.round(passed).astype(np.int64)
    impact = context.pop("impact", None)
    try:
        survey = None if impact is None else impact_from_json(impact)
    except (ValidationError, AttributeError) as error:
        raise LogError(f"the impact of {path.name} cannot be read: {impact!r}") from error
    ended = {"is_complete": True, **_group(context, RESULT_RECORD, path)}
    impact_ns = _whole_ns(context, "impact_t_mono_ns", path)
    has_imu = {WITHOUT_IMU: True} if "imu_t_s" not in columns else {}
    return ThrowLog(
        metadata={**context, **has_imu, RESULT_RECORD: ended},
        control=control,
        imu=_rows(IMU_ROW, columns, "imu_t_s", IMU_COLUMNS, start_ns, path),
        ball=_rows(BALL_ROW, columns, "ball_t_s", BALL_COLUMNS, start_ns, path),
        impact=survey,
        impact_t_mono_ns=impact_ns,
    )


def _group(context: dict[str, Any], key: str, path: Path) -> dict[str, Any]:
    """Take the object under a key out of the header lines; empty if there is none."""
    value: Any = context.pop(key, None)
    if value is None:
        return {}
    if not isinstance(value, dict):
        raise LogError(f"{key!r} above the columns of {path.name} is {value!r}; {{...}} is needed")
    return {str(name): item for name, item in cast(dict[Any, Any], value).items()}


def _whole_ns(context: dict[str, Any], key: str, path: Path) -> int:
    """Take a time in ns out of the header lines; 0 if there is none."""
    value: Any = context.pop(key, None) or 0
    if not isinstance(value, int | float) or not abs(value) < MAX_NS:
        raise LogError(f"{key!r} of {path.name} is {value!r}; whole nanoseconds are needed")
    return int(value)


def _nanoseconds(times_s: Array, column: str, path: Path) -> NDArray[np.int64]:
    """Seconds as whole nanoseconds."""
    largest = float(np.max(np.abs(times_s), initial=0.0))
    if largest > 1e-9 * MAX_NS:
        raise LogError(f"{path.name}: column {column} goes to {largest:.3g}; seconds are needed")
    return np.round(1e9 * times_s).astype(np.int64)


def _seconds(ns: int) -> str:
    """Nanoseconds as seconds, exactly."""
    return f"{'-' if ns < 0 else ''}{abs(ns) // 10**9}.{abs(ns) % 10**9:09d}"


def _context(path: Path, lines: Sequence[str]) -> dict[str, Any]:
    context: dict[str, Any] = {}
    for line in lines:
        key, found, value = line.lstrip("# ").partition(":")
        if not found:
            continue
        try:
            context[key.strip()] = json.loads(value)
        except ValueError as error:
            shown = f"# {key[:40]}".encode("ascii", "backslashreplace").decode()
            raise LogError(f"the line {shown!r} of {path.name} holds no JSON: {error}") from error
    return context


def _columns(path: Path, body: Sequence[str]) -> dict[str, dict[str, Array]]:
    """Columns of each throw, by its id; one throw without a column of ids has the id ""."""
    if len(body) < 2:
        raise LogError(f"{path.name} holds no rows: empty or cut off")
    try:
        header, *rows = csv.reader(body)
    except csv.Error as error:
        raise LogError(f"{path.name} is no table: {error}") from error
    names = [name.strip() for name in header]
    needed = [
        "t_s",
        *(n for f, ns in CONTROL_COLUMNS.items() if f not in OPTIONAL_FIELDS for n in ns),
    ]
    imu = ["imu_t_s", *(n for ns in IMU_COLUMNS.values() for n in ns)]
    needed += imu if any(name in names for name in imu) else []
    missing = [name for name in needed if name not in names]
    if missing:
        shown = ", ".join(missing[:6]) + (f" and {len(missing) - 6} more" if missing[6:] else "")
        raise LogError(
            f"{path.name} is no whole throw: {len(missing)} of {len(needed)} columns are missing ({shown}). "
            "docs/throw_csv.md lists them; one stage alone needs less (`downrange diagnose actuation`)"
        )
    padded = [(row + [""] * len(names))[: len(names)] for row in rows]
    place = names.index(THROW_COLUMN) if THROW_COLUMN in names else None
    labels = ["" if place is None else row[place].strip() for row in padded]
    throws: dict[str, dict[str, Array]] = {}
    for label in dict.fromkeys(labels):
        mine = [row for row, own in zip(padded, labels, strict=True) if own == label]
        cells = zip(*mine, strict=True)
        throws[label] = {
            n: np.array([_number(t) for t in column])
            for n, column in zip(names, cells, strict=True)
            if n != THROW_COLUMN
        }
    return throws


def _rows(
    kind: np.dtype[np.void],
    columns: Mapping[str, Array],
    time: str,
    fields: Mapping[str, Sequence[str]],
    start_ns: int,
    path: Path,
) -> NDArray[np.void]:
    """Rows of one channel: as many as its times; a channel without times is empty."""
    times = columns.get(time, np.zeros(0))
    known = np.flatnonzero(np.isfinite(times))
    count = int(known[-1]) + 1 if known.size else 0
    if known.size != count:
        raise LogError(f"{path.name}: {count - known.size} times in column {time} are missing")
    rows = np.zeros(count, dtype=kind)
    rows["t_mono_ns"] = start_ns + _nanoseconds(times[:count], time, path)
    for field, names in fields.items():
        cells = np.stack([columns.get(n, np.full(count, np.nan))[:count] for n in names], axis=1)
        if kind[field].base.kind != "f":
            cells = np.where(np.isnan(cells), 0.0, cells)
            most = np.iinfo(kind[field].base).max if kind[field].base.kind == "i" else np.inf
            largest = float(np.max(np.abs(cells), initial=0.0))
            # A double just below 2^63 does not exist: the largest whole number is one too many.
            if largest >= most:
                raise LogError(
                    f"{path.name}: {names[0]} goes to {largest:.3g}, a count below {most:.3g} is needed"
                )
        rows[field] = cells.reshape(rows[field].shape)
    return rows


def _number(text: str) -> float:
    """A cell as a number; NaN for other text."""
    word = text.strip().lower()
    if word in TRUTH:
        return TRUTH[word]
    try:
        return float(word)
    except ValueError:
        return float("nan")
