"""Alerts: what is wrong now, what was, who has seen it; and the systems that are notified."""

from typing import Annotated, Literal

from fastapi import APIRouter, Query

from server.dependencies import (
    Administrator,
    AlertingDep,
    AlertKeeper,
    Viewer,
)
from server.schemas.alerts import (
    AcknowledgeRequest,
    AlertPage,
    AlertRule,
    AlertView,
    SilenceRequest,
)
from server.schemas.notifications import (
    NewWebhookView,
    NotificationPage,
    NotificationView,
    WebhookRequest,
    WebhookView,
)

router = APIRouter(tags=["alerts"])


@router.get("/alerts")
def list_alerts(
    session: Viewer,
    alerting: AlertingDep,
    state: Literal["open", "cleared", "all"] = "open",
    machine_id: Annotated[str | None, Query(max_length=32)] = None,
    rule: AlertRule | None = None,
    cursor: Annotated[str | None, Query(max_length=36)] = None,
    limit: Annotated[int, Query(ge=1, le=500)] = 100,
) -> AlertPage:
    """Alerts, newest first."""
    is_open = None if state == "all" else state == "open"
    return alerting.alerts.page(
        is_open=is_open, machine_id=machine_id, rule=rule, cursor=cursor, limit=limit
    )


@router.post("/alerts/{alert_id}/acknowledge")
def acknowledge_alert(
    alert_id: str, body: AcknowledgeRequest, session: AlertKeeper, alerting: AlertingDep
) -> AlertView:
    """Say that one has seen an alert."""
    return alerting.alerts.acknowledge(alert_id, body.note, session)


@router.post("/alerts/{alert_id}/silence")
def silence_alert(
    alert_id: str, body: SilenceRequest, session: AlertKeeper, alerting: AlertingDep
) -> AlertView:
    """Let an alert, and the next of its rule and machine, call nobody for a while."""
    return alerting.alerts.silence(alert_id, body.duration_s, session)


@router.get("/webhooks")
def list_webhooks(session: Administrator, alerting: AlertingDep) -> list[WebhookView]:
    """Systems that are notified of what happens here."""
    return alerting.notifications.webhooks()


@router.post("/webhooks", status_code=201)
def create_webhook(
    body: WebhookRequest, session: Administrator, alerting: AlertingDep
) -> NewWebhookView:
    """Add a webhook; the answer holds the key of its signatures, which is never shown again."""
    return alerting.notifications.create(body, session)


@router.delete("/webhooks/{webhook_id}", status_code=204)
def remove_webhook(webhook_id: str, session: Administrator, alerting: AlertingDep) -> None:
    """Remove a webhook; what it has not got is not sent any more."""
    alerting.notifications.remove(webhook_id, session)


@router.post("/webhooks/{webhook_id}/test", status_code=202)
def test_webhook(
    webhook_id: str, session: Administrator, alerting: AlertingDep
) -> NotificationView:
    """Send a webhook a message about nothing."""
    return alerting.notifications.test(webhook_id, session)


@router.get("/notifications")
def list_notifications(
    session: Administrator,
    alerting: AlertingDep,
    cursor: Annotated[str | None, Query(max_length=36)] = None,
    limit: Annotated[int, Query(ge=1, le=500)] = 100,
) -> NotificationPage:
    """Messages to webhooks and by e-mail, newest first, with what became of them."""
    return alerting.notifications.page(cursor, limit)


@router.post("/notifications/{notification_id}/replay", status_code=202)
def replay_notification(
    notification_id: str, session: Administrator, alerting: AlertingDep
) -> NotificationView:
    """Send a message again, with the id it had."""
    return alerting.notifications.replay(notification_id, session)
