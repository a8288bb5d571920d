"""Webhooks and the messages that other systems get."""

from datetime import datetime
from typing import Literal

from pydantic import Field

from server.schemas.console import Request, View

Topic = Literal[
    "alert.opened",
    "alert.cleared",
    "alert.acknowledged",
    "deployment.changed",
    "policy.changed",
    "rollout.changed",
    "webhook.test",
]


class WebhookRequest(Request):
    """An address to tell of what happens here."""

    url: str = Field(min_length=10, max_length=500)
    topics: tuple[Topic, ...] = ("alert.opened", "alert.cleared", "deployment.changed")


class WebhookView(View):
    """A webhook; its secret is never shown again."""

    webhook_id: str
    url: str
    topics: tuple[Topic, ...]
    created_by: str
    created_utc: datetime


class NewWebhookView(View):
    """A webhook that was just made."""

    webhook: WebhookView
    secret: str
    """Key of the signatures, `whsec_` and base64; keep it now."""


class NotificationView(View):
    """A message to one receiver."""

    notification_id: str
    """Also the header `webhook-id`: a receiver that has it already drops the repetition."""
    webhook_id: str | None
    """None: an e-mail."""
    topic: Topic
    created_utc: datetime
    attempts_count: int
    next_utc: datetime | None
    """When it is tried next; null when it is delivered or given up."""
    delivered_utc: datetime | None
    answer: str


class NotificationPage(View):
    """Messages, newest first."""

    rows: tuple[NotificationView, ...]
    next_cursor: str | None
