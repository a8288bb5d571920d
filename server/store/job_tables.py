"""Tables of bulk jobs: what is asked, the loads that were thrown for it, and surveys of its surface."""

from datetime import datetime
from typing import Any

from sqlalchemy import BigInteger, ForeignKey, Index, LargeBinary, String, Text
from sqlalchemy.orm import Mapped, mapped_column
from sqlalchemy.types import JSON

from server.store.models import Base


class JobRow(Base):
    """A bulk job of a machine; one at a time is open."""

    __tablename__ = "jobs"
    job_id: Mapped[str] = mapped_column(String(36), primary_key=True)
    machine_id: Mapped[str] = mapped_column(ForeignKey("machines.machine_id"))
    name: Mapped[str] = mapped_column(String(80))
    file: Mapped[dict[str, Any]]
    """JSON of bulk.job_file.JobFile, with the objects of the site at the beginning."""
    version_count: Mapped[int] = mapped_column(BigInteger)
    """Grows with every change of a person, and of a load."""
    created_by: Mapped[str] = mapped_column(String(64))
    created_utc: Mapped[datetime]
    ended_by: Mapped[str | None] = mapped_column(String(64))
    ended_utc: Mapped[datetime | None]
    end_reason: Mapped[str] = mapped_column(String(300), default="")
    progress: Mapped[dict[str, Any]]
    """JSON of server.jobs.job_views.JobProgress at this version."""
    plan_state: Mapped[str] = mapped_column(String(16))
    """server.jobs.job_views.PlanningState"""
    plan_error: Mapped[str] = mapped_column(Text, default="")
    landing_by: Mapped[str | None] = mapped_column(String(16))
    """Where the newest plan has the scatter of the landings from."""
    proposals: Mapped[list[Any]]
    """JSON of server.jobs.job_views.JobProposal at this version."""
    offered: Mapped[list[Any]]
    """JSON of those that were offered last, of earlier versions too, newest first."""
    passed_m: Mapped[list[Any]]
    """Places [x, y] that are passed over until the next load."""
    __table_args__ = (Index("ix_jobs_machine_id_job_id", "machine_id", "job_id"),)


class JobLoad(Base):
    """A load of a job; withdrawn ones stay."""

    __tablename__ = "job_loads"
    job_id: Mapped[str] = mapped_column(ForeignKey("jobs.job_id"), primary_key=True)
    load_count: Mapped[int] = mapped_column(BigInteger, primary_key=True, autoincrement=False)
    """Its number in the job, from 1."""
    version_count: Mapped[int] = mapped_column(BigInteger)
    """Of the job, that it made: its place among loads and surveys."""
    throw_id: Mapped[str | None] = mapped_column(String(36), index=True)
    x_m: Mapped[float]
    y_m: Mapped[float]
    volume_m3: Mapped[float]
    covariance_m2: Mapped[list[Any] | None] = mapped_column(JSON(none_as_null=True))
    """xx, xy and yy of its places as measured, frame `machine`; None: as predicted."""
    landed_by: Mapped[str] = mapped_column(String(16))
    recorded_by: Mapped[str] = mapped_column(String(64))
    at_utc: Mapped[datetime]
    is_withdrawn: Mapped[bool] = mapped_column(default=False)
    filled_ratio: Mapped[float | None]
    """After it."""
    spill_ratio: Mapped[float | None]


class JobSurvey(Base):
    """A surveyed surface, from which on loads are counted; the first may be the ground of the job."""

    __tablename__ = "job_surveys"
    job_id: Mapped[str] = mapped_column(ForeignKey("jobs.job_id"), primary_key=True)
    version_count: Mapped[int] = mapped_column(BigInteger, primary_key=True, autoincrement=False)
    grid: Mapped[dict[str, Any]] = mapped_column(JSON)
    """JSON of bulk.height_field.Grid."""
    heights: Mapped[bytes] = mapped_column(LargeBinary, deferred=True)
    """Compressed single precision heights (rows, columns), m."""
    recorded_by: Mapped[str] = mapped_column(String(64))
    at_utc: Mapped[datetime]
