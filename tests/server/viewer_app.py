"""A minimal service round the 3D view, and a client that speaks the view's protocol without a browser."""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import msgpack
import uvicorn
import viser
import zstandard
from fastapi import FastAPI
from fastapi.responses import HTMLResponse
from starlette.requests import HTTPConnection
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin, Subprotocol

from machine.spec import load_spec
from server.viewer.pick import PickRefusedError
from server.viewer.scene import ViewerScene
from server.viewer_proxy.proxy import ViewerProxy
from tests.waiting import until

PROTOCOL = f"viser-v{viser.__version__}"
PARENT = """<!doctype html><html><head><link rel="icon" href="data:,"></head>
<body style="margin:0"><iframe id="view" src="/viewer/" style="border:0;width:100vw;height:100vh">
</iframe><script>
window.states = []; window.keys = [];
addEventListener("keydown", (event) => keys.push(event.code));
addEventListener("message", ({ data }) => {
  if (data.type === "keydown") keys.push(data.init.code);
  else if (!data.type) states.push(data);
});
</script></body></html>"""


@dataclass(frozen=True)
class Session:
    session_id: str


@dataclass
class ViewerApp:
    """The view behind its proxy on a free port; cookie ``sid`` names the session."""

    picks: list[tuple[str, tuple[float, float, float]]] = field(default_factory=list)
    refusals: list[PickRefusedError] = field(default_factory=list)
    ended: set[str] = field(default_factory=set)

    def __post_init__(self) -> None:
        self.scene = ViewerScene(
            load_spec(),
            lambda session_id, point: self.picks.append((session_id, point)),
            on_pick_refused=lambda _, refusal: self.refusals.append(refusal),
            shadows=False,
        )
        self.scene.start()
        self.proxy = ViewerProxy(self.scene, self._session_of)
        app = FastAPI()
        app.include_router(self.proxy.router)
        app.add_api_route("/", lambda: HTMLResponse(PARENT))
        config = uvicorn.Config(
            app, host="127.0.0.1", port=0, log_level="error", ws_per_message_deflate=False
        )
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(target=self._server.run, daemon=True)
        self._thread.start()
        until(lambda: self._server.started, "the test service to start")
        self.port: int = self._server.servers[0].sockets[0].getsockname()[1]

    async def _session_of(self, connection: HTTPConnection) -> Session | None:
        session_id = connection.cookies.get("sid")
        return None if session_id is None or session_id in self.ended else Session(session_id)

    @property
    def origin(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def close(self) -> None:
        self._server.should_exit = True
        self._thread.join(timeout=30.0)
        self.scene.close()


CAMERA: dict[str, Any] = {
    "type": "ViewerCameraMessage",
    "wxyz": [1.0, 0.0, 0.0, 0.0],
    "position": [-8.0, -14.0, 8.0],
    "fov": 0.66,
    "near": 0.01,
    "far": 1000.0,
    "image_height": 800,
    "image_width": 1280,
    "look_at": [4.0, 0.0, 1.0],
    "up_direction": [0.0, 0.0, 1.0],
}


def click(
    origin: tuple[float, float, float], direction: tuple[float, float, float]
) -> dict[str, Any]:
    return {
        "type": "ScenePointerMessage",
        "event_type": "click",
        "ray_origin": list(origin),
        "ray_direction": list(direction),
        "screen_pos": [[0.5, 0.5]],
        "modifier": None,
    }


def drag(phase: str, to: tuple[float, float, float], owner: str = "") -> dict[str, Any]:
    """The target's mark dragged to where the pointer is over a point; a page echoes the mark's owner."""
    return {
        "type": "SceneNodeDragMessage",
        "phase": phase,
        "name": "/target/handle",
        "instance_index": None,
        "start_position": list(to),
        "start_screen_pos": [0.5, 0.5],
        "end_position": list(to),
        "end_screen_pos": [0.5, 0.5],
        "button": "left",
        "modifier": None,
        "owner": owner,
    }


@dataclass(frozen=True)
class Port:
    """A service of another process."""

    port: int

    @property
    def origin(self) -> str:
        return f"http://127.0.0.1:{self.port}"


class ViewClient:
    """What viser's page does on the wire: sends its camera, reads batches of messages."""

    def __init__(
        self, app: ViewerApp | Port, session_id: str | None = "s1", origin: str | None = None
    ) -> None:
        headers = {} if session_id is None else {"Cookie": f"sid={session_id}"}
        self.socket: ClientConnection = connect(
            f"ws://127.0.0.1:{app.port}/viewer",
            origin=Origin(app.origin if origin is None else origin),
            subprotocols=[Subprotocol(PROTOCOL)],
            additional_headers=headers,
            compression=None,
            max_size=None,
            proxy=None,
        )
        self.messages: list[dict[str, Any]] = []
        self.nodes: dict[str, dict[str, Any]] = {}

    def send(self, message: object) -> None:
        self.socket.send(msgpack.packb(message))

    def read(self, timeout_s: float = 60.0) -> list[dict[str, Any]]:
        raw = self.socket.recv(timeout=timeout_s)
        assert isinstance(raw, bytes)
        size, packed = (int.from_bytes(raw[i : i + 8], "little") for i in (0, 8))
        plain = zstandard.ZstdDecompressor().decompress(raw[16 : 16 + packed], max_output_size=size)
        batch: list[dict[str, Any]] = msgpack.unpackb(plain)["messages"]
        for message in batch:
            self._note(message)
        self.messages += batch
        return batch

    def _note(self, message: dict[str, Any]) -> None:
        name = message.get("name")
        if name is None:
            return
        if message["type"] == "RemoveSceneNodeMessage":
            for path in [p for p in self.nodes if p == name or p.startswith(f"{name}/")]:
                del self.nodes[path]
        elif "props" in message:
            self.nodes[name] = {**message["props"], "type": message["type"], "visible": True}
        elif name in self.nodes:
            node = self.nodes[name]
            node.update(message.get("updates", {}))
            node.update({k: message[k] for k in ("wxyz", "position", "visible") if k in message})

    def until(self, is_true: Callable[[], object], what: str, timeout_s: float = 60.0) -> None:
        deadline_s = time.monotonic() + timeout_s
        while not is_true():
            try:
                self.read(max(0.01, deadline_s - time.monotonic()))
            except TimeoutError as error:
                raise AssertionError(f"Waited {timeout_s} s for {what}") from error

    def close(self) -> None:
        self.socket.close()
