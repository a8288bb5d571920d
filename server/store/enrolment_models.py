"""Tables of the one-time tokens by which machines are set up, of their places, and of the keys they trust."""

from datetime import datetime
from typing import Any

from sqlalchemy import JSON, BigInteger, ForeignKey, Index, String
from sqlalchemy.orm import Mapped, mapped_column

from server.store.models import Base


class Enrolment(Base):
    """A one-time token of a machine; the token itself is never stored. The newest of a machine counts."""

    __tablename__ = "enrolments"
    enrolment_id: Mapped[str] = mapped_column(String(36), primary_key=True)
    machine_id: Mapped[str] = mapped_column(ForeignKey("machines.machine_id"))
    token_sha256: Mapped[str] = mapped_column(String(64), unique=True)
    created_by: Mapped[str] = mapped_column(String(64))
    created_utc: Mapped[datetime]
    expires_utc: Mapped[datetime]
    claimed_utc: Mapped[datetime | None]
    claimed_from: Mapped[str] = mapped_column(String(64), default="")
    """Network address of the computer that used it."""
    self_test: Mapped[list[Any] | None] = mapped_column(JSON(none_as_null=True))
    """JSON of server.schemas.enrolment.SelfTestItem."""
    tested_utc: Mapped[datetime | None]
    __table_args__ = (Index("ix_enrolments_machine_id_enrolment_id", "machine_id", "enrolment_id"),)


class MachinePlace(Base):
    """Where a machine stands, frame `yard` (server.fleet.yard_map); no row: nobody has placed it."""

    __tablename__ = "machine_places"
    machine_id: Mapped[str] = mapped_column(ForeignKey("machines.machine_id"), primary_key=True)
    x_m: Mapped[float]
    y_m: Mapped[float]
    heading_rad: Mapped[float]
    changed_by: Mapped[str] = mapped_column(String(64))
    changed_utc: Mapped[datetime]


class MachineTrust(Base):
    """What a machine has said it trusts; no row: it is bound to no site, or its software is older."""

    __tablename__ = "machine_trusts"
    machine_id: Mapped[str] = mapped_column(ForeignKey("machines.machine_id"), primary_key=True)
    serial_count: Mapped[int] = mapped_column(BigInteger)
    """Number of the site's list on board."""
    key_ids: Mapped[list[Any]]
    """Keys of the site that are not revoked there."""
    reported_utc: Mapped[datetime]
