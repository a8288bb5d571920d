"""The web service: puts the routers together."""

from fastapi import APIRouter, FastAPI
from fastapi.routing import APIRoute

from server.routes import (
    audit,
    auth,
    events,
    health,
    history,
    leases,
    machines,
    plans,
    policies,
    throws,
)
from server.schemas import ErrorBody

API_PREFIX = "/api/v1"


def _operation_id(route: APIRoute) -> str:
    return route.name


def _api_router() -> APIRouter:
    responses: dict[int | str, dict[str, object]] = {
        status: {"model": ErrorBody} for status in (401, 403, 404, 409, 422, 503)
    }
    api = APIRouter(prefix=API_PREFIX, responses=responses)
    for module in (
        auth,
        machines,
        leases,
        plans,
        throws,
        history,
        policies,
        audit,
        events,
        health,
    ):
        api.include_router(module.router)
    return api


def create_app() -> FastAPI:
    """Build the service."""
    app = FastAPI(
        title="Downrange",
        version="0.1.0",
        openapi_url=f"{API_PREFIX}/openapi.json",
        generate_unique_id_function=_operation_id,
    )
    app.include_router(_api_router())
    return app
