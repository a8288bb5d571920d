"""Runs the web service until it is interrupted."""

import contextlib
import gc
import logging
import os
import signal
import socket
import sys
from collections.abc import Callable

import uvicorn
from fastapi import FastAPI

from machine.errors import DownrangeError, UsageError
from server.app import create_app
from server.limits.connections import IdleConnectionLimit, allow_open_files, timed_http_protocol
from server.settings import Settings

logger = logging.getLogger(__name__)

WEBSOCKET_MAX_BYTES = 16 * 1024
"""Of a message from a browser; the largest, of the 3D view's camera, may have 4 KiB."""
SHUTDOWN_S = 3
ACCEPT_COUNT = 16
"""Connections that the event loop accepts in one turn: a flood of new ones shares it with requests."""
QUEUE_COUNT = 2048
"""Connections that the system keeps waiting to be accepted."""


class Server(uvicorn.Server):
    """uvicorn that ends event streams first, and says when it is ready."""

    def __init__(
        self, config: uvicorn.Config, app: FastAPI, on_ready: Callable[[], None] | None
    ) -> None:
        super().__init__(config)
        self._app = app
        self._on_ready = on_ready

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start, then call `on_ready`."""
        await super().startup(sockets)
        for listener in sockets or ():
            # asyncio takes one number for both; the system's queue is to be longer than a turn.
            listener.listen(QUEUE_COUNT)
        if self.started and self._on_ready is not None:
            self._on_ready()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Streams never end by themselves; a browser that listens must not hold the server up."""
        parts = getattr(self._app.state, "parts", None)
        if parts is not None:
            parts.hub.close()
        await super().shutdown(sockets)


def open_socket(host: str, port: int) -> socket.socket:
    """Bind the server's address.

    Raises:
        UsageError: in use or not ours.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    # asyncio turns Nagle's algorithm off only where the protocol is named; with it every answer that
    # leaves in two parts waits 40 ms for an acknowledgement.
    listener = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((host, port))
    except OSError as error:
        listener.close()
        raise UsageError(
            f"port {port} on {host} cannot be used ({error.strerror}); another server may be "
            "running: stop it, or choose another port with DOWNRANGE_PORT"
        ) from error
    return listener


def make_server(
    settings: Settings, on_ready: Callable[[], None] | None = None
) -> tuple[Server, FastAPI]:
    """Application and server for these settings; nothing is opened yet."""
    app = create_app(settings)
    config = uvicorn.Config(
        app,
        http=timed_http_protocol(IdleConnectionLimit()),
        log_config=None,
        access_log=False,
        # uvicorn by default believes X-Forwarded-For of every caller on this computer.
        proxy_headers=bool(settings.trusted_proxies),
        forwarded_allow_ips=list(settings.trusted_proxies),
        ws_max_size=WEBSOCKET_MAX_BYTES,
        ws_per_message_deflate=False,
        timeout_graceful_shutdown=SHUTDOWN_S,
        backlog=ACCEPT_COUNT,
        server_header=False,
        lifespan="on",
    )
    return Server(config, app, on_ready), app


def settle_memory() -> None:
    """Take what was loaded so far out of garbage collection.

    A full collection stops the process while it walks all objects: 0.1 s with the modules of a server, which
    are never freed.
    """
    gc.collect()
    gc.freeze()


def serve(settings: Settings, on_ready: Callable[[], None] | None = None) -> None:
    """Serve until interrupted.

    Args:
        settings: of the service.
        on_ready: called once when requests are answered.

    Raises:
        DownrangeError: it cannot start; with the remedy.
    """
    logging.getLogger("uvicorn.error").addFilter(_is_news)
    allow_open_files()
    os.umask(0o077)  # whatever is written from here on is its owner's alone
    with open_socket(settings.host, settings.port_count) as listener:

        def ready() -> None:
            settle_memory()
            if on_ready is not None:
                on_ready()

        server, app = make_server(settings, ready)
        # uvicorn ends in order and then sends itself the signal again; by default that would kill the
        # process before its preview processes are cleaned up.
        before = signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
        with contextlib.suppress(SystemExit):  # how uvicorn says that the start failed
            server.run(sockets=[listener])
        signal.signal(signal.SIGTERM, before)
        error = getattr(app.state, "startup_error", None)
        if isinstance(error, DownrangeError):
            raise error
        if not server.started:
            raise UsageError("the service could not start; its log says why")


def _is_news(record: logging.LogRecord) -> bool:
    # The caller reports a failed start in one line. uvicorn 0.54 logs an error for a WebSocket that was
    # refused with a response, although the response is complete.
    return not str(record.msg).startswith(
        ("Traceback", "ASGI callable returned without completing")
    )
