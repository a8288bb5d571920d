"""Validations of policy versions, their gates, comparisons of two versions, and shadows."""

from typing import Annotated

from fastapi import APIRouter, Query
from fastapi.responses import FileResponse

from machine.conventions import Mode
from server.dependencies import (
    Approver,
    ShadowsDep,
    ValidationsDep,
    Validator,
    Viewer,
)
from server.schemas.validation import (
    GatesRequest,
    GatesView,
    PolicyComparisonView,
    ShadowRequest,
    ShadowRunSummary,
    ShadowRunView,
    ValidationRequest,
    ValidationView,
)

router = APIRouter(tags=["policies"])

Sha256 = Annotated[str, Query(pattern=r"^[0-9a-f]{64}$")]


@router.get("/policies/compare")
def compare_policies(
    session: Viewer, validations: ValidationsDep, a: Sha256, b: Sha256
) -> PolicyComparisonView:
    """Version b beside a: better, worse, or cannot tell, by validations and by real throws."""
    return validations.comparison.compare(a, b)


@router.post("/policies/{policy_sha256}/validation", status_code=202)
def validate_policy(
    policy_sha256: str, body: ValidationRequest, session: Validator, validations: ValidationsDep
) -> ValidationView:
    """Throw with the version and with the active one in virtual machines, and check the gates."""
    return validations.create(policy_sha256, body, session)


@router.get("/policies/{policy_sha256}/validation")
def read_validation(
    policy_sha256: str, session: Viewer, validations: ValidationsDep
) -> ValidationView | None:
    """The newest validation of the version; null before the first."""
    return validations.view(policy_sha256)


@router.delete("/policies/{policy_sha256}/validation")
def cancel_validation(
    policy_sha256: str, session: Validator, validations: ValidationsDep
) -> ValidationView:
    """Stop the validation that waits or runs; its row stays."""
    return validations.cancel(policy_sha256, session)


@router.post("/policies/{policy_sha256}/shadow", status_code=201)
def shadow_policy(
    policy_sha256: str, body: ShadowRequest, session: Validator, shadows: ShadowsDep
) -> ShadowRunView:
    """What the version would have done in the newest throws; some seconds, and kept. Nothing moves."""
    return shadows.run(policy_sha256, body, session)


@router.get("/policies/{policy_sha256}/shadows")
def list_shadows(
    policy_sha256: str, session: Viewer, shadows: ShadowsDep
) -> list[ShadowRunSummary]:
    """The newest fifty shadows of the version, newest first."""
    return shadows.newest(policy_sha256)


@router.get("/policy-shadows/{shadow_id}")
def read_shadow(shadow_id: str, session: Viewer, shadows: ShadowsDep) -> ShadowRunView:
    """A shadow with each of its throws."""
    return shadows.view(shadow_id)


@router.get("/policy-validations/{validation_id}/logs/{name}", response_class=FileResponse)
def read_validation_log(
    validation_id: str, name: str, session: Viewer, validations: ValidationsDep
) -> FileResponse:
    """The log of a throw of the validation that failed (MCAP)."""
    path = validations.log(validation_id, name)
    return FileResponse(path, media_type="application/octet-stream", filename=name)


@router.get("/policy-gates")
def list_gates(session: Viewer, validations: ValidationsDep) -> list[GatesView]:
    """Gates of both modes."""
    return [validations.gates.view(mode) for mode in Mode]


@router.post("/policy-gates/{mode}", status_code=201)
def set_gates(
    mode: Mode, body: GatesRequest, session: Approver, validations: ValidationsDep
) -> GatesView:
    """Set the gates of a mode for validations from now on."""
    return validations.gates.set(mode, body, session)
