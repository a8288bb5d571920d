"""Machines that are added and retired, and what a new one says of itself."""

from datetime import datetime
from enum import StrEnum
from typing import Annotated, Literal

from pydantic import Field

from machine.conventions import FILLED_LINE_PATTERN, LINE_PATTERN
from machine.policy_approval import SiteTrust
from server.schemas.console import MachineView, Request, View

SelfTestName = Literal["link", "clock", "policies", "driver", "imu", "calibration"]
ShortText = Annotated[str, Field(max_length=300)]


class MachineEnrolRequest(Request):
    """A new machine of this site."""

    machine_id: str | None = Field(default=None, pattern=r"^[a-z0-9][a-z0-9-]{1,31}$")
    """None: the next free one."""
    name: str = Field(default="", max_length=80, pattern=LINE_PATTERN)


class EnrolmentToken(View):
    """What a person takes to the machine; the token is shown once."""

    machine: MachineView
    token: str
    expires_utc: datetime
    link_address: str
    """Endpoint of the router at which the machine calls in."""
    site_key_id: str
    """Key that signs the site's policies; the machine is to be bound by it and by no other."""


class EnrolmentStage(StrEnum):
    """How far a machine has been set up."""

    WAITING = "waiting"
    """Its token can be used."""
    EXPIRED = "expired"
    CLAIMED = "claimed"
    """It has its credentials."""
    TESTED = "tested"
    """Its self-test has been made."""


class SelfTestItem(Request):
    """One line of the self-test that a machine makes of itself."""

    name: SelfTestName
    is_passed: bool
    detail: ShortText


class EnrolmentView(View):
    """The newest enrolment of a machine."""

    machine_id: str
    stage: EnrolmentStage
    created_by: str
    created_utc: datetime
    expires_utc: datetime
    claimed_utc: datetime | None
    claimed_from: str
    self_test: tuple[SelfTestItem, ...]
    tested_utc: datetime | None


class ClaimRequest(Request):
    """A machine's computer hands in its token."""

    token: str = Field(min_length=16, max_length=100)


class CredentialsView(View):
    """What a machine needs to work for this server; only its token opens it, once."""

    machine_id: str
    site: str
    password: str
    connect: tuple[str, ...]
    """Zenoh endpoints."""
    root_ca_pem: str | None
    """Authority of the router's certificate, where the endpoint is encrypted and the server has it."""
    server_utc: datetime
    trust: SiteTrust
    """Keys of the site and the policy versions that it has approved."""


class SelfTestReport(Request):
    """All lines, once each."""

    items: tuple[SelfTestItem, ...] = Field(min_length=1, max_length=6)


class RetireRequest(Request):
    """Why a machine goes out of service."""

    reason: str = Field(min_length=3, max_length=300, pattern=FILLED_LINE_PATTERN)


class RetiredMachineView(View):
    """A machine out of service."""

    machine_id: str
    name: str
    tags: tuple[str, ...]
    retired_utc: datetime
    last_seen_utc: datetime | None
