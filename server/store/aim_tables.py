"""Versions of the aim corrections of machines; a row's content never changes, only its end is added."""

from datetime import datetime
from typing import Any

from sqlalchemy import BigInteger, ForeignKey, Index, String, Text
from sqlalchemy.orm import Mapped, mapped_column

from server.store.models import Base


class AimCorrection(Base):
    """One version; in force until it is ended."""

    __tablename__ = "aim_corrections"
    machine_id: Mapped[str] = mapped_column(ForeignKey("machines.machine_id"), primary_key=True)
    version_count: Mapped[int] = mapped_column(BigInteger, primary_key=True, autoincrement=False)
    mode: Mapped[str] = mapped_column(String(2))
    policy_sha256: Mapped[str] = mapped_column(String(64))
    calibration_sha256: Mapped[str] = mapped_column(String(64))
    profile_sha256: Mapped[str] = mapped_column(String(64))
    """Content of the twin profile whose predictions the misses are relative to."""
    content: Mapped[dict[str, Any]]
    """JSON of server.aim.aim_views.AimProposal."""
    before_version_count: Mapped[int | None] = mapped_column(BigInteger)
    """Version that it replaced and that undo brings back; None: none."""
    cause: Mapped[str] = mapped_column(String(16))
    created_by: Mapped[str] = mapped_column(String(64))
    created_utc: Mapped[datetime]
    ended_utc: Mapped[datetime | None]
    ended_by: Mapped[str | None] = mapped_column(String(64))
    end_reason: Mapped[str] = mapped_column(Text, default="")
    __table_args__ = (
        Index("ix_aim_corrections_machine_id_mode_ended_utc", "machine_id", "mode", "ended_utc"),
    )
