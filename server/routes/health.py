"""Health for people and load balancers, metrics for Prometheus."""

from fastapi import APIRouter, Response
from sqlalchemy.exc import SQLAlchemyError

from server.schemas.console import HealthView
from server.services import ServicesDep
from server.version import SOFTWARE

router = APIRouter(tags=["health"])
metrics_router = APIRouter(include_in_schema=False)


@router.get("/health")
def read_health(services: ServicesDep, response: Response) -> HealthView:
    """Whether the service can do its work; 503 when a part is away."""
    try:
        services.database.ping()
        database = "ok"
    except SQLAlchemyError as error:
        database = f"does not answer: {type(error).__name__}"
    link = "ok" if services.link.is_open else "closed"
    preview = "ok" if services.pool.is_running else "closed"
    is_well = {database, link, preview} == {"ok"}
    response.status_code = 200 if is_well else 503
    listed = services.registry.listed()
    return HealthView(
        status="ok" if is_well else "degraded",
        software=SOFTWARE,
        database=database,
        link=link,
        viewer="ok",
        preview=preview,
        machine_count=len(listed),
        connected_count=sum(known.is_connected for known in listed),
    )


@metrics_router.get("/metrics")
def read_metrics(services: ServicesDep) -> Response:
    """Metrics in Prometheus' text format."""
    metrics = services.metrics
    metrics.machines_connected_count.set(
        sum(known.is_connected for known in services.registry.listed())
    )
    metrics.event_clients_count.set(services.hub.client_count)
    return Response(metrics.page(), media_type="text/plain; version=0.0.4; charset=utf-8")
