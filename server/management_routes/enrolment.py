"""Machines are added, set up and retired."""

from typing import Annotated

from fastapi import APIRouter, Header, Request

from server.dependencies import (
    Enroller,
    EnrolmentsDep,
    MachineCaller,
    RegistryDep,
    StopsDep,
    Viewer,
    ViewsDep,
)
from server.schemas.enrolment import (
    ClaimRequest,
    CredentialsView,
    EnrolmentToken,
    EnrolmentView,
    MachineEnrolRequest,
    RetiredMachineView,
    RetireRequest,
    SelfTestReport,
)

router = APIRouter(tags=["enrolment"])

Host = Annotated[str, Header(alias="host", include_in_schema=False)]


@router.post("/machines", status_code=201)
def enrol_machine(
    body: MachineEnrolRequest,
    session: Enroller,
    enrolments: EnrolmentsDep,
    views: ViewsDep,
    host: Host = "",
) -> EnrolmentToken:
    """Add a machine; the token sets its computer up within the hour, once."""
    machine_id, token, row = enrolments.add(body.machine_id, body.name, session.actor)
    views.publish(machine_id)
    return EnrolmentToken(
        machine=views.view(machine_id),
        token=token,
        expires_utc=row.expires_utc,
        link_address=enrolments.link_address(host),
        site_key_id=enrolments.site_key_id(),
    )


@router.post("/machines/{machine_id}/enrolment", status_code=201)
def renew_enrolment(
    machine_id: str,
    session: Enroller,
    enrolments: EnrolmentsDep,
    views: ViewsDep,
    host: Host = "",
) -> EnrolmentToken:
    """A new token, for a computer that was replaced or a token that has expired; the old one is void."""
    token, row = enrolments.issue(machine_id, session.actor)
    return EnrolmentToken(
        machine=views.view(machine_id),
        token=token,
        expires_utc=row.expires_utc,
        link_address=enrolments.link_address(host),
        site_key_id=enrolments.site_key_id(),
    )


@router.get("/machines/{machine_id}/enrolment")
def read_enrolment(
    machine_id: str, session: Viewer, enrolments: EnrolmentsDep
) -> EnrolmentView | None:
    """How far a machine is set up, and its self-test; null where it was never added by a token."""
    return enrolments.view(machine_id)


@router.post("/enrolments/claim")
def claim_enrolment(
    body: ClaimRequest, request: Request, enrolments: EnrolmentsDep, host: Host = ""
) -> CredentialsView:
    """For a machine's computer: its credentials for its token. A token works once."""
    address = "" if request.client is None else request.client.host
    return enrolments.claim(body.token, address, host)


@router.put("/machines/{machine_id}/self-test", status_code=204)
def put_self_test(
    machine_id: MachineCaller, body: SelfTestReport, enrolments: EnrolmentsDep
) -> None:
    """For the machine itself: what it found of itself."""
    enrolments.take_self_test(machine_id, body)


@router.post("/machines/{machine_id}/retire", status_code=204)
def retire_machine(
    machine_id: str,
    body: RetireRequest,
    session: Enroller,
    registry: RegistryDep,
    stops: StopsDep,
    views: ViewsDep,
) -> None:
    """Take a machine that is switched off out of service; its history stays, its password is void."""
    with stops.suspended(machine_id):
        registry.retire(machine_id, body.reason, session.actor)
    views.publish_retired(machine_id)


@router.get("/fleet/retired")
def list_retired(session: Viewer, registry: RegistryDep) -> list[RetiredMachineView]:
    """Machines out of service, newest first."""
    return [
        RetiredMachineView(
            machine_id=known.machine_id,
            name=known.name,
            tags=known.tags,
            retired_utc=known.retired_utc,
            last_seen_utc=known.last_seen_utc,
        )
        for known in registry.retired()
        if known.retired_utc is not None
    ]
