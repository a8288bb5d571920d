"""Composition root: builds the long-lived parts of the service, opens them and closes them."""

import logging
from collections.abc import Generator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, fields
from functools import partial
from typing import TypeVar

import zenoh

from machine.errors import DownrangeError
from machine.spec import MachineSpec, load_spec
from runtime.link.zenoh_config import RouterTls, router_config
from server.accounts.access_control import AccessControl
from server.accounts.accounts import Accounts
from server.accounts.audit_chain import AuditChain
from server.accounts.known_devices import KnownDevices
from server.aim.aim_corrections import AimCorrections
from server.alerts.alerting import Alerting
from server.deployments.deployments import Deployments
from server.deployments.machine_policies import MachinePolicies
from server.deployments.policy_uploads import PolicyUploads
from server.deployments.site_approvals import SiteApprovals
from server.display.impact_display import ImpactDisplay
from server.display.job_display import JobDisplay
from server.display.machine_views import MachineViews
from server.display.replay_control import ReplayControl
from server.display.target_proposals import TargetProposals
from server.dossier.dossier_service import Dossiers
from server.drift.drift_diagnosis import DriftDiagnoses
from server.drift.drift_watch import DriftWatch
from server.enrolment.enrolments import Enrolments
from server.enrolment.router_accounts import router_passwords
from server.enrolment.router_renewal import RouterRenewal
from server.event_hub import EventHub
from server.fleet.machine_summaries import MachineSummaries
from server.gap.gap_previews import GapPreviews
from server.gap.gap_service import GapService
from server.gap.twin_versions import TwinVersions
from server.jobs.jobs import Jobs
from server.limits.streams import StreamLimiter
from server.machines.lease_notices import LeaseNotices
from server.machines.lease_service import LeaseService
from server.machines.machine_commands import MachineCommands
from server.machines.machine_link import MachineLink
from server.machines.machine_registry import MachineRegistry
from server.machines.stop_service import StopService
from server.machines.twin_files import TwinFiles
from server.machines.zone_notices import ZoneNotices
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
from server.store.database import Database, DatabaseStanding, upgrade
from server.throws.event_ingest import EventIngest
from server.throws.hold_relay import HoldRelay
from server.throws.throw_history import ThrowHistory
from server.throws.throw_logs import LogStore
from server.throws.throw_service import ThrowService
from server.throws.throw_statistics import ThrowStatistics
from server.throws.throw_store import ThrowStore
from server.validation.shadow_runs import ShadowRuns
from server.validation.validation_service import ValidationService
from server.validation.validation_worker import CampaignProcesses, ValidationProcess
from server.viewer.scene import ViewerScene

logger = logging.getLogger(__name__)

PartT = TypeVar("PartT")


class LinkError(DownrangeError):
    """The machines' endpoint cannot be opened."""

    code = "link"


@dataclass(frozen=True, slots=True)
class Parts:
    """The parts of one running service; routes name those they need (server/dependencies.py)."""

    settings: Settings
    database: Database
    audit: AuditChain
    accounts: Accounts
    access: AccessControl
    devices: KnownDevices
    metrics: ServiceMetrics
    hub: EventHub
    streams: StreamLimiter
    registry: MachineRegistry
    enrolments: Enrolments
    aim: AimCorrections
    alerting: Alerting
    link: MachineLink
    commands: MachineCommands
    leases: LeaseService
    policies: PolicyStore
    uploads: PolicyUploads
    machine_policies: MachinePolicies
    summaries: MachineSummaries
    approvals: SiteApprovals
    validations: ValidationService
    shadows: ShadowRuns
    deployments: Deployments
    rollouts: Rollouts
    jobs: Jobs
    throws: ThrowStore
    stops: StopService
    plans: PlanStore
    pool: PreviewPool
    planner: Planner
    holds: HoldRelay
    throw_service: ThrowService
    history: ThrowHistory
    statistics: ThrowStatistics
    logs: LogStore
    dossiers: Dossiers
    replays: ReplayControl
    gap: GapService
    drifts: DriftDiagnoses
    twin_versions: TwinVersions
    gap_previews: GapPreviews
    views: MachineViews
    sites: SiteStore
    zones: ZoneStore
    zone_notices: ZoneNotices
    targets: TargetProposals
    scene: ViewerScene

    def get(self, kind: type[PartT]) -> PartT:
        """The part of a type.

        Raises:
            LookupError: there is none.
        """
        for field in fields(self):
            part = getattr(self, field.name)
            if isinstance(part, kind):
                return part
        raise LookupError(f"the service has no {kind.__name__}")


