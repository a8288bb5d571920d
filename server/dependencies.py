"""FastAPI dependencies: the parts of the service that a route needs, and who may call it.

Those that hand out a part are coroutines: a plain function would wait for one of the framework's threads.
"""

import hmac
from collections.abc import Awaitable, Callable
from typing import Annotated, Protocol, TypeVar

from fastapi import Depends, Header
from pydantic import SecretStr
from starlette.requests import HTTPConnection

from server.accounts.access_control import AccessControl
from server.accounts.accounts import Accounts, Session
from server.accounts.audit_chain import AuditChain
from server.accounts.known_devices import KnownDevices
from server.aim.aim_corrections import AimCorrections
from server.alerts.alerting import Alerting
from server.deployments.deployments import Deployments
from server.deployments.machine_policies import MachinePolicies
from server.deployments.policy_uploads import PolicyUploads
from server.deployments.site_approvals import SiteApprovals
from server.display.machine_views import MachineViews
from server.display.replay_control import ReplayControl
from server.display.target_proposals import TargetProposals
from server.dossier.dossier_service import Dossiers
from server.drift.drift_diagnosis import DriftDiagnoses
from server.enrolment.enrolments import Enrolments
from server.errors import NotSignedInError
from server.event_hub import EventHub
from server.fleet.machine_summaries import MachineSummaries
from server.gap.gap_previews import GapPreviews
from server.gap.gap_service import GapService
from server.gap.twin_versions import TwinVersions
from server.jobs.jobs import Jobs
from server.limits.streams import StreamLimiter
from server.machines.lease_service import LeaseService
from server.machines.machine_commands import MachineCommands
from server.machines.machine_link import MachineLink
from server.machines.machine_registry import MachineRegistry
from server.machines.stop_service import StopService
from server.metrics import ServiceMetrics
from server.plans.plan_store import PlanStore
from server.plans.planner import Planner
from server.plans.policy_store import PolicyStore
from server.plans.preview_pool import PreviewPool
from server.plans.site_store import SiteStore
from server.plans.zone_store import ZoneStore
from server.rollouts.rollouts import Rollouts
from server.schemas.console import Permission
from server.settings import Settings
from server.store.database import Database
from server.throws.hold_relay import HoldRelay
from server.throws.throw_history import ThrowHistory
from server.throws.throw_logs import LogStore
from server.throws.throw_service import ThrowService
from server.throws.throw_statistics import ThrowStatistics
from server.throws.throw_store import ThrowStore
from server.validation.shadow_runs import ShadowRuns
from server.validation.validation_service import ValidationService

PartT = TypeVar("PartT")


class _Parts(Protocol):
    """What the composition root puts into the application's state."""

    def get(self, kind: type[PartT]) -> PartT: ...


def _get(kind: type[PartT]) -> Callable[[HTTPConnection], Awaitable[PartT]]:
    async def get(connection: HTTPConnection) -> PartT:
        parts: _Parts = connection.app.state.parts
        return parts.get(kind)

    return get


AccessDep = Annotated[AccessControl, Depends(_get(AccessControl))]
AccountsDep = Annotated[Accounts, Depends(_get(Accounts))]
AimDep = Annotated[AimCorrections, Depends(_get(AimCorrections))]
AlertingDep = Annotated[Alerting, Depends(_get(Alerting))]
ApprovalsDep = Annotated[SiteApprovals, Depends(_get(SiteApprovals))]
AuditDep = Annotated[AuditChain, Depends(_get(AuditChain))]
CommandsDep = Annotated[MachineCommands, Depends(_get(MachineCommands))]
DeploymentsDep = Annotated[Deployments, Depends(_get(Deployments))]
DevicesDep = Annotated[KnownDevices, Depends(_get(KnownDevices))]
DossiersDep = Annotated[Dossiers, Depends(_get(Dossiers))]
DriftDiagnosesDep = Annotated[DriftDiagnoses, Depends(_get(DriftDiagnoses))]
EnrolmentsDep = Annotated[Enrolments, Depends(_get(Enrolments))]
DatabaseDep = Annotated[Database, Depends(_get(Database))]
GapDep = Annotated[GapService, Depends(_get(GapService))]
GapPreviewsDep = Annotated[GapPreviews, Depends(_get(GapPreviews))]
HistoryDep = Annotated[ThrowHistory, Depends(_get(ThrowHistory))]
HoldsDep = Annotated[HoldRelay, Depends(_get(HoldRelay))]
HubDep = Annotated[EventHub, Depends(_get(EventHub))]
JobsDep = Annotated[Jobs, Depends(_get(Jobs))]
LeasesDep = Annotated[LeaseService, Depends(_get(LeaseService))]
LinkDep = Annotated[MachineLink, Depends(_get(MachineLink))]
LogsDep = Annotated[LogStore, Depends(_get(LogStore))]
MachinePoliciesDep = Annotated[MachinePolicies, Depends(_get(MachinePolicies))]
MetricsDep = Annotated[ServiceMetrics, Depends(_get(ServiceMetrics))]
PlannerDep = Annotated[Planner, Depends(_get(Planner))]
PlansDep = Annotated[PlanStore, Depends(_get(PlanStore))]
PoliciesDep = Annotated[PolicyStore, Depends(_get(PolicyStore))]
PreviewPoolDep = Annotated[PreviewPool, Depends(_get(PreviewPool))]
UploadsDep = Annotated[PolicyUploads, Depends(_get(PolicyUploads))]
RegistryDep = Annotated[MachineRegistry, Depends(_get(MachineRegistry))]
ReplaysDep = Annotated[ReplayControl, Depends(_get(ReplayControl))]
RolloutsDep = Annotated[Rollouts, Depends(_get(Rollouts))]
SettingsDep = Annotated[Settings, Depends(_get(Settings))]
ShadowsDep = Annotated[ShadowRuns, Depends(_get(ShadowRuns))]
SitesDep = Annotated[SiteStore, Depends(_get(SiteStore))]
StatisticsDep = Annotated[ThrowStatistics, Depends(_get(ThrowStatistics))]
StopsDep = Annotated[StopService, Depends(_get(StopService))]
StreamsDep = Annotated[StreamLimiter, Depends(_get(StreamLimiter))]
SummariesDep = Annotated[MachineSummaries, Depends(_get(MachineSummaries))]
TargetsDep = Annotated[TargetProposals, Depends(_get(TargetProposals))]
ThrowServiceDep = Annotated[ThrowService, Depends(_get(ThrowService))]
ThrowsDep = Annotated[ThrowStore, Depends(_get(ThrowStore))]
TwinVersionsDep = Annotated[TwinVersions, Depends(_get(TwinVersions))]
ValidationsDep = Annotated[ValidationService, Depends(_get(ValidationService))]
ZonesDep = Annotated[ZoneStore, Depends(_get(ZoneStore))]
ViewsDep = Annotated[MachineViews, Depends(_get(MachineViews))]


