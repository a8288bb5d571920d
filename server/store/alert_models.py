"""Tables of alerts and of the messages about them."""

from datetime import datetime
from typing import Any

from sqlalchemy import BigInteger, Index, String, Text
from sqlalchemy.orm import Mapped, mapped_column

from server.store.models import Base


class AlertRow(Base):
    """An alert from the moment its condition was found; kept when it is cleared."""

    __tablename__ = "alerts"
    alert_id: Mapped[str] = mapped_column(String(36), primary_key=True)
    rule: Mapped[str] = mapped_column(String(16))
    severity: Mapped[str] = mapped_column(String(16))
    machine_id: Mapped[str | None] = mapped_column(String(32))
    text: Mapped[str] = mapped_column(Text)
    opened_utc: Mapped[datetime]
    seen_utc: Mapped[datetime]
    cleared_utc: Mapped[datetime | None] = mapped_column(index=True)
    acknowledged_by: Mapped[str | None] = mapped_column(String(64))
    acknowledged_utc: Mapped[datetime | None]
    note: Mapped[str] = mapped_column(String(500), default="")
    silenced_until_utc: Mapped[datetime | None]
    silenced_by: Mapped[str | None] = mapped_column(String(64))
    __table_args__ = (Index("ix_alerts_machine_id_alert_id", "machine_id", "alert_id"),)


class Webhook(Base):
    """An address of another system that is notified of what happens here."""

    __tablename__ = "webhooks"
    webhook_id: Mapped[str] = mapped_column(String(36), primary_key=True)
    url: Mapped[str] = mapped_column(String(500))
    secret: Mapped[str] = mapped_column(String(120))
    """Key of the signatures; leaves the server once, when it is made."""
    topics: Mapped[list[Any]]
    created_by: Mapped[str] = mapped_column(String(64))
    created_utc: Mapped[datetime]


class Notification(Base):
    """One message to one receiver, stored with what it tells of; sent until the receiver has it."""

    __tablename__ = "notifications"
    notification_id: Mapped[str] = mapped_column(String(36), primary_key=True)
    webhook_id: Mapped[str | None] = mapped_column(String(36))
    """None: an e-mail to the addresses of the settings."""
    topic: Mapped[str] = mapped_column(String(48))
    body: Mapped[str] = mapped_column(Text)
    """JSON as it is sent."""
    created_utc: Mapped[datetime]
    attempts_count: Mapped[int] = mapped_column(BigInteger)
    next_utc: Mapped[datetime | None] = mapped_column(index=True)
    """When it is tried next; None: delivered, or given up."""
    delivered_utc: Mapped[datetime | None]
    answer: Mapped[str] = mapped_column(String(300))
    """What the last attempt was answered."""