def prepare_database(settings: Settings) -> Database:
    """Open the database; an empty one gets its schema, an older one only if the settings say so.

    Raises:
        DatabaseError: not reachable, older or newer than this software.
    """
    database = Database(settings.resolved_database_url)
    try:
        standing = database.standing()
        is_upgrade = standing is DatabaseStanding.EMPTY or (
            standing is DatabaseStanding.OLDER and settings.database_upgrade
        )
        if is_upgrade:
            logger.info("bringing %s to the newest schema", database.shown_url)
            upgrade(database.url)
        database.require_current()
    except BaseException:
        database.close()
        raise
    return database


def link_config(settings: Settings, registry: MachineRegistry) -> zenoh.Config:
    """The router's configuration for all machine accounts of the site."""
    passwords = registry.passwords()
    tls = None
    if settings.link_certificate is not None and settings.link_private_key is not None:
        tls = RouterTls(settings.link_certificate, settings.link_private_key)
    if settings.is_link_in_the_clear:
        logger.warning(
            "machines call in at %s without encryption: whoever is on that network can read and change "
            "commands; use tls/... with a certificate (docs/operations.md)",
            settings.link_listen,
        )
    return router_config(
        listen=(settings.link_listen,),
        users=router_passwords(settings.data_dir) | passwords,
        machines=sorted(passwords),
        site=settings.site,
        dictionary_file=settings.data_dir / "link" / "users.txt",
        tls=tls,
    )


@contextmanager
def open_parts(settings: Settings, scene: ViewerScene) -> Generator[Parts]:
    """Open all parts in order of dependency; close them in reverse.

    Raises:
        DownrangeError: what cannot be opened, and what to do.
    """
    with ExitStack() as stack:
        database = prepare_database(settings)
        stack.callback(database.close)
        parts, notices = assemble(settings, database, scene)
        parts.accounts.create_first_users(settings.data_dir)
        parts.registry.provision(settings.machine_slot_count)
        parts.uploads.start()
        parts.approvals.start()
        parts.plans.start()
        parts.sites.start()
        parts.throws.start()
        parts.leases.free_all()
        parts.audit.anchor()
        stack.callback(parts.audit.anchor)
        scene.start()
        stack.callback(scene.close)
        parts.pool.start()
        stack.callback(parts.pool.close)
        stack.callback(parts.logs.close)
        parts.gap.start()
        stack.callback(parts.gap.close)
        parts.validations.start()
        stack.callback(parts.validations.close)
        parts.jobs.start()
        stack.callback(parts.jobs.close)
        stack.callback(parts.hub.close)
        stack.callback(notices.close)
        stack.callback(parts.zone_notices.close)
        stack.callback(parts.link.close)
        try:
            parts.link.open(link_config(settings, parts.registry))
        except zenoh.ZError as error:
            raise LinkError(
                f"machines cannot call in at {settings.link_listen} ({error}); is another server "
                "running? Set DOWNRANGE_LINK_LISTEN to a free endpoint"
            ) from error
        renewal = RouterRenewal(
            parts.link,
            parts.registry,
            lambda: link_config(settings, parts.registry),
            lambda: router_passwords(settings.data_dir),
        )
        renewal.start()
        stack.callback(renewal.close)
        parts.alerting.start()
        stack.callback(parts.alerting.close)
        parts.rollouts.begin()
        stack.callback(parts.rollouts.close)
        parts.stops.start()
        stack.callback(parts.stops.close)
        yield parts


