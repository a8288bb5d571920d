import contextlib
import math
from typing import Any

import msgpack
import pytest
import viser._messages as wire
from hypothesis import given
from hypothesis import strategies as st

from server.viewer_proxy.frames import MAX_FRAME_BYTES, MalformedFrameError, filter_frame
from tests.cases import each
from tests.server.viewer_app import CAMERA, click, drag

CLICK = click((0.0, 0.0, 5.0), (0.3, 0.0, -1.0))
DRAG = drag("update", (8.0, 0.0, 0.0))
ALLOWED = {"ViewerCameraMessage", "ScenePointerMessage", "SceneNodeDragMessage"}
ALL_TYPES = sorted(wire.Message._subclass_from_type_string())


def passed(message: object) -> Any:
    frame = filter_frame(msgpack.packb(message))
    return None if frame is None else msgpack.unpackb(frame)


@each("message", [CAMERA, CLICK, DRAG])
def test_what_the_page_sends_passes_and_viser_reads_it(message: dict[str, Any]) -> None:
    frame = filter_frame(msgpack.packb(message))
    assert frame is not None
    read = wire.Message.deserialize(frame)
    assert type(read).__name__ == message["type"]
    assert msgpack.unpackb(frame) == message


def test_integers_of_javascript_pass_as_numbers() -> None:
    assert passed({**CAMERA, "position": [3, 0, 12]})["position"] == [3.0, 0.0, 12.0]


def test_no_other_message_of_viser_passes() -> None:
    leaked = [
        name
        for name in ALL_TYPES
        if name not in ALLOWED
        for message in (
            {"type": name},
            {**CAMERA, "type": name},
            {"type": name, "uuid": "x", "updates": {"value": True}},
        )
        if passed(message) is not None
    ]
    assert not leaked


@each(
    "change",
    [
        {"name": "/live"},
        {"phase": "other"},
        {"button": "right"},
        {"end_position": [0.0, float("nan"), 0.0]},
        {"instance_index": 3},
        {"uuid": "x"},
    ],
)
def test_only_drags_of_the_target_pass(change: dict[str, Any]) -> None:
    assert passed({**DRAG, **change}) is None


def test_a_camera_with_a_wrong_field_is_dropped() -> None:
    wrong = [None, "x", math.nan, math.inf, [1.0], {}, [math.nan] * 4, -1e300]
    leaked = [
        (field, value)
        for field in CAMERA
        if field != "type"
        for value in wrong
        if passed({**CAMERA, field: value}) is not None
    ]
    assert not leaked


def test_a_click_with_a_wrong_or_missing_field_is_dropped() -> None:
    changes: list[dict[str, Any]] = [
        {"event_type": "rect-select"},
        {"modifier": "shift"},
        {"ray_origin": None},
        {"ray_direction": [0.0, 0.0]},
        {"ray_direction": [0.0, 0.0, math.nan]},
        {"screen_pos": []},
        {"screen_pos": [[0.5, 0.5], [0.6, 0.6]]},
        {"extra": 1},
    ]
    messages = [{**CLICK, **change} for change in changes]
    messages += [
        {k: v for k, v in CLICK.items() if k != field} for field in CLICK if field != "type"
    ]
    assert not [message for message in messages if passed(message) is not None]
    with pytest.raises(MalformedFrameError):
        passed({k: v for k, v in CLICK.items() if k != "type"})


def test_what_no_page_sends_closes_the_socket() -> None:
    frames: list[bytes] = [
        b"",
        b"\xc1",
        b"\x81",
        msgpack.packb([1, 2]),
        msgpack.packb({"type": 7}),
        msgpack.packb({1: "type"}),
        msgpack.packb({"type": ["ViewerCameraMessage"]}),
        msgpack.packb(CAMERA) + b"\x00",
        msgpack.packb({"type": "x", "blob": bytes(MAX_FRAME_BYTES)}),
        b"\x91" * 3000,
        msgpack.packb({"type": msgpack.ExtType(1, b"x")}),
    ]
    for raw in frames:
        with pytest.raises(MalformedFrameError):
            filter_frame(raw)
            pytest.fail(f"{raw[:40]!r} passed")


@given(raw=st.binary(max_size=300))
def test_random_bytes_never_pass(raw: bytes) -> None:
    with contextlib.suppress(MalformedFrameError):
        assert filter_frame(raw) is None
