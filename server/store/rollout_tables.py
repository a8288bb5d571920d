"""Tables of rollouts; a rollout's steps are only added, the newest says where it stands."""

from datetime import datetime
from typing import Any

from sqlalchemy import BigInteger, ForeignKey, Index, String, Text
from sqlalchemy.orm import Mapped, mapped_column

from server.store.models import Base, BigCount


class RolloutRow(Base):
    """A version that is brought to machines in stages."""

    __tablename__ = "rollouts"
    rollout_id: Mapped[str] = mapped_column(String(36), primary_key=True)
    mode: Mapped[str] = mapped_column(String(2))
    policy_sha256: Mapped[str] = mapped_column(String(64))
    stages: Mapped[list[Any]]
    """JSON of server.rollouts.rollout_views.StagePlan, with the machines that a tag had at the start."""
    deadline_s: Mapped[float]
    throws_count: Mapped[int]
    reason: Mapped[str] = mapped_column(String(300))
    created_by: Mapped[str] = mapped_column(String(64))
    created_utc: Mapped[datetime]


class RolloutStep(Base):
    """What happened to a rollout."""

    __tablename__ = "rollout_steps"
    step_count: Mapped[int] = mapped_column(BigCount, primary_key=True)
    rollout_id: Mapped[str] = mapped_column(ForeignKey("rollouts.rollout_id"))
    state: Mapped[str] = mapped_column(String(16))
    """server.rollouts.rollout_views.RolloutState from then on."""
    stage_count: Mapped[int] = mapped_column(BigInteger)
    """The stage that is under way, from 0."""
    actor: Mapped[str] = mapped_column(String(64))
    sentence: Mapped[str] = mapped_column(Text)
    at_utc: Mapped[datetime]
    __table_args__ = (Index("ix_rollout_steps_rollout_id_step_count", "rollout_id", "step_count"),)


class RolloutMachine(Base):
    """A machine that a rollout has asked to switch, in the transaction of its deployment."""

    __tablename__ = "rollout_machines"
    rollout_id: Mapped[str] = mapped_column(ForeignKey("rollouts.rollout_id"), primary_key=True)
    machine_id: Mapped[str] = mapped_column(ForeignKey("machines.machine_id"), primary_key=True)
    before_sha256: Mapped[str | None] = mapped_column(String(64))
    """Version that it had; None where it had none other."""
    deployment_count: Mapped[int | None] = mapped_column(BigInteger)
    """None: it had the version already."""
    asked_utc: Mapped[datetime]
