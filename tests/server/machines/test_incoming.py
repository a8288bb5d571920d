"""What machines send is refused as a whole when it is too large, malformed or out of range."""

import json
import uuid

import pytest

from machine.channels import KEYS
from machine.messages import ThrowState
from server.machines.incoming import (
    MAX_CHECK_COUNT,
    MAX_EVENT_COUNT,
    IncomingError,
    read_batch,
    read_joints,
    read_reply,
    read_state,
)
from tests.cases import each

STATE = {
    "machine_id": "m001",
    "boot_id": "b",
    "t_mono_ns": 1,
    "state": "disarmed",
    "epoch_count": 3,
    "joint_position_rad_m": [0.0] * 6,
    "payload_held": True,
    "stop_latched": False,
    "model_sha256": "0" * 64,
}
CHECK = {"check_id": "x", "passed": True, "severity": "info", "text": "ok"}
EVENT = {
    "machine_id": "m001",
    "boot_id": "b",
    "sequence_count": 1,
    "t_mono_ns": 1,
    "t_utc": "2026-01-01T00:00:00Z",
    "kind": "booted",
}


def dump(message: object) -> bytes:
    return json.dumps(message).encode()


def deep(levels: int) -> bytes:
    return b'{"data":' + b"[" * levels + b"]" * levels + b"}"


def test_what_a_machine_sends_every_day_is_taken() -> None:
    assert read_state(dump(STATE), "m001").state is ThrowState.DISARMED
    batch = {"machine_id": "m001", "boot_id": "b", "events": [EVENT] * 64}
    assert len(read_batch(dump(batch), "m001").events) == 64


@each(
    "change",
    [
        {"epoch_count": 2**63},
        {"epoch_count": -1},
        {"t_mono_ns": 2**63},
        {"t_mono_ns": -5},
        {"outbox_count": 2**60},
        {"joint_position_rad_m": [1e9] * 6},
        {"joint_position_rad_m": [0.0] * 5},
        {"checks": [CHECK] * (MAX_CHECK_COUNT + 1)},
        {"fault": "x" * 5000},
        {"software": "x" * KEYS["state"].max_bytes},
        {"machine_id": "m002"},
        {"state": "flying"},
    ],
)
def test_absurd_states_are_refused(change: dict[str, object]) -> None:
    with pytest.raises(IncomingError) as refused:
        read_state(dump(STATE | change), "m001")
    assert len(str(refused.value)) < 300


@each("payload", [b"", b"\xff", b"[]", b"null", b"NaN", deep(150), deep(100_000)])
def test_garbage_is_refused_by_every_reader(payload: bytes) -> None:
    for read in (read_state, read_joints, read_batch):
        with pytest.raises(IncomingError):
            read(payload, "m001")
    with pytest.raises(IncomingError):
        read_reply(payload)


@each(
    "events",
    [
        [EVENT] * (MAX_EVENT_COUNT + 1),
        [EVENT | {"sequence_count": 2**63}],
        [EVENT | {"t_mono_ns": 2**80}],
        [EVENT | {"machine_id": "m002"}],
        [EVENT | {"throw_id": "x" * 65}],
        [EVENT | {"plan_id": "x\x00"}],
        [EVENT | {"data": {"mode": "2d", "deployment_count": 2**63}}],
        [EVENT | {"data": {"x": [{"y": -(2**80)}]}}],
        [EVENT | {"data": {"x": "y" * KEYS["events"].max_bytes}}],
    ],
)
def test_absurd_batches_are_refused(events: list[dict[str, object]]) -> None:
    with pytest.raises(IncomingError):
        read_batch(dump({"machine_id": "m001", "boot_id": "b", "events": events}), "m001")


def test_an_absurd_epoch_reaches_neither_registry_nor_leases(running, machine, ada) -> None:
    registry = running.parts.registry
    before = registry.get("m001").state
    absurd = machine.state_message().model_dump(mode="json") | {"epoch_count": 2**63}
    refused = running.parts.metrics.unreadable_count
    count = refused._value.get()
    running.parts.link._take("m001", "state", dump(absurd))
    assert refused._value.get() == count + 1
    assert registry.get("m001").state.epoch_count >= before.epoch_count
    lease = ada.post("/machines/m001/lease").json()
    assert lease["epoch_count"] < 2**31
    ada.delete("/machines/m001/lease")


def test_one_machine_cannot_take_all_places_of_the_event_queue(running, machine) -> None:
    link = running.parts.link
    machine.keeps_events = True
    link._waiting["m001"] += 8
    try:
        payload = dump({"machine_id": "m001", "boot_id": uuid.uuid4().hex, "events": []})
        replies = list(machine.session.get(machine._key("events"), payload=payload, timeout=1.0))
        assert not [reply for reply in replies if reply.ok is not None]
    finally:
        link._waiting["m001"] -= 8
        machine.keeps_events = False
