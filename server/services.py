"""The long-lived parts of the service, put together and opened once; routes get them from here."""

import logging
from collections.abc import Generator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Annotated

import zenoh
from fastapi import Depends
from starlette.requests import HTTPConnection

from machine.errors import DownrangeError
from machine.spec import load_spec
from runtime.link.zenoh_config import RouterTls, router_config
from server.accounts.audit import AuditChain
from server.accounts.auth import Accounts
from server.events import EventHub
from server.gap.preview import GapPreviews
from server.gap.runs import GapDesk
from server.gap.twin_versions import TwinVersions
from server.limits.streams import StreamDesk
from server.machines.commands import CommandDesk
from server.machines.lease_notices import LeaseNotices
from server.machines.leases import LeaseBook
from server.machines.machine_link import MachineLink
from server.machines.machine_views import MachineViews
from server.machines.machines import Registry
from server.machines.stops import StopDesk
from server.machines.twins import TwinFiles
from server.metrics import Metrics
from server.plans.plan_store import PlanStore
from server.plans.plans import Planner
from server.plans.policies import PolicyShelf
from server.plans.preview_pool import PreviewPool
from server.plans.sites import SiteBook
from server.plans.targets import TargetDesk
from server.settings import Settings
from server.store.database import Database, DatabaseStanding, upgrade
from server.store.ingest import EventIngest
from server.throws.history import History
from server.throws.hold import HoldDesk
from server.throws.impact_board import ImpactBoard
from server.throws.replays import Replays
from server.throws.stats import Statistics
from server.throws.throw_desk import ThrowDesk
from server.throws.throw_logs import LogStore
from server.throws.throws import ThrowBook
from server.viewer.scene import ViewerScene

logger = logging.getLogger(__name__)


class LinkError(DownrangeError):
    """The machines' endpoint cannot be opened."""

    code = "link"


@dataclass(frozen=True, slots=True)
class Services:
    """What routes work with."""

    settings: Settings
    database: Database
    audit: AuditChain
    accounts: Accounts
    metrics: Metrics
    hub: EventHub
    streams: StreamDesk
    registry: Registry
    link: MachineLink
    commands: CommandDesk
    leases: LeaseBook
    policies: PolicyShelf
    throws: ThrowBook
    stops: StopDesk
    plans: PlanStore
    pool: PreviewPool
    planner: Planner
    holds: HoldDesk
    throw_desk: ThrowDesk
    history: History
    statistics: Statistics
    logs: LogStore
    replays: Replays
    gap: GapDesk
    twin_versions: TwinVersions
    gap_previews: GapPreviews
    views: MachineViews
    sites: SiteBook
    targets: TargetDesk
    scene: ViewerScene


def get_services(connection: HTTPConnection) -> Services:
    """The services of the application that serves this connection."""
    services = connection.app.state.services
    assert isinstance(services, Services)
    return services


ServicesDep = Annotated[Services, Depends(get_services)]


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


def link_config(settings: Settings, registry: Registry) -> zenoh.Config:
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
        users=passwords,
        machines=sorted(passwords),
        site=settings.site,
        dictionary_file=settings.data_dir / "link" / "users.txt",
        tls=tls,
    )


@contextmanager
def open_services(settings: Settings, scene: ViewerScene) -> Generator[Services]:
    """Open everything, in the order of need; close it in reverse.

    Raises:
        DownrangeError: what cannot be opened, and what to do.
    """
    with ExitStack() as stack:
        database = prepare_database(settings)
        stack.callback(database.close)
        services, notices = assemble(settings, database, scene)
        services.accounts.create_first_users(settings.data_dir)
        services.registry.provision(settings.machine_slot_count)
        services.plans.start()
        services.sites.start()
        services.throws.start()
        services.leases.free_all()
        services.audit.anchor()
        stack.callback(services.audit.anchor)
        scene.start()
        stack.callback(scene.close)
        services.pool.start()
        stack.callback(services.pool.close)
        services.gap.start()
        stack.callback(services.gap.close)
        stack.callback(services.hub.close)
        stack.callback(notices.close)
        stack.callback(services.link.close)
        try:
            services.link.open(link_config(settings, services.registry))
        except zenoh.ZError as error:
            raise LinkError(
                f"machines cannot call in at {settings.link_listen} ({error}); is another server "
                "running? Set DOWNRANGE_LINK_LISTEN to a free endpoint"
            ) from error
        services.stops.start()
        stack.callback(services.stops.close)
        yield services


