"""Health for people and load balancers, metrics for Prometheus."""

from fastapi import APIRouter, Response
from sqlalchemy.exc import SQLAlchemyError

from server.dependencies import (
    DatabaseDep,
    HubDep,
    LinkDep,
    MetricsDep,
    PreviewPoolDep,
    RegistryDep,
)
from server.schemas.console import HealthView
from server.version import SOFTWARE

router = APIRouter(tags=["health"])
metrics_router = APIRouter(include_in_schema=False)


@router.get("/health")
def read_health(
    database: DatabaseDep,
    link: LinkDep,
    pool: PreviewPoolDep,
    registry: RegistryDep,
    response: Response,
) -> HealthView:
    """Whether the service can do its work; 503 when a part is away."""
    try:
        database.ping()
        database_text = "ok"
    except SQLAlchemyError as error:
        database_text = f"does not answer: {type(error).__name__}"
    link_text = "ok" if link.is_open else "closed"
    preview_text = "ok" if pool.is_running else "closed"
    is_well = {database_text, link_text, preview_text} == {"ok"}
    response.status_code = 200 if is_well else 503
    listed = registry.listed()
    return HealthView(
        status="ok" if is_well else "degraded",
        software=SOFTWARE,
        database=database_text,
        link=link_text,
        viewer="ok",
        preview=preview_text,
        machine_count=len(listed),
        connected_count=sum(known.is_connected for known in listed),
    )


@metrics_router.get("/metrics")
def read_metrics(metrics: MetricsDep, registry: RegistryDep, hub: HubDep) -> Response:
    """Metrics in Prometheus' text format."""
    metrics.machines_connected_count.set(sum(known.is_connected for known in registry.listed()))
    metrics.event_clients_count.set(hub.client_count)
    return Response(metrics.page(), media_type="text/plain; version=0.0.4; charset=utf-8")
