"""Payloads of the server-sent events."""

from datetime import datetime
from typing import Annotated, Literal

from pydantic import Field, RootModel

from server.schemas.alerts import AlertView
from server.schemas.console import LeaseView, MachineView, TargetView, View
from server.schemas.gap import GapRunRow
from server.schemas.history import ThrowRow
from server.schemas.plans import PlanView
from server.schemas.sites import SiteView
from server.schemas.zones import ZonesView


class MachineStateEvent(View):
    """A machine's state, at most 10 Hz; superseded ones may be left out."""

    kind: Literal["machine.state"] = "machine.state"
    machine: MachineView


class MachineLostEvent(View):
    """The link to a machine is gone."""

    kind: Literal["machine.lost"] = "machine.lost"
    machine_id: str
    last_seen_utc: datetime | None
    detail: str


class MachineRetiredEvent(View):
    """A machine is out of service."""

    kind: Literal["machine.retired"] = "machine.retired"
    machine_id: str


class LeaseChangedEvent(View):
    """A lease was acquired, taken, released or has run out."""

    kind: Literal["lease.changed"] = "lease.changed"
    lease: LeaseView
    cause: Literal["acquired", "released", "taken", "expired", "idle", "session_ended"]
    by: str
    reason: str


class TargetProposedEvent(View):
    """This session's target, from a click in the 3D view or from the fields; null when removed."""

    kind: Literal["target.proposed"] = "target.proposed"
    machine_id: str
    session_id: str
    target: TargetView | None
    source: Literal["pick", "fields"]
    refusal: str
    """Why the point cannot be a target; empty if it can."""


class PointPickedEvent(View):
    """A click in this session's 3D view that is no target; m, frame `machine`."""

    kind: Literal["point.picked"] = "point.picked"
    machine_id: str
    session_id: str
    x_m: float
    y_m: float
    z_m: float


class PlanUpdatedEvent(View):
    """A plan has news: first numbers, a better ellipse, the end."""

    kind: Literal["plan.updated"] = "plan.updated"
    plan: PlanView


class ThrowUpdatedEvent(View):
    """A throw has news."""

    kind: Literal["throw.updated"] = "throw.updated"
    throw: ThrowRow


class GapUpdatedEvent(View):
    """A diagnosis has news: its place in the queue, progress, the end."""

    kind: Literal["gap.updated"] = "gap.updated"
    run: GapRunRow


class TwinUpdatedEvent(View):
    """A machine's twin has another profile from now on."""

    kind: Literal["twin.updated"] = "twin.updated"
    machine_id: str
    version_count: int


class SiteUpdatedEvent(View):
    """What stands around a machine was changed."""

    kind: Literal["site.updated"] = "site.updated"
    site: SiteView


class ZonesUpdatedEvent(View):
    """The exclusion zones of a machine were changed or approved."""

    kind: Literal["zones.updated"] = "zones.updated"
    zones: ZonesView


class AlertEvent(View):
    """News for everybody who looks at the console now; nothing is kept of it."""

    kind: Literal["alert"] = "alert"
    severity: Literal["info", "warning", "error"]
    code: str
    text: str
    machine_id: str | None


class AlertUpdatedEvent(View):
    """An alert was opened, cleared, acknowledged or silenced."""

    kind: Literal["alert.updated"] = "alert.updated"
    alert: AlertView


class RolloutUpdatedEvent(View):
    """A rollout has news; its numbers are read anew."""

    kind: Literal["rollout.updated"] = "rollout.updated"
    rollout_id: str


class JobUpdatedEvent(View):
    """A bulk job has news: a load, a change, or its next loads are planned; it is read anew."""

    kind: Literal["job.updated"] = "job.updated"
    job_id: str
    machine_id: str
    version_count: int


class ServerEvent(
    RootModel[
        Annotated[
            MachineStateEvent
            | MachineLostEvent
            | MachineRetiredEvent
            | LeaseChangedEvent
            | TargetProposedEvent
            | PointPickedEvent
            | PlanUpdatedEvent
            | ThrowUpdatedEvent
            | GapUpdatedEvent
            | TwinUpdatedEvent
            | SiteUpdatedEvent
            | ZonesUpdatedEvent
            | AlertEvent
            | AlertUpdatedEvent
            | RolloutUpdatedEvent
            | JobUpdatedEvent,
            Field(discriminator="kind"),
        ]
    ]
):
    """Payload of every server-sent event; `kind` is also the event's name."""
