"""The throw log in memory, and how its rows become JSON messages of an MCAP file and back.

docs/throw_log.md is the written specification. This module knows no files: recorder.py writes them,
log_reader.py reads them.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from machine.channels import LOG_CHANNELS
from machine.messages import EventKind, ImpactSurvey, MachineEvent
from machine.telemetry import BALL_ROW, CONTROL_ROW, IMU_ROW, POLICY_ROW

LOG_SCHEMA_VERSION: Final = 1
PROFILE: Final = "downrange"
"""MCAP header profile of our files."""
CONTEXT_RECORD: Final = "throw"
"""Metadata record at the start of the file: everything known when the throw began."""
RESULT_RECORD: Final = "result"
"""Metadata record at the end: how it ended; missing in a file that was cut off."""

ROW_TYPES: Final[dict[str, np.dtype[np.void]]] = {
    "control": CONTROL_ROW,
    "policy": POLICY_ROW,
    "imu": IMU_ROW,
    "ball": BALL_ROW,
}
"""Channels whose messages are rows of numbers."""


def _empty(name: str) -> NDArray[np.void]:
    return np.zeros(0, dtype=ROW_TYPES[name])


@dataclass(frozen=True, slots=True)
class ThrowLog:
    """One throw, complete enough to be diagnosed alone; rows in the order in which they were logged."""

    metadata: dict[str, Any]
    """throw_id, machine_id, mode, target, plan_hash, policy_sha256, model_sha256, twin_profile_version,
    software, calibration, spec, ...; under ``result`` how it ended."""
    control: NDArray[np.void] = field(default_factory=lambda: _empty("control"))
    """(ticks,) telemetry.CONTROL_ROW"""
    policy: NDArray[np.void] = field(default_factory=lambda: _empty("policy"))
    """(policy ticks,) telemetry.POLICY_ROW"""
    imu: NDArray[np.void] = field(default_factory=lambda: _empty("imu"))
    """(samples,) telemetry.IMU_ROW"""
    ball: NDArray[np.void] = field(default_factory=lambda: _empty("ball"))
    """(samples,) telemetry.BALL_ROW"""
    events: tuple[MachineEvent, ...] = ()
    impact: ImpactSurvey | None = None
    impact_t_mono_ns: int = 0
    """Time of the impact, machine clock; 0 = no impact was surveyed."""

    @property
    def is_complete(self) -> bool:
        """Whether the recorder closed the file; false for one that was cut off and recovered."""
        return bool(self.metadata.get(RESULT_RECORD, {}).get("is_complete", False))


def row_to_json(row: np.void) -> bytes:
    """One row as a JSON object with the row's field names; not-a-number and infinities become null."""
    names = row.dtype.names or ()
    return json.dumps(
        {name: _plain(row[name]) for name in names}, separators=(",", ":"), allow_nan=False
    ).encode()


def rows_from_json(name: str, messages: list[bytes]) -> NDArray[np.void]:
    """Rows of a channel from its messages.

    Fields that a message lacks become NaN (0 for counts); unknown fields are ignored, so that a reader
    reads what a newer writer of the same schema version adds.

    Raises:
        ValueError: a message is no JSON object, or a field has the wrong shape.
    """
    dtype = ROW_TYPES[name]
    rows = np.zeros(len(messages), dtype=dtype)
    if not messages:
        return rows
    decoded = [_object(message) for message in messages]
    for field_name in dtype.names or ():
        kind = dtype[field_name].base.kind
        missing: float | int = math.nan if kind == "f" else 0
        shape = dtype[field_name].shape
        blank = np.full(shape, missing).tolist() if shape else missing
        values = [item.get(field_name, blank) for item in decoded]
        if kind == "f":
            # float64 turns a JSON null (None) into NaN, inside nested lists too.
            values = [blank if value is None else value for value in values]
            column = np.array(values, dtype=np.float64)
        else:
            column = np.array(values)
        if column.shape != (len(messages), *shape):
            raise ValueError(
                f"field {field_name} of channel {name} has shape {column.shape[1:]}, not {shape}"
            )
        rows[field_name] = column
    return rows


def event_to_json(event: MachineEvent) -> bytes:
    """One event as JSON."""
    return event.model_dump_json().encode()


def events_from_json(messages: Sequence[bytes]) -> tuple[MachineEvent, ...]:
    """Events of the kinds that are known; others are a newer writer's additions.

    Raises:
        ValueError: an event does not fit the schema.
    """
    known = [m for m in messages if json.loads(m).get("kind") in set(EventKind)]
    return tuple(MachineEvent.model_validate_json(message) for message in known)


def impact_to_json(impact: ImpactSurvey, t_mono_ns: int) -> bytes:
    """The surveyed impact with its time, as JSON."""
    values = {"t_mono_ns": t_mono_ns, **impact_values(impact)}
    return json.dumps(values, separators=(",", ":")).encode()


def impact_values(impact: ImpactSurvey) -> dict[str, Any]:
    """The surveyed impact as JSON holds it: null where nobody knows how sure the survey is."""
    sd_m = impact.sd_m if math.isfinite(impact.sd_m) else None
    return {**impact.model_dump(mode="json"), "sd_m": sd_m}


def impact_from_json(values: Mapping[str, Any]) -> ImpactSurvey:
    """Inverse of `impact_values`; an `sd_m` that is null or missing is NaN.

    Raises:
        ValidationError: it does not fit the schema.
    """
    sd_m = values.get("sd_m")
    return ImpactSurvey.model_validate({**values, "sd_m": math.nan if sd_m is None else sd_m})


def metadata_to_text(values: Mapping[str, Any]) -> dict[str, str]:
    """MCAP metadata is text to text: each value as JSON, full precision."""
    return {key: json.dumps(value, separators=(",", ":")) for key, value in values.items()}


def metadata_from_text(values: Mapping[str, str]) -> dict[str, Any]:
    """Inverse of `metadata_to_text`; text that is no JSON is kept as it is."""
    found: dict[str, Any] = {}
    for key, text in values.items():
        try:
            found[key] = json.loads(text)
        except ValueError:
            found[key] = text
    return found


def channel_schema(name: str) -> dict[str, Any]:
    """JSON schema of a channel's messages, embedded in the file."""
    if name == "event":
        return MachineEvent.model_json_schema()
    if name == "impact":
        schema = ImpactSurvey.model_json_schema()
        schema["properties"]["t_mono_ns"] = {"type": "integer"}
        return schema
    dtype = ROW_TYPES[name]
    properties = {key: _field_schema(dtype[key]) for key in dtype.names or ()}
    return {
        "title": f"downrange.{name}",
        "description": f"{LOG_CHANNELS[name].topic}, one row; units stand in the names",
        "type": "object",
        "properties": properties,
        "required": list(properties),
    }


def _field_schema(dtype: np.dtype[Any]) -> dict[str, Any]:
    kinds = {"f": "number", "i": "integer", "b": "boolean"}
    scalar = {"type": kinds[dtype.base.kind]}
    if not dtype.shape:
        return scalar
    size = dtype.shape[0]
    return {"type": "array", "items": scalar, "minItems": size, "maxItems": size}


def _plain(value: Any) -> Any:
    plain = value.tolist()
    if isinstance(plain, list):
        return [_finite(item) for item in plain]
    return _finite(plain)


def _finite(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _object(message: bytes) -> dict[str, Any]:
    decoded = json.loads(message)
    if not isinstance(decoded, dict):
        raise ValueError("a row is not a JSON object")
    return decoded