def assemble(
    settings: Settings, database: Database, scene: ViewerScene
) -> tuple[Parts, LeaseNotices]:
    """Build all parts; nothing is opened or started yet."""
    spec, metrics, hub = load_spec(), ServiceMetrics(), EventHub()
    audit = AuditChain(database, settings.data_dir / "audit-anchors.jsonl")
    accounts = Accounts(database, audit, settings.session_s)
    registry = MachineRegistry(database, audit, settings.site, settings.data_dir)
    policies, uploads, approvals = _policy_parts(settings, database, audit, spec)
    machine_policies = MachinePolicies(database, registry, policies)
    deployments = Deployments(database, audit, registry, policies, approvals, spec)
    throws = ThrowStore(database, audit, registry, policies, hub)
    ingest = EventIngest(database, throws, hub, metrics, policies.name_of)
    link = MachineLink(settings.site, registry, ingest.take, metrics)
    commands = MachineCommands(database, audit, link, registry, metrics)
    leases = _leases(settings, database, audit, registry, hub)
    notices, holds = LeaseNotices(leases, registry, commands), HoldRelay(link, registry, metrics)
    stops = StopService(database, audit, link, registry, hub)
    plans, twins = PlanStore(database), TwinFiles(settings.data_dir, spec)
    pool = PreviewPool(settings.preview_worker_count, policies.active_folders())
    sites, zones = _site_parts(settings, database, audit, registry, hub, accounts)
    impacts = ImpactDisplay(database, scene)
    aim = AimCorrections(database, audit, registry, policies, twins)
    around = (pool, twins, sites, zones, hub, scene, spec, settings.plan_ttl_s, aim.shift)
    planner = Planner(plans, registry, policies, *around)
    logs, gap, twin_versions = _gap_parts(settings, database, audit, registry, twins, hub)
    parts = Parts(
        settings=settings,
        database=database,
        audit=audit,
        accounts=accounts,
        access=AccessControl(accounts, audit, settings),
        devices=KnownDevices(settings.data_dir / "device-cookie.key"),
        metrics=metrics,
        hub=hub,
        streams=StreamLimiter(metrics),
        registry=registry,
        enrolments=Enrolments(database, audit, registry, approvals, settings),
        aim=aim,
        alerting=Alerting(database, audit, hub, registry, settings),
        link=link,
        commands=commands,
        leases=leases,
        policies=policies,
        uploads=uploads,
        machine_policies=machine_policies,
        summaries=MachineSummaries(database, registry, machine_policies, policies),
        approvals=approvals,
        validations=_validations(settings, database, audit, policies),
        shadows=ShadowRuns(database, policies, logs, spec),
        deployments=deployments,
        rollouts=Rollouts(database, audit, registry, policies, deployments, hub),
        jobs=Jobs(database, audit, registry, policies, sites, zones, hub, spec),
        throws=throws,
        stops=stops,
        plans=plans,
        pool=pool,
        planner=planner,
        holds=holds,
        throw_service=ThrowService(
            database, registry, leases, plans, sites, zones, throws, commands, holds, aim
        ),
        history=ThrowHistory(database),
        statistics=ThrowStatistics(database),
        logs=logs,
        dossiers=Dossiers(database, audit, logs, policies, approvals, settings),
        replays=ReplayControl(logs, plans, scene),
        gap=gap,
        drifts=DriftDiagnoses(database, registry, machine_policies, gap, settings),
        twin_versions=twin_versions,
        gap_previews=GapPreviews(registry, policies, pool, twins, twin_versions, settings.data_dir),
        views=MachineViews(registry, leases, policies, throws, stops, hub, scene, metrics),
        sites=sites,
        zones=zones,
        zone_notices=ZoneNotices(zones.approved, registry, commands),
        targets=TargetProposals(scene, policies, sites, zones, hub, impacts, registry, spec),
        scene=scene,
    )
    _connect(parts, ingest, impacts)
    return parts, notices


def _site_parts(
    settings: Settings,
    database: Database,
    audit: AuditChain,
    registry: MachineRegistry,
    hub: EventHub,
    accounts: Accounts,
) -> tuple[SiteStore, ZoneStore]:
    return (
        SiteStore(database, audit, registry, hub, settings.data_dir),
        ZoneStore(database, audit, registry, hub, partial(_needs_two, settings, accounts)),
    )


