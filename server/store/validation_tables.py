"""Tables of validations, of their gates, and of shadows."""

from datetime import datetime
from typing import Any

from sqlalchemy import BigInteger, ForeignKey, Index, String, Text
from sqlalchemy.orm import Mapped, mapped_column
from sqlalchemy.types import JSON

from server.store.models import Base


class PolicyValidation(Base):
    """A validation of a policy version; kept whatever became of it."""

    __tablename__ = "policy_validations"
    validation_id: Mapped[str] = mapped_column(String(36), primary_key=True)
    policy_sha256: Mapped[str] = mapped_column(ForeignKey("policies.policy_sha256"))
    active_sha256: Mapped[str | None] = mapped_column(String(64))
    """Version that was active when it was asked for and throws beside it; None where there is none other."""
    card_sha256: Mapped[str | None] = mapped_column(String(64))
    """Of the version's card; None in validations of before it was kept."""
    created_by: Mapped[str] = mapped_column(String(64))
    created_utc: Mapped[datetime]
    started_utc: Mapped[datetime | None]
    ended_utc: Mapped[datetime | None]
    state: Mapped[str] = mapped_column(String(16), index=True)
    detail: Mapped[str] = mapped_column(Text, default="")
    """Why it has no result."""
    plan: Mapped[dict[str, Any]]
    """JSON of evaluation.validation.results.ValidationPlan."""
    gates: Mapped[dict[str, Any]]
    """JSON of evaluation.validation.gates.Gates, as they were when it was asked for."""
    is_passed: Mapped[bool | None]
    result: Mapped[dict[str, Any] | None] = mapped_column(JSON(none_as_null=True), deferred=True)
    """JSON of evaluation.validation.validation.ValidationResult."""
    __table_args__ = (
        Index(
            "ix_policy_validations_policy_sha256_validation_id", "policy_sha256", "validation_id"
        ),
    )


class PolicyValidationPart(Base):
    """A part of a validation that has ended, so that a restart does not throw it again."""

    __tablename__ = "policy_validation_parts"
    validation_id: Mapped[str] = mapped_column(
        ForeignKey("policy_validations.validation_id"), primary_key=True
    )
    part: Mapped[str] = mapped_column(String(64), primary_key=True)
    landings: Mapped[dict[str, Any]]
    """JSON of evaluation.validation.results.UnitLandings."""


class ValidationGates(Base):
    """Gates that a person has set for a mode; the newest version is in force."""

    __tablename__ = "validation_gates"
    mode: Mapped[str] = mapped_column(String(2), primary_key=True)
    version_count: Mapped[int] = mapped_column(BigInteger, primary_key=True, autoincrement=False)
    gates: Mapped[dict[str, Any]]
    reason: Mapped[str] = mapped_column(String(300))
    created_by: Mapped[str] = mapped_column(String(64))
    created_utc: Mapped[datetime]


class PolicyShadow(Base):
    """A version that was run over recorded throws; nothing is ever deleted."""

    __tablename__ = "policy_shadows"
    shadow_id: Mapped[str] = mapped_column(String(36), primary_key=True)
    policy_sha256: Mapped[str] = mapped_column(ForeignKey("policies.policy_sha256"))
    machine_id: Mapped[str | None] = mapped_column(String(32))
    """As asked for; None: all machines."""
    since_utc: Mapped[datetime | None]
    until_utc: Mapped[datetime | None]
    created_by: Mapped[str] = mapped_column(String(64))
    created_utc: Mapped[datetime]
    figures: Mapped[dict[str, Any]]
    """JSON of evaluation.shadow.results.ShadowFigures."""
    report: Mapped[dict[str, Any]] = mapped_column(deferred=True)
    """JSON of evaluation.shadow.results.ShadowReport."""
    __table_args__ = (
        Index("ix_policy_shadows_policy_sha256_shadow_id", "policy_sha256", "shadow_id"),
    )
