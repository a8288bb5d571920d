"""ISO 15143-3 (AEMP 2.0): snapshots of the fleet and time series, as XML or JSON.

The standard describes these addresses and documents; the OpenAPI description leaves them out.
"""

from datetime import UTC, datetime
from typing import Annotated

from fastapi import APIRouter, Depends, Path, Request, Response

from server.dependencies import AccessDep, DatabaseDep, RegistryDep, SettingsDep, admit_reader
from server.schemas.console import Permission
from server.telematics.documents import Node, as_json, as_xml
from server.telematics.equipment import MAX_PAGE, FleetTelematics

BASE = "/api/v1/telematics"


def check_reader(request: Request, access: AccessDep, settings: SettingsDep) -> None:
    """Admit the bearer token of the settings, or a session that may look."""
    admit_reader(
        request, access, settings.telematics_token, "DOWNRANGE_TELEMATICS_TOKEN", Permission.VIEW
    )


def _telematics(database: DatabaseDep, registry: RegistryDep) -> FleetTelematics:
    return FleetTelematics(database, registry, BASE)


router = APIRouter(prefix=BASE, include_in_schema=False, dependencies=[Depends(check_reader)])
TelematicsDep = Annotated[FleetTelematics, Depends(_telematics)]
PageNumber = Annotated[int, Path(ge=1, le=MAX_PAGE)]
_MACHINE = "/Fleet/Equipment/MakeModelSerial/{make}/{model}/{serial}"


@router.get("/Fleet/{page}")
def read_fleet_snapshot(page: PageNumber, request: Request, fleet: TelematicsDep) -> Response:
    """Every machine, 100 a page."""
    return _answer(request, "Fleet", fleet.fleet(page))


@router.get(_MACHINE)
def read_equipment_snapshot(
    make: str, model: str, serial: str, request: Request, fleet: TelematicsDep
) -> Response:
    """One machine."""
    return _answer(request, "Equipment", fleet.single(make, model, serial))


@router.get(_MACHINE + "/CumulativeLoadCount/{begin}/{end}/{page}")
def read_load_counts(
    make: str,
    model: str,
    serial: str,
    begin: datetime,
    end: datetime,
    page: PageNumber,
    request: Request,
    fleet: TelematicsDep,
) -> Response:
    """Loads thrown over time."""
    period = (_aware(begin), _aware(end))
    series = fleet.load_counts((make, model, serial), period, page)
    return _answer(request, "CumulativeLoadCountMessages", series)


def _aware(moment: datetime) -> datetime:
    return moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment


def _answer(request: Request, root: str, document: Node) -> Response:
    """XML, or JSON where the caller asks for that and not for XML."""
    accepted = request.headers.get("accept", "").lower()
    headers = {"Vary": "Accept"}
    if "json" in accepted and "xml" not in accepted:
        return Response(as_json(document), media_type="application/json", headers=headers)
    return Response(as_xml(root, document), media_type="application/xml", headers=headers)