def check_write(connection: HTTPConnection, access: AccessDep) -> None:
    """Refuse writes from other pages before the body is read."""
    access.check_write(connection)


def current_session(connection: HTTPConnection, access: AccessDep) -> Session:
    """The caller's session.

    Raises:
        NotSignedInError: none, or it has ended.
    """
    return access.session_of(connection)


SessionDep = Annotated[Session, Depends(current_session)]


def requires(
    permission: Permission,
) -> Callable[[HTTPConnection, AccessDep, SessionDep], Session]:
    """A dependency that admits only holders of a permission."""

    def check(connection: HTTPConnection, access: AccessDep, session: SessionDep) -> Session:
        return access.require(connection, session, permission)

    return check


Viewer = Annotated[Session, Depends(requires(Permission.VIEW))]
Lessee = Annotated[Session, Depends(requires(Permission.LEASE))]
Thrower = Annotated[Session, Depends(requires(Permission.THROW))]
ImpactMarker = Annotated[Session, Depends(requires(Permission.IMPACT_MARK))]
AlertKeeper = Annotated[Session, Depends(requires(Permission.ALERT_ACKNOWLEDGE))]
LeaseTaker = Annotated[Session, Depends(requires(Permission.LEASE_TAKE))]
StopClearer = Annotated[Session, Depends(requires(Permission.STOP_CLEAR))]
GapRunner = Annotated[Session, Depends(requires(Permission.GAP_RUN))]
TwinKeeper = Annotated[Session, Depends(requires(Permission.TWIN_APPLY))]
AimKeeper = Annotated[Session, Depends(requires(Permission.AIM_APPLY))]
SiteEditor = Annotated[Session, Depends(requires(Permission.SITE_EDIT))]
ZoneApprover = Annotated[Session, Depends(requires(Permission.ZONES_APPROVE))]
Uploader = Annotated[Session, Depends(requires(Permission.POLICY_UPLOAD))]
Validator = Annotated[Session, Depends(requires(Permission.POLICY_VALIDATE))]
Approver = Annotated[Session, Depends(requires(Permission.POLICY_APPROVE))]
Deployer = Annotated[Session, Depends(requires(Permission.POLICY_DEPLOY))]
Auditor = Annotated[Session, Depends(requires(Permission.AUDIT_READ))]
Administrator = Annotated[Session, Depends(requires(Permission.ADMIN))]
MachineEditor = Annotated[Session, Depends(requires(Permission.MACHINE_EDIT))]
Enroller = Annotated[Session, Depends(requires(Permission.MACHINE_ENROL))]


def admit_reader(
    connection: HTTPConnection,
    access: AccessControl,
    token: SecretStr | None,
    variable: str,
    permission: Permission,
) -> None:
    """Admit a program by a bearer token of the settings, or a session with a permission.

    Args:
        connection: of the caller.
        access: checks sessions.
        token: of the settings; None: no token counts.
        variable: of the environment that sets it, for the refusal.
        permission: of a session.

    Raises:
        NotSignedInError: neither.
        ForbiddenError: a session without the permission.
    """
    scheme, _, given = connection.headers.get("authorization", "").partition(" ")
    if scheme.lower() == "bearer":
        if token is not None and hmac.compare_digest(
            given.encode(), token.get_secret_value().encode()
        ):
            return
        raise NotSignedInError("wrong_token", f"This is not the token of {variable}.")
    access.require(connection, access.session_of(connection), permission)


def require_machine(
    machine_id: str, registry: RegistryDep, authorization: Annotated[str, Header()] = ""
) -> str:
    """Admit a machine by its own token.

    Raises:
        NotSignedInError: it is not this machine's.
    """
    token = authorization.removeprefix("Bearer ")
    if token == authorization or not registry.is_token_of(machine_id, token):
        raise NotSignedInError("wrong_token", f"This is not the token of {machine_id[:40]}.")
    return machine_id


MachineCaller = Annotated[str, Depends(require_machine)]