def assemble(
    settings: Settings, database: Database, scene: ViewerScene
) -> tuple[Services, LeaseNotices]:
    """Put the parts together; nothing is opened or started yet."""
    spec = load_spec()
    metrics, hub = Metrics(), EventHub()
    audit = AuditChain(database, settings.data_dir / "audit-anchors.jsonl")
    accounts = Accounts(database, audit, settings.session_s)
    registry = Registry(database, audit, settings.site, settings.data_dir)
    policies = PolicyShelf(database, settings.policies_dir, spec)
    throws = ThrowBook(database, audit, registry, policies, hub)
    ingest = EventIngest(database, throws, hub, metrics)
    link = MachineLink(settings.site, registry, ingest.take, metrics)
    commands = CommandDesk(database, audit, link, registry, metrics)
    leases = LeaseBook(
        database, audit, registry, hub, ttl_s=settings.lease_ttl_s, idle_s=settings.lease_idle_s
    )
    notices = LeaseNotices(leases, registry, commands)
    stops = StopDesk(database, audit, link, registry, hub)
    plans = PlanStore(database)
    pool = PreviewPool(settings.preview_worker_count, policies.active_folders())
    twins = TwinFiles(settings.data_dir, spec)
    sites = SiteBook(database, audit, registry, hub, settings.data_dir)
    planner = Planner(
        plans, registry, policies, pool, twins, sites, hub, scene, spec, settings.plan_ttl_s
    )
    holds = HoldDesk(link, registry, metrics)
    throw_desk = ThrowDesk(database, registry, leases, plans, sites, throws, commands, holds)
    logs = LogStore(database, audit, settings.data_dir, settings.log_max_bytes)
    replays = Replays(logs, plans, scene)
    gap = GapDesk(database, audit, registry, logs, twins, hub)
    twin_versions = TwinVersions(database, audit, registry, twins, gap.store, hub)
    gap_previews = GapPreviews(registry, policies, pool, twins, twin_versions, settings.data_dir)
    views = MachineViews(registry, leases, policies, throws, stops, hub, scene, metrics)
    board = ImpactBoard(database, scene)
    throws.on_change.append(board.refresh)
    targets = TargetDesk(scene, policies, sites, hub, board)
    sites.on_change.append(targets.show_site)
    leases.on_new_epoch.append(lambda machine_id, _: holds.revoke(machine_id))
    leases.on_new_epoch.append(lambda machine_id, _: views.publish(machine_id))
    ingest.on_throw_end.append(holds.end)

    accounts.on_session_end(leases.end_session)
    for part in (hub, targets, replays):
        accounts.on_session_end(lambda session, part=part: part.end_session(session.session_id))
    services = Services(
        settings=settings,
        database=database,
        audit=audit,
        accounts=accounts,
        metrics=metrics,
        hub=hub,
        streams=StreamDesk(metrics),
        registry=registry,
        link=link,
        commands=commands,
        leases=leases,
        policies=policies,
        throws=throws,
        stops=stops,
        plans=plans,
        pool=pool,
        planner=planner,
        holds=holds,
        throw_desk=throw_desk,
        history=History(database),
        statistics=Statistics(database),
        logs=logs,
        replays=replays,
        gap=gap,
        twin_versions=twin_versions,
        gap_previews=gap_previews,
        views=views,
        sites=sites,
        targets=targets,
        scene=scene,
    )
    return services, notices