def _needs_two(settings: Settings, accounts: Accounts) -> bool:
    """Whether whoever drew zones may not approve them."""
    if settings.zones_four_eyes is None:
        return accounts.count_with(Permission.ZONES_APPROVE) > 1
    return settings.zones_four_eyes


def _leases(
    settings: Settings,
    database: Database,
    audit: AuditChain,
    registry: MachineRegistry,
    hub: EventHub,
) -> LeaseService:
    ttl_s, idle_s = settings.lease_ttl_s, settings.lease_idle_s
    return LeaseService(database, audit, registry, hub, ttl_s=ttl_s, idle_s=idle_s)


def _gap_parts(
    settings: Settings,
    database: Database,
    audit: AuditChain,
    registry: MachineRegistry,
    twins: TwinFiles,
    hub: EventHub,
) -> tuple[LogStore, GapService, TwinVersions]:
    logs = LogStore(database, audit, settings.data_dir, settings.log_max_bytes)
    gap = GapService(database, audit, registry, logs, twins, hub)
    return logs, gap, TwinVersions(database, audit, registry, twins, gap.store, hub)


def _policy_parts(
    settings: Settings, database: Database, audit: AuditChain, spec: MachineSpec
) -> tuple[PolicyStore, PolicyUploads, SiteApprovals]:
    uploaded_dir = settings.data_dir / "uploaded-policies"
    policies = PolicyStore(database, settings.policies_dir, spec, uploaded_dir)
    approvals = SiteApprovals(
        database,
        audit,
        policies,
        settings.site,
        settings.data_dir,
        is_four_eyes=settings.policy_four_eyes,
    )
    uploads = PolicyUploads(policies, audit, uploaded_dir, settings.min_free_bytes)
    return policies, uploads, approvals


def _validations(
    settings: Settings, database: Database, audit: AuditChain, policies: PolicyStore
) -> ValidationService:
    processes = CampaignProcesses(settings.campaign_process_count, settings.campaign_scheduler)
    return ValidationService(
        database, audit, policies, settings.data_dir, ValidationProcess(processes)
    )


def _connect(parts: Parts, ingest: EventIngest, impacts: ImpactDisplay) -> None:
    """Tell the parts of each other's news."""
    ingest.on_store += [parts.machine_policies.record, parts.deployments.record]
    parts.deployments.on_change.append(parts.alerting.notifications.add_deployment)
    parts.rollouts.on_change.append(
        lambda session, data: parts.alerting.notifications.add(session, "rollout.changed", data)
    )
    parts.throws.on_change += [impacts.refresh, parts.rollouts.note, parts.jobs.note_throw]
    drift = DriftWatch(parts.database, parts.registry, parts.machine_policies)
    drift.on_found.append(parts.drifts.start_due)
    parts.throws.on_change.append(drift.note)
    parts.alerting.watch.sources += [drift.verdicts, parts.rollouts.verdicts]
    ingest.on_event += [
        parts.alerting.watch.take_event,
        drift.take_event,
        parts.aim.take_event,
        parts.rollouts.take_event,
    ]
    ingest.on_throw_end.append(parts.holds.end)
    parts.sites.on_change.append(parts.targets.show_site)
    parts.zones.on_change.append(parts.zone_notices.changed)
    parts.zones.on_change.append(parts.targets.show_zones)
    parts.sites.on_change.append(parts.jobs.note_surroundings)
    parts.sites.surface_at = parts.jobs.surface_at
    parts.planner.material_of = parts.jobs.thrown_material
    parts.zones.on_change.append(parts.jobs.note_surroundings)
    parts.leases.on_new_epoch.append(lambda machine_id, _: parts.holds.revoke(machine_id))
    parts.leases.on_new_epoch.append(lambda machine_id, _: parts.views.publish(machine_id))
    parts.stops.on_stop.append(parts.throw_service.forget)
    material = JobDisplay(parts.scene, parts.jobs.material)
    parts.targets.on_watch.append(material.watch)
    parts.jobs.on_change.append(material.refresh)
    parts.accounts.on_session_end(parts.leases.end_session)
    for part in (parts.hub, parts.targets, parts.replays, material):
        parts.accounts.on_session_end(
            lambda session, part=part: part.end_session(session.session_id)
        )
