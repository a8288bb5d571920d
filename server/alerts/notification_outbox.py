"""Messages to other systems, stored in the transaction of what they tell of: none is lost or invented."""

import json
from collections.abc import Mapping
from datetime import timedelta
from typing import Any, Final
from urllib.parse import urlsplit

from sqlalchemy import delete, func, select
from sqlalchemy.orm import Session as DatabaseSession

from server.accounts.accounts import Session
from server.accounts.audit_chain import AuditChain, Entry
from server.alerts.webhook_request import destination, new_secret
from server.clock import new_id, utc_now
from server.errors import ApiError, NotFoundError
from server.schemas.alerts import AlertView
from server.schemas.deployments import DeploymentView
from server.schemas.notifications import (
    NewWebhookView,
    NotificationPage,
    NotificationView,
    Topic,
    WebhookRequest,
    WebhookView,
)
from server.settings import Settings
from server.store.alert_models import Notification, Webhook
from server.store.database import Database
from server.store.models import PolicyTransition

FIRST_RETRY_S: Final = 5.0
LAST_RETRY_S: Final = 3600.0
ATTEMPTS_COUNT: Final = 80
"""With the delays doubling up to an hour: given up after about three days."""
TEST: Final[Topic] = "webhook.test"


def retry_delay_s(attempts_count: int) -> float | None:
    """Time from a failed attempt to the next; None: it is given up."""
    if attempts_count >= ATTEMPTS_COUNT:
        return None
    return min(FIRST_RETRY_S * 2.0 ** min(attempts_count - 1, 20), LAST_RETRY_S)


def _was_sent(database: DatabaseSession, alert: AlertView) -> bool:
    """Whether anybody was sent the beginning of an alert."""
    query = select(Notification.notification_id).where(
        Notification.topic == "alert.opened",
        Notification.created_utc >= alert.opened_utc,
        Notification.body.contains(alert.alert_id),
    )
    return database.scalar(query.limit(1)) is not None


