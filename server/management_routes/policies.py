"""Policy versions."""

import asyncio
from datetime import datetime
from typing import Annotated, Literal

from fastapi import APIRouter, Query, Request
from fastapi.responses import FileResponse
from pydantic import Field, ValidationError
from starlette.datastructures import UploadFile
from starlette.exceptions import HTTPException as StarletteHTTPException

from machine.conventions import Mode
from machine.policy_approval import Approval
from server.dependencies import (
    ApprovalsDep,
    Approver,
    DatabaseDep,
    Deployer,
    DeploymentsDep,
    MachineCaller,
    MachinePoliciesDep,
    PoliciesDep,
    Uploader,
    UploadsDep,
    Viewer,
)
from server.deployments.policy_uploads import LIMITS_BYTES, NAMES
from server.deployments.site_keys import TrustReport
from server.errors import ApiError
from server.plans.policy_life import history
from server.schemas.deployments import (
    DeploymentView,
    DeployRequest,
    MachinePoliciesView,
    RollBackRequest,
    WantedPoliciesView,
)
from server.schemas.history import PolicyView
from server.schemas.policies import (
    ApprovalBasisView,
    ApproveRequest,
    PolicyTransitionView,
    SiteKeyView,
    TransitionRequest,
)

router = APIRouter(tags=["policies"])
upload_router = APIRouter(tags=["policies"])
"""Apart: its bodies may be larger than others (server/app.py)."""

KeyId = Annotated[str, Field(pattern=r"^[0-9a-f]{16}$")]

_FILE_SCHEMA = {"type": "string", "format": "binary"}
_UPLOAD_BODY = {
    "required": True,
    "content": {
        "multipart/form-data": {
            "schema": {
                "type": "object",
                "required": ["reason", "files"],
                "properties": {
                    "reason": {"type": "string", "minLength": 3, "maxLength": 300},
                    "files": {"type": "array", "items": _FILE_SCHEMA, "minItems": 3, "maxItems": 3},
                },
            }
        }
    },
}


@upload_router.post(
    "/policies",
    status_code=201,
    response_model=PolicyView,
    openapi_extra={"requestBody": _UPLOAD_BODY},
)
async def upload_policy(request: Request, session: Uploader, uploads: UploadsDep) -> PolicyView:
    """Take in a version: policy.onnx, card.json and golden_vectors.json, each by its file name."""
    # Not declared as a body: that would be parsed before the caller's rights are looked at.
    contents: dict[str, bytes] = {}
    try:
        async with request.form(max_files=len(LIMITS_BYTES), max_fields=1) as form:
            reason = form.get("reason")
            for part in form.getlist("files"):
                if isinstance(part, UploadFile):
                    contents[part.filename or ""] = await part.read()
    except StarletteHTTPException as error:
        if "Too many" in error.detail:
            raise ApiError("bad_upload", f"A version is three files: {NAMES}.") from error
        raise ApiError(
            "bad_upload", f"The upload cannot be read: {error.detail} Send it again."
        ) from error
    try:
        checked = TransitionRequest(reason=reason if isinstance(reason, str) else "")
    except ValidationError as error:
        raise ApiError(
            "bad_upload", "A reason of 3 to 300 characters is needed, for the history."
        ) from error
    return await asyncio.to_thread(uploads.add, contents, checked.reason, session)


@router.get("/policies")
def list_policies(session: Viewer, policies: PoliciesDep) -> list[PolicyView]:
    """All policy versions ever seen, the active ones first."""
    return policies.views()


@router.get("/policies/{policy_sha256}")
def read_policy(policy_sha256: str, session: Viewer, policies: PoliciesDep) -> PolicyView:
    """One policy version."""
    return policies.view(policy_sha256)


@router.get("/policy-approvals")
def list_policy_approvals(session: Viewer, approvals: ApprovalsDep) -> list[Approval]:
    """What the site has approved: machines load nothing else."""
    return list(approvals.trust().approvals)


@router.get("/policies/{policy_sha256}/history")
def read_policy_history(
    policy_sha256: str, session: Viewer, database: DatabaseDep
) -> list[PolicyTransitionView]:
    """The steps of the version's life, oldest first: who, when, why, and on what evidence."""
    with database.read() as reading:
        return history(reading, policy_sha256)


@router.post("/policies/{policy_sha256}/approve", status_code=201)
def approve_policy(
    policy_sha256: str, body: ApproveRequest, session: Approver, approvals: ApprovalsDep
) -> Approval:
    """Approve the version by the site's key, as it lies there; needs a validation that passed the gates."""
    return approvals.approve(
        policy_sha256, body.reason, session, is_without_validation=body.is_without_validation
    )


