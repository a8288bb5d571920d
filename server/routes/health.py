"""Health for people and load balancers, metrics for Prometheus."""

from fastapi import APIRouter, Depends, Request, Response
from sqlalchemy.exc import SQLAlchemyError

from server.dependencies import (
    AccessDep,
    DatabaseDep,
    HubDep,
    LinkDep,
    MetricsDep,
    PreviewPoolDep,
    RegistryDep,
    SettingsDep,
    admit_reader,
)
from server.limits.disk_space import disk_standing
from server.schemas.console import HealthView, Permission
from server.version import SOFTWARE

router = APIRouter(tags=["health"])
metrics_router = APIRouter(include_in_schema=False)


@router.get("/health")
def read_health(
    database: DatabaseDep,
    link: LinkDep,
    pool: PreviewPoolDep,
    registry: RegistryDep,
    settings: SettingsDep,
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
    disk_text = disk_standing(settings.data_dir, settings.min_free_bytes)
    is_well = {database_text, link_text, preview_text, disk_text} == {"ok"}
    response.status_code = 200 if is_well else 503
    listed = registry.listed()
    return HealthView(
        status="ok" if is_well else "degraded",
        software=SOFTWARE,
        database=database_text,
        link=link_text,
        viewer="ok",
        preview=preview_text,
        disk=disk_text,
        machine_count=len(listed),
        connected_count=sum(known.is_connected for known in listed),
    )


def check_metrics_reader(request: Request, access: AccessDep, settings: SettingsDep) -> None:
    """Admit the bearer token of the settings, or a session that may read the audit."""
    admit_reader(
        request, access, settings.metrics_token, "DOWNRANGE_METRICS_TOKEN", Permission.AUDIT_READ
    )


@metrics_router.get("/metrics", dependencies=[Depends(check_metrics_reader)])
def read_metrics(metrics: MetricsDep, registry: RegistryDep, hub: HubDep) -> Response:
    """Metrics in Prometheus' text format."""
    metrics.machines_connected_count.set(sum(known.is_connected for known in registry.listed()))
    metrics.event_clients_count.set(hub.client_count)
    return Response(metrics.page(), media_type="text/plain; version=0.0.4; charset=utf-8")
