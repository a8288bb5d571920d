"""The viser server of the 3D view: loopback only, no share tunnel, reached only through our proxy.

viser 1.1.1 by itself takes any origin, any path and requests for a public tunnel; this module is the
one place that touches its private parts, and tests/server/viewer/test_viewer_server.py holds it to the
pinned version.
"""

import contextlib
import hmac
import io
import secrets
from typing import Any

import viser
from viser._messages import SetOrientationMessage

SESSION_HEADER = "X-Downrange-Session"
SECRET_HEADER = "X-Downrange-Viewer-Secret"
TUNNEL_MESSAGES = ("ShareUrlRequest", "ShareUrlDisconnect")


class ViewerServer:
    """A viser server on a free loopback port that admits connections with the process's secret only."""

    def __init__(self) -> None:
        self.secret = secrets.token_urlsafe(32)
        # viser prints a banner of its own; a service logs, it does not print.
        with contextlib.redirect_stdout(io.StringIO()):
            self.server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
        self._close_tunnel()
        self._websockets.on_client_connect(self._admit)

    @property
    def _websockets(self) -> Any:
        server: Any = self.server
        return server._websock_server

    def _close_tunnel(self) -> None:
        handlers: dict[type, Any] = self._websockets._incoming_handlers
        for message_type in list(handlers):
            if message_type.__name__ in TUNNEL_MESSAGES:
                del handlers[message_type]

    def _connection(self, client_id: int) -> Any:
        return self._websockets._live_connections.get(client_id)

    async def _admit(self, connection: Any) -> None:
        socket = self._connection(connection.client_id)
        given = "" if socket is None else socket.request.headers.get(SECRET_HEADER, "")
        if socket is not None and not hmac.compare_digest(given, self.secret):
            await socket.close(4403, "not through the proxy")

    @property
    def port(self) -> int:
        """Loopback port."""
        return self.server.get_port()

    def session_of(self, client_id: int) -> str | None:
        """Session id that the proxy put on this connection; None when it is gone or did not carry one."""
        socket = self._connection(client_id)
        if socket is None:
            return None
        headers = socket.request.headers
        if not hmac.compare_digest(headers.get(SECRET_HEADER, ""), self.secret):
            return None
        return headers.get(SESSION_HEADER)

    @staticmethod
    def is_open(client: viser.ClientHandle) -> bool:
        """Whether messages to this client can still be delivered."""
        handle: Any = client
        return not handle._websock_connection.get_message_buffer().done

    def stop(self) -> None:
        """Close all connections and stop the server's threads."""
        with contextlib.redirect_stdout(io.StringIO()):
            self.server.stop()


def send_orientation(
    scene: viser.SceneApi, name: str, wxyz: tuple[float, float, float, float]
) -> None:
    """Turn a node, without viser's comparison with its last pose, which costs more than the message."""
    api: Any = scene
    api._queue_scene_message(SetOrientationMessage(name, wxyz))
