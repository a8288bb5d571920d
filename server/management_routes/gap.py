"""Diagnoses of machines against their twins, and the twin profiles that they change."""

import math
from typing import Annotated

from fastapi import APIRouter, Query, Response

from machine.conventions import Mode
from machine.messages import Target
from server.dependencies import (
    GapDep,
    GapPreviewsDep,
    GapRunner,
    TwinKeeper,
    TwinVersionsDep,
    Viewer,
)
from server.schemas.gap import (
    CommissioningView,
    GapPreviewView,
    GapRunPage,
    GapRunRequest,
    GapRunRow,
    GapRunView,
    KeptReferenceView,
    TwinProfileView,
)

router = APIRouter(prefix="/machines/{machine_id}", tags=["gap"])

REPORT_HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; style-src 'unsafe-inline'; img-src data:; base-uri 'none'; "
        "form-action 'none'; frame-ancestors 'none'; sandbox"
    ),
    "Cache-Control": "private, max-age=3600",
}
"""The report comes from log files: it may show text and drawings, and nothing else."""


@router.post("/gap-runs", status_code=202)
def create_gap_run(
    machine_id: str, body: GapRunRequest, session: GapRunner, gap: GapDep
) -> GapRunRow:
    """Queue a diagnosis; its progress comes as `gap.updated` events."""
    return gap.create(machine_id, body, session.actor)


@router.get("/kept-reference")
def read_kept_reference(machine_id: str, session: Viewer, gap: GapDep) -> KeptReferenceView:
    """Reference throws that commissioning has kept, which diagnoses compare with by default."""
    return gap.kept_reference(machine_id)


@router.get("/commissioning")
def read_commissioning(machine_id: str, session: Viewer, gap: GapDep) -> CommissioningView:
    """The last commissioning: what the twin explains, and the command that goes on with it."""
    return gap.commissioning(machine_id)


@router.get("/commissioning/report.html", response_class=Response)
def read_commissioning_report(machine_id: str, session: Viewer, gap: GapDep) -> Response:
    """The report of the commissioning as one page."""
    return Response(
        gap.commissioning_report(machine_id),
        media_type="text/html; charset=utf-8",
        headers={**REPORT_HEADERS, "Cache-Control": "private, no-cache"},
    )


@router.get("/gap-runs")
def list_gap_runs(
    machine_id: str,
    session: Viewer,
    gap: GapDep,
    cursor: Annotated[str | None, Query(max_length=36)] = None,
    limit: Annotated[int, Query(ge=1, le=200)] = 50,
) -> GapRunPage:
    """Diagnoses of a machine, newest first."""
    return gap.page(machine_id, cursor, limit)


@router.get("/gap-runs/{gap_run_id}")
def read_gap_run(machine_id: str, gap_run_id: str, session: Viewer, gap: GapDep) -> GapRunView:
    """One diagnosis with its result."""
    return gap.view(machine_id, gap_run_id)


@router.delete("/gap-runs/{gap_run_id}")
def cancel_gap_run(machine_id: str, gap_run_id: str, session: GapRunner, gap: GapDep) -> GapRunRow:
    """Stop a diagnosis that waits or runs; its row stays."""
    return gap.cancel(machine_id, gap_run_id, session)


@router.get("/gap-runs/{gap_run_id}/report.html", response_class=Response)
def read_gap_report(machine_id: str, gap_run_id: str, session: Viewer, gap: GapDep) -> Response:
    """The report as one page."""
    return Response(
        gap.store.report(gap_run_id, machine_id),
        media_type="text/html; charset=utf-8",
        headers=REPORT_HEADERS,
    )


@router.get("/gap-runs/{gap_run_id}/preview")
def preview_gap_run(
    machine_id: str,
    gap_run_id: str,
    session: GapRunner,
    gap_previews: GapPreviewsDep,
    mode: Mode,
    range_m: Annotated[float, Query(gt=0.0, le=60.0, allow_inf_nan=False)],
    azimuth_rad: Annotated[
        float, Query(ge=-2.0 * math.pi, le=2.0 * math.pi, allow_inf_nan=False)
    ] = 0.0,
    height_m: Annotated[float, Query(ge=-5.0, le=10.0, allow_inf_nan=False)] = 0.0,
) -> GapPreviewView:
    """A target previewed with the twin as it is, and with what this diagnosis found."""
    target = Target(
        x_m=range_m * math.cos(azimuth_rad), y_m=range_m * math.sin(azimuth_rad), z_m=height_m
    )
    return gap_previews.compare(machine_id, gap_run_id, mode, target)


@router.post("/gap-runs/{gap_run_id}/apply")
def apply_gap_run(
    machine_id: str,
    gap_run_id: str,
    session: TwinKeeper,
    twin_versions: TwinVersionsDep,
    gap: GapDep,
) -> TwinProfileView:
    """Add what this diagnosis found to the machine's twin, as a new version of its profile."""
    profile = twin_versions.apply(machine_id, gap_run_id, session)
    gap.publish(gap_run_id)
    return profile


@router.get("/twin-profile")
def read_twin_profile(
    machine_id: str, session: Viewer, twin_versions: TwinVersionsDep
) -> TwinProfileView:
    """The twin profile that previews of this machine use."""
    return twin_versions.view(machine_id)


@router.post("/twin-profile/undo")
def undo_twin_profile(
    machine_id: str, session: TwinKeeper, twin_versions: TwinVersionsDep
) -> TwinProfileView:
    """Go back to the profile before the last one applied, as a new version."""
    return twin_versions.undo(machine_id, session)
