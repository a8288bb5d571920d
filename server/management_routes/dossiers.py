"""Dossiers: one throw, or a machine's throws of a period, as one signed file."""

from datetime import UTC, datetime
from typing import Annotated

from fastapi import APIRouter, Query
from fastapi.responses import StreamingResponse

from server.dependencies import Auditor, DossiersDep
from server.dossier.dossier_service import Dossier, DossierExtentView

router = APIRouter(tags=["dossiers"])

Moment = Annotated[datetime, Query(description="ISO 8601; without a zone it is UTC")]


@router.get("/throws/{throw_id}/dossier", response_class=StreamingResponse)
def export_throw_dossier(
    throw_id: str, session: Auditor, dossiers: DossiersDep
) -> StreamingResponse:
    """Everything about one throw, as a signed ZIP file."""
    return _answer(dossiers.of_throw(throw_id, session))


@router.get("/machines/{machine_id}/dossier", response_class=StreamingResponse)
def export_machine_dossier(
    machine_id: str, session: Auditor, dossiers: DossiersDep, since: Moment, until: Moment
) -> StreamingResponse:
    """A machine's ended throws from `since` until before `until`, as a signed ZIP file."""
    return _answer(dossiers.of_period(machine_id, _aware(since), _aware(until), session))


@router.get("/machines/{machine_id}/dossier/extent")
def read_dossier_extent(
    machine_id: str, session: Auditor, dossiers: DossiersDep, since: Moment, until: Moment
) -> DossierExtentView:
    """How much a dossier of a period would hold, and why there can be none."""
    return dossiers.extent(machine_id, _aware(since), _aware(until))


def _aware(moment: datetime) -> datetime:
    return moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment


def _answer(dossier: Dossier) -> StreamingResponse:
    return StreamingResponse(
        dossier.chunks(),
        media_type="application/zip",
        headers={
            "Content-Disposition": f'attachment; filename="{dossier.file_name}"',
            "Content-Length": str(dossier.size_bytes),
        },
    )
