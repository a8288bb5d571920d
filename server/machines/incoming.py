"""The border to the machines: size, shape and range of what they send, checked before anything uses it.

A machine's message is refused as a whole. The router drops oversized and too frequent messages before they
get here (runtime.link.zenoh_config, with the same bounds).
"""

import math
from collections.abc import Iterable
from typing import TypeVar

from pydantic import BaseModel, ValidationError

from machine.channels import KEYS
from machine.errors import DownrangeError
from machine.messages import CommandReply, EventBatch, JointStream, MachineState

_ModelT = TypeVar("_ModelT", bound=BaseModel)

MAX_EVENT_COUNT = 512
"""Events in one batch."""
MAX_TEXT_COUNT = 4096
"""Characters of one text of a message."""
MAX_CHECK_COUNT = 64
MAX_EPOCH_COUNT = 2**31 - 1
"""Lease epochs count changes of hands: a higher one is no epoch of this server."""
MAX_COUNT = 2**53
"""Largest counter; JSON numbers above it are not exact in every reader."""
MAX_TIME_NS = 2**62
"""146 years of a monotonic clock; a database column holds twice as much."""
MAX_POSITION = 1e3
"""Of a joint, rad or m."""


class IncomingError(DownrangeError):
    """A machine's message that is refused."""

    code = "incoming"


def read_state(payload: bytes, machine_id: str) -> MachineState:
    """A machine's state.

    Raises:
        IncomingError: too large, unreadable, out of range, or another machine's.
    """
    state = _read("state", MachineState, payload)
    _same(machine_id, state.machine_id)
    _count("epoch_count", state.epoch_count, MAX_EPOCH_COUNT)
    _count("t_mono_ns", state.t_mono_ns, MAX_TIME_NS)
    for name in ("outbox_count", "recorder_dropped_count"):
        _count(name, getattr(state, name), MAX_COUNT)
    _positions(state.joint_position_rad_m)
    if len(state.checks) > MAX_CHECK_COUNT or len(state.policy_sha256) > MAX_CHECK_COUNT:
        raise IncomingError(f"{len(state.checks)} checks, at most {MAX_CHECK_COUNT} are taken")
    _texts(state)
    return state


def read_joints(payload: bytes, machine_id: str) -> JointStream:
    """Joint positions for the 3D view.

    Raises:
        IncomingError: too large, unreadable, out of range, or another machine's.
    """
    joints = _read("joints", JointStream, payload)
    _same(machine_id, joints.machine_id)
    _count("t_mono_ns", joints.t_mono_ns, MAX_TIME_NS)
    _positions(joints.joint_position_rad_m)
    if joints.ball_position_m is not None:
        _positions(joints.ball_position_m)
    return joints


def read_batch(payload: bytes, machine_id: str) -> EventBatch:
    """Events of a machine's outbox.

    Raises:
        IncomingError: too large, unreadable, out of range, or another machine's.
    """
    batch = _read("events", EventBatch, payload)
    if len(batch.events) > MAX_EVENT_COUNT:
        raise IncomingError(f"{len(batch.events)} events, at most {MAX_EVENT_COUNT} are taken")
    _same(machine_id, batch.machine_id)
    for event in batch.events:
        _same(machine_id, event.machine_id)
        _count("sequence_count", event.sequence_count, MAX_COUNT)
        _count("t_mono_ns", event.t_mono_ns, MAX_TIME_NS)
        for name in ("boot_id", "throw_id", "plan_id"):
            text = getattr(event, name)
            if text is not None and len(text) > 64:
                raise IncomingError(f"{name} of {len(text)} characters, at most 64 are taken")
            if text is not None and "\x00" in text:
                raise IncomingError(f"{name} holds a NUL character, which no database takes")
        _numbers(event.data)
    return batch


def read_reply(payload: bytes) -> CommandReply:
    """A machine's answer to a command.

    Raises:
        IncomingError: too large, unreadable or out of range.
    """
    reply = _read("command", CommandReply, payload)
    _count("epoch_count", reply.epoch_count, MAX_EPOCH_COUNT)
    _texts(reply)
    return reply


def _numbers(value: object) -> None:
    """Refuse whole numbers, at any depth, that no database column holds."""
    if isinstance(value, int) and abs(value) > MAX_TIME_NS:
        raise IncomingError(f"data holds a number above {MAX_TIME_NS}")
    inside = value.values() if isinstance(value, dict) else value
    if isinstance(inside, Iterable) and not isinstance(inside, str):
        for item in inside:
            _numbers(item)


def check_size(channel: str, size_bytes: int) -> None:
    """Refuse a message by its size alone, before its bytes are copied.

    Raises:
        IncomingError: too large for its channel.
    """
    maximum = KEYS[channel].max_bytes
    if size_bytes > maximum:
        raise IncomingError(f"{channel} of {size_bytes} bytes, at most {maximum} are taken")


def _read(channel: str, kind: type[_ModelT], payload: bytes) -> _ModelT:
    check_size(channel, len(payload))
    try:
        return kind.model_validate_json(payload)
    except ValidationError as error:
        # Not the error's own text: it quotes what was sent.
        first = error.errors(include_input=False, include_url=False)[0]
        place = ".".join(str(part) for part in first["loc"])[:80]
        raise IncomingError(
            f"{channel} cannot be read: {error.error_count()} faults, first {place}: {first['type']}"
        ) from error


def _same(expected: str, found: str) -> None:
    if found != expected:
        raise IncomingError(f"the message speaks for {found[:40]!r}, its key for {expected}")


def _count(name: str, value: int, maximum: int) -> None:
    if not 0 <= value <= maximum:
        raise IncomingError(f"{name} is {value}, 0 to {maximum} are taken")


def _positions(values: tuple[float, ...]) -> None:
    if not all(math.isfinite(value) and abs(value) <= MAX_POSITION for value in values):
        raise IncomingError(f"positions {values} are beyond {MAX_POSITION:.0f} rad or m")


def _texts(message: BaseModel) -> None:
    for name in type(message).model_fields:
        value = getattr(message, name)
        if isinstance(value, str) and len(value) > MAX_TEXT_COUNT:
            raise IncomingError(f"{name} has {len(value)} characters, at most {MAX_TEXT_COUNT}")
