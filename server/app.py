"""The web service on one port: HTTP interface, event streams, 3D view and console.

`create_app` opens nothing; everything long-lived is opened when the application starts.
"""

import asyncio
import logging
import time
from collections.abc import AsyncGenerator, Callable
from contextlib import AbstractAsyncContextManager, AsyncExitStack, asynccontextmanager, suppress

from fastapi import APIRouter, FastAPI, Request, WebSocket
from fastapi.middleware.gzip import GZipMiddleware
from fastapi.routing import APIRoute
from pydantic.json_schema import models_json_schema
from starlette.requests import HTTPConnection
from starlette.responses import JSONResponse

from machine.errors import DownrangeError
from machine.spec import load_spec
from server.accounts.accounts import COOKIE, Session
from server.composition import Parts, open_parts
from server.dependencies import Viewer
from server.deployments.policy_uploads import UPLOAD_LIMIT_BYTES
from server.error_handlers import add_error_handlers
from server.errors import NotFoundError
from server.limits.streams import Place, StreamKind
from server.management_routes import (
    aim,
    alerts,
    dossiers,
    drifts,
    enrolment,
    fleet,
    gap,
    jobs,
    policies,
    rollouts,
    telematics,
    validations,
)
from server.middleware import JsonErrors, RequestTimes, SecurityHeaders
from server.routes import (
    audit,
    auth,
    events,
    health,
    history,
    hold,
    machines,
    plans,
    sites,
    stops,
)
from server.schemas.console import ErrorBody
from server.schemas.plans import HoldMessage, HoldReply
from server.settings import Settings
from server.store.instance_lock import instance_lock
from server.version import SOFTWARE
from server.viewer.pick import PickRefusedError
from server.viewer.scene import ViewerScene
from server.viewer_proxy.proxy import ViewerProxy, ViewerSession

logger = logging.getLogger(__name__)

API_PREFIX = "/api/v1"
MAX_BODY_BYTES = 64 * 1024
TICK_S = 0.5


def _operation_id(route: APIRoute) -> str:
    return route.name


def _api_router() -> APIRouter:
    responses: dict[int | str, dict[str, object]] = {
        status: {"model": ErrorBody}
        for status in (400, 401, 403, 404, 409, 413, 422, 429, 503, 504)
    }
    api = APIRouter(prefix=API_PREFIX, responses=responses, max_body_size=MAX_BODY_BYTES)
    for module in (
        auth,
        machines,
        fleet,
        enrolment,
        stops,
        plans,
        hold,
        history,
        dossiers,
        sites,
        # Before policies: its paths name what else would be read as a version.
        validations,
        policies,
        rollouts,
        jobs,
        gap,
        drifts,
        aim,
        alerts,
        audit,
        events,
        health,
    ):
        api.include_router(module.router)
    api.include_router(sites.zones_router)
    api.include_router(policies.upload_router, max_body_size=UPLOAD_LIMIT_BYTES)
    api.include_router(jobs.surveys_router, max_body_size=jobs.MAX_SURVEY_BODY_BYTES)
    api.include_router(history.logs_router, max_body_size=history.MAX_LOG_BODY_BYTES)
    api.include_router(machines.leases_router)
    api.include_router(plans.view_router)
    return api


def _read_openapi(request: Request, session: Viewer) -> JSONResponse:
    return JSONResponse(openapi_document(request.app))


async def _no_such_api(path: str, request: Request) -> None:
    # Without this route the console's page is the answer to every unknown address of the interface.
    raise NotFoundError("not_found", f"There is no {request.method} /api/{path[:100]}.")