class NotificationOutbox:
    """Keeps webhooks and the messages to them; thread-safe."""

    def __init__(self, database: Database, audit: AuditChain, settings: Settings) -> None:
        self._database = database
        self._audit = audit
        self._settings = settings

    # What happens ---------------------------------------------------------------------------------

    def add_alert(self, database: DatabaseSession, topic: Topic, alert: AlertView) -> None:
        """Tell of an alert; inside the transaction that changes it.

        One that is silent from its beginning is kept back. The end of one whose beginning was sent is sent
        as well: the other system would take it for open for ever.
        """
        until_utc = alert.silenced_until_utc
        is_silent = until_utc is not None and until_utc > utc_now()
        if is_silent and (topic == "alert.opened" or not _was_sent(database, alert)):
            return
        self.add(database, topic, alert.model_dump(mode="json"))

    def add_deployment(self, database: DatabaseSession, deployment: DeploymentView) -> None:
        """Tell of a deployment; inside the transaction that changes it."""
        self.add(database, "deployment.changed", deployment.model_dump(mode="json"))

    def add_transition(self, database: DatabaseSession, row: PolicyTransition) -> None:
        """Tell of a step in the life of a policy version; inside the transaction that adds it."""
        data = {
            "policy_sha256": row.policy_sha256,
            "from_state": row.from_state,
            "to_state": row.to_state,
            "actor": row.actor,
            "reason": row.reason,
            "at_utc": row.at_utc.isoformat(),
        }
        self.add(database, "policy.changed", data)

    def add(self, database: DatabaseSession, topic: Topic, data: Mapping[str, Any]) -> None:
        """Store a message for every receiver of a topic; inside the transaction of what it tells of."""
        for webhook in database.scalars(select(Webhook)):
            if topic in webhook.topics:
                self._put(database, webhook.webhook_id, topic, data)
        if topic == "alert.opened" and self._settings.has_mail:
            self._put(database, None, topic, data)

    @staticmethod
    def _put(
        database: DatabaseSession, webhook_id: str | None, topic: Topic, data: Mapping[str, Any]
    ) -> Notification:
        now_utc = utc_now()
        body = {"type": topic, "timestamp": now_utc.isoformat(), "data": data}
        row = Notification(
            notification_id=new_id(),
            webhook_id=webhook_id,
            topic=topic,
            body=json.dumps(body, separators=(",", ":")),
            created_utc=now_utc,
            attempts_count=0,
            next_utc=now_utc,
            delivered_utc=None,
            answer="",
        )
        database.add(row)
        return row

    # People ---------------------------------------------------------------------------------------

    def webhooks(self) -> list[WebhookView]:
        """All webhooks, oldest first."""
        with self._database.read() as database:
            rows = database.scalars(select(Webhook).order_by(Webhook.webhook_id)).all()
        return [_webhook_view(row) for row in rows]

    def create(self, body: WebhookRequest, session: Session) -> NewWebhookView:
        """Add a webhook; its secret is in the answer and nowhere else again.

        Raises:
            WebhookAddressError: an address that is not sent to.
        """
        destination(body.url, may_be_private=self._settings.webhook_private)
        row = Webhook(
            webhook_id=new_id(),
            url=body.url,
            secret=new_secret(),
            topics=list(body.topics),
            created_by=session.username,
            created_utc=utc_now(),
        )
        with self._database.write() as database:
            database.add(row)
            database.flush()
            self._record(database, "webhook.create", row, session)
        return NewWebhookView(webhook=_webhook_view(row), secret=row.secret)

    def remove(self, webhook_id: str, session: Session) -> None:
        """Remove a webhook; what it has not got is not sent any more, the history stays.

        Raises:
            NotFoundError: no such webhook.
        """
        with self._database.write() as database:
            row = _webhook(database, webhook_id)
            self._record(database, "webhook.remove", row, session)
            database.execute(delete(Webhook).where(Webhook.webhook_id == webhook_id))
            waiting = select(Notification).where(
                Notification.webhook_id == webhook_id, Notification.next_utc.is_not(None)
            )
            for message in database.scalars(waiting):
                message.next_utc, message.answer = None, "the webhook was removed"

    def test(self, webhook_id: str, session: Session) -> NotificationView:
        """Send a webhook a message about nothing.

        Raises:
            NotFoundError: no such webhook.
        """
        with self._database.write() as database:
            row = _webhook(database, webhook_id)
            message = self._put(database, row.webhook_id, TEST, {"asked_by": session.username})
            database.flush()
            return _view(message)

    def replay(self, notification_id: str, session: Session) -> NotificationView:
        """Send a message again, with the id it had.

        Raises:
            NotFoundError: no such message.
            ApiError: its webhook was removed.
        """
        with self._database.write() as database:
            row = database.get(Notification, notification_id)
            if row is None:
                raise NotFoundError(
                    "no_notification", f"There is no message {notification_id[:40]}."
                )
            if row.webhook_id is not None and database.get(Webhook, row.webhook_id) is None:
                raise ApiError("webhook_removed", "The webhook of this message was removed.")
            row.attempts_count, row.next_utc, row.delivered_utc = 0, utc_now(), None
            detail = {"notification_id": row.notification_id}
            entry = Entry(session.actor, "notification.replay", "fact", detail={**detail})
            self._audit.append(database, entry)
            return _view(row)

    def page(self, cursor: str | None, limit: int) -> NotificationPage:
        """Messages, newest first."""
        query = select(Notification).order_by(Notification.notification_id.desc()).limit(limit + 1)
        if cursor is not None:
            query = query.where(Notification.notification_id < cursor)
        with self._database.read() as database:
            rows = database.scalars(query).all()
        return NotificationPage(
            rows=tuple(_view(row) for row in rows[:limit]),
            next_cursor=rows[limit - 1].notification_id if len(rows) > limit else None,
        )

    # Sending --------------------------------------------------------------------------------------

    def due(self) -> list[tuple[Notification, Webhook | None]]:
        """First message of each receiver that is to be tried now, the longest waiting first, and webhook."""
        place = func.row_number().over(
            partition_by=func.coalesce(Notification.webhook_id, ""),
            order_by=(Notification.next_utc, Notification.notification_id),
        )
        waiting = (
            select(Notification.notification_id, place.label("place_count"))
            .where(Notification.next_utc <= utc_now())
            .subquery()
        )
        query = (
            select(Notification, Webhook)
            .join(waiting, waiting.c.notification_id == Notification.notification_id)
            .outerjoin(Webhook, Webhook.webhook_id == Notification.webhook_id)
            .where(waiting.c.place_count == 1)
            .order_by(Notification.next_utc)
        )
        with self._database.read() as database:
            return [(row[0], row[1]) for row in database.execute(query)]

    def note(self, notification_id: str, *, is_delivered: bool, answer: str) -> None:
        """Write down what became of an attempt."""
        now_utc = utc_now()
        with self._database.write() as database:
            row = database.get(Notification, notification_id)
            if row is None or row.next_utc is None:
                return  # its webhook was removed meanwhile
            row.attempts_count += 1
            row.answer = answer[:300]
            if is_delivered:
                row.delivered_utc, row.next_utc = now_utc, None
                return
            delay_s = retry_delay_s(row.attempts_count)
            row.next_utc = None if delay_s is None else now_utc + timedelta(seconds=delay_s)

    def _record(
        self, database: DatabaseSession, action: str, row: Webhook, session: Session
    ) -> None:
        # Path and query may be the receiver's secret.
        parts = urlsplit(row.url)
        detail = {"webhook_id": row.webhook_id, "to": f"{parts.scheme}://{parts.hostname}"}
        self._audit.append(database, Entry(session.actor, action, "fact", detail={**detail}))


def _webhook(database: DatabaseSession, webhook_id: str) -> Webhook:
    row = database.get(Webhook, webhook_id)
    if row is None:
        raise NotFoundError("no_webhook", f"There is no webhook {webhook_id[:40]}.")
    return row


def _webhook_view(row: Webhook) -> WebhookView:
    return WebhookView.model_validate(
        {name: getattr(row, name) for name in WebhookView.model_fields}
    )


def _view(row: Notification) -> NotificationView:
    return NotificationView.model_validate(
        {name: getattr(row, name) for name in NotificationView.model_fields}
    )