@router.get("/policies/{policy_sha256}/approval-basis")
def read_approval_basis(
    policy_sha256: str, session: Viewer, approvals: ApprovalsDep
) -> ApprovalBasisView:
    """Whether the newest validation of these files passed the gates in force, in a sentence."""
    basis = approvals.basis(policy_sha256)
    return ApprovalBasisView(is_validated=basis.is_validated, sentence=basis.sentence)


@router.post("/policies/{policy_sha256}/withdraw", status_code=204)
def withdraw_policy(
    policy_sha256: str, body: TransitionRequest, session: Approver, approvals: ApprovalsDep
) -> None:
    """Withdraw an approval: machines stop using the version while no plan is armed."""
    approvals.withdraw(policy_sha256, body.reason, session)


@router.post("/policies/{policy_sha256}/retire", status_code=204)
def retire_policy(
    policy_sha256: str, body: TransitionRequest, session: Approver, approvals: ApprovalsDep
) -> None:
    """Take the version out of use for good; refused while a machine runs it or may go back to it."""
    approvals.retire(policy_sha256, body.reason, session)


@router.get("/policy-keys")
def list_policy_keys(session: Viewer, approvals: ApprovalsDep) -> list[SiteKeyView]:
    """The keys by which the site approves versions, the newest first."""
    return approvals.keys()


@router.post("/policy-keys/rotate", status_code=201)
def rotate_policy_key(
    body: TransitionRequest, session: Approver, approvals: ApprovalsDep
) -> list[SiteKeyView]:
    """Make a new key and sign everything by it; machines follow by what the old key says."""
    return approvals.rotate(body.reason, session)


@router.post("/policy-keys/{key_id}/revoke")
def revoke_policy_key(
    key_id: str, body: TransitionRequest, session: Approver, approvals: ApprovalsDep
) -> list[SiteKeyView]:
    """Revoke a key that signs no more: what it has signed counts no more."""
    return approvals.revoke(key_id, body.reason, session)


@router.get("/machines/{machine_id}/policies")
def read_machine_policies(
    machine_id: str,
    session: Viewer,
    machine_policies: MachinePoliciesDep,
    at: datetime | None = None,
) -> MachinePoliciesView:
    """What the machine had on board at a time (ISO 8601; UTC where it names no zone), or has now."""
    return machine_policies.view(machine_id, at)


@router.get("/machines/{machine_id}/deployments")
def list_deployments(
    machine_id: str, session: Viewer, deployments: DeploymentsDep
) -> list[DeploymentView]:
    """The newest hundred, newest first: who wanted which version, when and why, and what became of it."""
    return deployments.list(machine_id)


@router.post("/machines/{machine_id}/policies/{mode}/deploy", status_code=201)
def deploy_policy(
    machine_id: str, mode: Mode, body: DeployRequest, session: Deployer, deployments: DeploymentsDep
) -> DeploymentView:
    """Ask the machine to switch to a version; it does so while no plan is armed."""
    return deployments.deploy(machine_id, mode, body, session)


@router.post("/machines/{machine_id}/policies/{mode}/rollback", status_code=201)
def roll_back_policy(
    machine_id: str,
    mode: Mode,
    body: RollBackRequest,
    session: Deployer,
    deployments: DeploymentsDep,
) -> DeploymentView:
    """Ask the machine to go back to the version that it had before."""
    return deployments.roll_back(machine_id, mode, body.reason, session)


@router.get("/machines/{machine_id}/policies/wanted")
def read_wanted_policies(
    machine_id: MachineCaller,
    deployments: DeploymentsDep,
    serial: Annotated[int | None, Query(alias="list", ge=0, lt=2**63)] = None,
    key: Annotated[tuple[KeyId, ...], Query(max_length=100)] = (),
) -> WantedPoliciesView:
    """For the machine itself: the version that it is to have in each mode; it says which keys it trusts."""
    report = None if serial is None else TrustReport(serial, key)
    return deployments.wanted(machine_id, report)


@router.get(
    "/machines/{machine_id}/policy-files/{policy_sha256}/{name}", response_class=FileResponse
)
def read_policy_file(
    machine_id: MachineCaller,
    policy_sha256: str,
    name: Literal["policy.onnx", "card.json", "golden_vectors.json"],
    deployments: DeploymentsDep,
) -> FileResponse:
    """For the machine itself: a file of a version, whole or a range of bytes."""
    return FileResponse(
        deployments.file(policy_sha256, name), media_type="application/octet-stream"
    )
