"""Which messages a browser may send to the 3D view: camera, clicks, drags of the target; no others.

viser trusts its clients (a crafted frame fires hidden controls or opens a public tunnel), so frames are
decoded, checked field by field and written anew; what is not listed here never reaches it.
"""

from typing import Annotated, Any, Final, Literal

import msgpack
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

MAX_FRAME_BYTES: Final = 4096
"""A camera message has about 400 bytes."""

Finite = Annotated[float, Field(allow_inf_nan=False, ge=-1e6, le=1e6)]
Vector = tuple[Finite, Finite, Finite]
Quaternion = tuple[Finite, Finite, Finite, Finite]
Pixels = Annotated[int, Field(ge=1, le=32768)]
Unit = Annotated[float, Field(allow_inf_nan=False, ge=-1.0, le=2.0)]
Wide = Annotated[float, Field(allow_inf_nan=False, ge=-100.0, le=100.0)]
ScreenPoint = tuple[Wide, Wide]
"""In pictures; a pointer that drags may leave the picture."""


class MalformedFrameError(Exception):
    """A frame that no viewer page sends: not msgpack, too long, or without a type."""


class _Frame(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class CameraFrame(_Frame):
    """Where the browser's camera is; sent while it moves."""

    type: Literal["ViewerCameraMessage"]
    wxyz: Quaternion
    position: Vector
    fov: Annotated[float, Field(allow_inf_nan=False, gt=0.0, lt=3.2)]
    near: Annotated[float, Field(allow_inf_nan=False, gt=0.0, le=1e6)]
    far: Annotated[float, Field(allow_inf_nan=False, gt=0.0, le=1e9)]
    image_height: Pixels
    image_width: Pixels
    look_at: Vector
    up_direction: Vector


class ClickFrame(_Frame):
    """A click on the scene without a modifier key: a ray."""

    type: Literal["ScenePointerMessage"]
    event_type: Literal["click"]
    ray_origin: Vector
    ray_direction: Vector
    screen_pos: Annotated[tuple[tuple[Unit, Unit]], Field()]
    modifier: None


class DragFrame(_Frame):
    """The pointer while the target's mark is dragged with the left button or a finger."""

    type: Literal["SceneNodeDragMessage"]
    phase: Literal["start", "update", "end"]
    name: Literal["/target/handle"]
    instance_index: None
    start_position: Vector
    start_screen_pos: ScreenPoint
    end_position: Vector
    end_screen_pos: ScreenPoint
    button: Literal["left"]
    modifier: None
    owner: Annotated[str, Field(max_length=128)] = ""


_ALLOWED: Final = TypeAdapter[CameraFrame | ClickFrame | DragFrame](
    Annotated[CameraFrame | ClickFrame | DragFrame, Field(discriminator="type")]
)


def filter_frame(raw: bytes) -> bytes | None:
    """Return the frame to pass on, written anew, or None when it is to be dropped.

    Args:
        raw: one binary WebSocket message from a browser.

    Raises:
        MalformedFrameError: it cannot come from the viewer page; the socket is to be closed.
    """
    if len(raw) > MAX_FRAME_BYTES:
        raise MalformedFrameError(f"{len(raw)} bytes, {MAX_FRAME_BYTES} allowed")
    try:
        decoded: Any = msgpack.unpackb(raw, strict_map_key=True, max_ext_len=0)
    except (ValueError, msgpack.exceptions.UnpackException, RecursionError) as error:
        raise MalformedFrameError("not msgpack") from error
    if not isinstance(decoded, dict) or not isinstance(decoded.get("type"), str):
        raise MalformedFrameError("no message type")
    try:
        frame = _ALLOWED.validate_python(decoded)
    except ValidationError:
        return None
    return bytes(msgpack.packb(frame.model_dump()) or b"")
