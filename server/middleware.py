"""Middleware for every response: security headers, the error format, the duration."""

import json
import time

from starlette.datastructures import MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

CONTENT_SECURITY_POLICY = "; ".join(
    (
        "default-src 'self'",
        "script-src 'self'",
        # The component library of the console writes its style sheet into the page.
        "style-src 'self' 'unsafe-inline'",
        "img-src 'self' data: blob:",
        "font-src 'self' data:",
        "connect-src 'self'",
        "frame-src 'self'",
        "worker-src 'self' blob:",
        "object-src 'none'",
        "base-uri 'none'",
        "form-action 'self'",
        "frame-ancestors 'none'",
    )
)
HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(), microphone=(), geolocation=()",
    "Content-Security-Policy": CONTENT_SECURITY_POLICY,
    "X-Frame-Options": "DENY",
}
_FRAMED = ("Content-Security-Policy", "X-Frame-Options")


class SecurityHeaders:
    """Adds the headers that a route did not set itself (the 3D view's page sets its own policy)."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        # The view's page brings the policy under which our own page may frame it.
        is_view = scope["path"].startswith("/viewer")

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    if name not in headers and not (is_view and name in _FRAMED):
                        headers[name] = value
                if scope["path"].startswith("/api/") and "cache-control" not in headers:
                    headers["Cache-Control"] = "no-store"
            await send(message)

        await self._app(scope, receive, send_with_headers)


class RequestTimes:
    """Observes the duration of requests by operation; streams are not counted."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        began_s = time.perf_counter()
        status_code = 500
        is_stream = False

        async def note(message: Message) -> None:
            nonlocal status_code, is_stream
            if message["type"] == "http.response.start":
                status_code = message["status"]
                content_type = MutableHeaders(scope=message).get("content-type", "")
                is_stream = content_type.startswith("text/event-stream")
            await send(message)

        try:
            await self._app(scope, receive, note)
        finally:
            parts = getattr(scope["app"].state, "parts", None)
            operation = getattr(scope.get("route"), "name", None)
            if parts is not None and operation is not None and not is_stream:
                parts.metrics.requests_s.labels(
                    operation=operation, status=str(status_code)
                ).observe(time.perf_counter() - began_s)


class JsonErrors:
    """Turns the plain-text errors of the framework's own middleware into the one error shape."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] != "http" or not scope["path"].startswith("/api/"):
            await self._app(scope, receive, send)
            return
        is_replaced = False

        async def send_shaped(message: Message) -> None:
            nonlocal is_replaced
            if message["type"] == "http.response.start" and message["status"] >= 400:
                headers = MutableHeaders(scope=message)
                if headers.get("content-type", "").startswith("text/plain"):
                    is_replaced = True
                    body = _plain_error(message["status"])
                    headers["content-type"] = "application/json"
                    headers["content-length"] = str(len(body))
                    await send(message)
                    await send({"type": "http.response.body", "body": body})
                    return
            if not (is_replaced and message["type"] == "http.response.body"):
                await send(message)

        await self._app(scope, receive, send_shaped)


def _plain_error(status_code: int) -> bytes:
    code, text = (
        ("too_large", "The body is too large.")
        if status_code == 413
        else ("http_error", f"The request failed with status {status_code}.")
    )
    return json.dumps({"error": {"code": code, "message": text, "detail": None}}).encode()
