"""Alerts, their rules' watch, and what is sent about them: put together, started and closed as one."""

from server.accounts.audit_chain import AuditChain
from server.alerts.alert_watch import AlertWatch
from server.alerts.alerts import Alerts
from server.alerts.notification_outbox import NotificationOutbox
from server.alerts.notification_sender import NotificationSender
from server.event_hub import EventHub
from server.machines.machine_registry import MachineRegistry
from server.settings import Settings
from server.store.database import Database
from server.store.models import PolicyTransition


class Alerting:
    """The parts by name."""

    def __init__(
        self,
        database: Database,
        audit: AuditChain,
        hub: EventHub,
        registry: MachineRegistry,
        settings: Settings,
    ) -> None:
        self.alerts = Alerts(database, audit, hub)
        self.watch = AlertWatch(self.alerts, registry, settings)
        self.notifications = NotificationOutbox(database, audit, settings)
        self._sender = NotificationSender(self.notifications, settings)
        self.alerts.on_change.append(self.notifications.add_alert)
        database.on_insert(PolicyTransition, self.notifications.add_transition)

    def start(self) -> None:
        """Begin to judge and to send."""
        self.watch.start()
        self._sender.start()

    def close(self) -> None:
        """Stop both; what waits is sent after the next start."""
        self.watch.close()
        self._sender.close()
