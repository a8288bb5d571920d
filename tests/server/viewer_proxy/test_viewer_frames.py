import contextlib
import math
from typing import Any

import msgpack
import pytest
import viser._messages as wire
from hypothesis import given
from hypothesis import strategies as st

from server.viewer_proxy.frames import MAX_FRAME_BYTES, MalformedFrameError, filter_frame
from tests.server.viewer_app import CAMERA, click

CLICK = click((0.0, 0.0, 5.0), (0.3, 0.0, -1.0))
ALLOWED = {"ViewerCameraMessage", "ScenePointerMessage"}
ALL_TYPES = sorted(wire.Message._subclass_from_type_string())


def passed(message: object) -> Any:
    frame = filter_frame(msgpack.packb(message))
    return None if frame is None else msgpack.unpackb(frame)


@pytest.mark.parametrize("message", [CAMERA, CLICK])
def test_what_the_page_sends_passes_and_viser_reads_it(message: dict[str, Any]) -> None:
    frame = filter_frame(msgpack.packb(message))
    assert frame is not None
    read = wire.Message.deserialize(frame)
    assert type(read).__name__ == message["type"]
    assert msgpack.unpackb(frame) == message


def test_integers_of_javascript_pass_as_numbers() -> None:
    assert passed({**CAMERA, "position": [3, 0, 12]})["position"] == [3.0, 0.0, 12.0]


@pytest.mark.parametrize("name", [name for name in ALL_TYPES if name not in ALLOWED])
def test_no_other_message_of_viser_passes(name: str) -> None:
    assert passed({"type": name}) is None
    assert passed({**CAMERA, "type": name}) is None
    assert passed({"type": name, "uuid": "x", "updates": {"value": True}}) is None


@pytest.mark.parametrize("field", [name for name in CAMERA if name != "type"])
@pytest.mark.parametrize(
    "value", [None, "x", math.nan, math.inf, [1.0], {}, [math.nan] * 4, -1e300]
)
def test_a_camera_with_a_wrong_field_is_dropped(field: str, value: object) -> None:
    assert passed({**CAMERA, field: value}) is None


@pytest.mark.parametrize(
    "change",
    [
        {"event_type": "rect-select"},
        {"modifier": "shift"},
        {"ray_origin": None},
        {"ray_direction": [0.0, 0.0]},
        {"ray_direction": [0.0, 0.0, math.nan]},
        {"screen_pos": []},
        {"screen_pos": [[0.5, 0.5], [0.6, 0.6]]},
        {"extra": 1},
    ],
)
def test_a_click_with_a_wrong_field_is_dropped(change: dict[str, Any]) -> None:
    assert passed({**CLICK, **change}) is None


@pytest.mark.parametrize("field", sorted(CLICK))
def test_a_click_without_a_field_does_not_pass(field: str) -> None:
    rest = {k: v for k, v in CLICK.items() if k != field}
    if field == "type":
        with pytest.raises(MalformedFrameError):
            passed(rest)
    else:
        assert passed(rest) is None


@pytest.mark.parametrize(
    "raw",
    [
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
    ],
)
def test_what_no_page_sends_closes_the_socket(raw: bytes) -> None:
    with pytest.raises(MalformedFrameError):
        filter_frame(raw)


@given(raw=st.binary(max_size=300))
def test_random_bytes_never_pass(raw: bytes) -> None:
    with contextlib.suppress(MalformedFrameError):
        assert filter_frame(raw) is None