def create_app(settings: Settings) -> FastAPI:
    """Build the service.

    Args:
        settings: where everything lies; nothing is touched before the application starts.
    """

    def pick(session_id: str, point_m: tuple[float, float, float]) -> None:
        parts: Parts = app.state.parts
        parts.targets.take_pick(session_id, point_m)

    def refused_pick(session_id: str, error: PickRefusedError) -> None:
        parts: Parts = app.state.parts
        parts.targets.take_refused_pick(session_id, error)

    async def session_of(connection: HTTPConnection) -> Session | None:
        parts: Parts = app.state.parts
        return await asyncio.to_thread(parts.accounts.session_of, connection.cookies.get(COOKIE))

    def admit(session: ViewerSession, websocket: WebSocket) -> Place:
        parts: Parts = app.state.parts
        assert isinstance(session, Session)
        return parts.streams.take(StreamKind.VIEW, session.username, websocket)

    scene = ViewerScene(
        load_spec(), pick, on_pick_refused=refused_pick, shadows=settings.view_shadows
    )
    proxy = ViewerProxy(scene, session_of, allowed_origins=settings.allowed_origins, admit=admit)
    app = FastAPI(
        title="Downrange",
        version=SOFTWARE,
        openapi_url=None,
        docs_url=None,
        redoc_url=None,
        generate_unique_id_function=_operation_id,
        lifespan=_lifespan(settings, scene, proxy),
    )
    app.include_router(_api_router())
    app.include_router(health.metrics_router)
    app.include_router(telematics.router)
    app.add_api_route(f"{API_PREFIX}/openapi.json", _read_openapi, include_in_schema=False)
    app.include_router(proxy.router)
    app.add_api_route(
        "/api/{path:path}",
        _no_such_api,
        methods=["GET", "POST", "PUT", "PATCH", "DELETE"],
        include_in_schema=False,
    )
    if settings.web_dir.is_dir():
        app.frontend("/", directory=settings.web_dir, fallback="index.html")
    add_error_handlers(app)
    app.add_middleware(GZipMiddleware, minimum_size=1024, compresslevel=5)
    app.add_middleware(JsonErrors)
    app.add_middleware(SecurityHeaders)
    app.add_middleware(RequestTimes)
    return app


def openapi_document(app: FastAPI) -> dict[str, object]:
    """The interface's description, with the WebSocket messages, which OpenAPI does not cover."""
    document = app.openapi()
    _, extra = models_json_schema(
        [(HoldMessage, "validation"), (HoldReply, "serialization")],
        ref_template="#/components/schemas/{model}",
    )
    document["components"]["schemas"].update(extra["$defs"])
    return document


def _lifespan(
    settings: Settings, scene: ViewerScene, proxy: ViewerProxy
) -> Callable[[FastAPI], AbstractAsyncContextManager[None]]:
    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncGenerator[None]:
        async with AsyncExitStack() as stack:
            try:
                stack.enter_context(instance_lock(settings.data_dir))
                opened = open_parts(settings, scene)
                parts = await asyncio.to_thread(opened.__enter__)
            except DownrangeError as error:
                app.state.startup_error = error
                raise
            stack.push_async_callback(asyncio.to_thread, opened.__exit__, None, None, None)
            app.state.parts = parts
            loop = asyncio.get_running_loop()

            def close_view(session: Session) -> None:
                asyncio.run_coroutine_threadsafe(proxy.close_session(session.session_id), loop)

            parts.accounts.on_session_end(close_view)
            ticking = asyncio.create_task(_tick(parts))
            stack.push_async_callback(_cancel, ticking)
            yield

    return lifespan


async def _tick(parts: Parts) -> None:
    """Expire leases and measure the lag of the event loop, twice a second."""
    while True:
        began_s = time.monotonic()
        await asyncio.sleep(TICK_S)
        parts.metrics.loop_lag_s.set(max(time.monotonic() - began_s - TICK_S, 0.0))
        try:
            await asyncio.to_thread(parts.leases.expire_due)
        except Exception:
            logger.exception("leases could not be looked through")


async def _cancel(task: "asyncio.Task[None]") -> None:
    task.cancel()
    with suppress(asyncio.CancelledError):
        await task
