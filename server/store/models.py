"""Tables of the database. Every number carries its unit, every time is aware UTC.

Impacts, events and audit rows are only ever added. A throw's id is a UUID of version 7, so that ordering
by it is ordering by time: all pages of the history walk an index that ends with it.
"""

from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any, ClassVar

from sqlalchemy import (
    BigInteger,
    Boolean,
    DateTime,
    Dialect,
    ForeignKey,
    Index,
    Integer,
    LargeBinary,
    MetaData,
    String,
    Text,
    UniqueConstraint,
)
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column
from sqlalchemy.types import JSON, TypeDecorator

from machine.conventions import DEFAULT_PACE_RATIO


class UtcDateTime(TypeDecorator[datetime]):
    """Aware UTC on both databases; a naive time is refused."""

    impl = DateTime(timezone=True)
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: Dialect) -> datetime | None:
        """To the database."""
        if value is None:
            return None
        if value.tzinfo is None:
            raise ValueError("a time without zone cannot be stored")
        try:
            utc = value.astimezone(UTC)
        except OverflowError:
            # In UTC it lies before year 1 or after 9999: the nearest time that can be.
            edge = (1, 1, 1) if value.year == 1 else (9999, 12, 31)
            utc = datetime(*edge, tzinfo=UTC)
        return utc.replace(tzinfo=None) if dialect.name == "sqlite" else utc

    def process_result_value(self, value: datetime | None, dialect: Dialect) -> datetime | None:
        """From the database."""
        if value is None:
            return None
        return value.replace(tzinfo=UTC) if value.tzinfo is None else value.astimezone(UTC)


BigCount = BigInteger().with_variant(Integer, "sqlite")


class Base(DeclarativeBase):
    """All tables."""

    metadata = MetaData(
        naming_convention={
            "ix": "ix_%(table_name)s_%(column_0_N_name)s",
            "uq": "uq_%(table_name)s_%(column_0_N_name)s",
            "fk": "fk_%(table_name)s_%(column_0_N_name)s",
            "pk": "pk_%(table_name)s",
        }
    )
    type_annotation_map: ClassVar[Mapping[Any, Any]] = {
        datetime: UtcDateTime,
        dict[str, Any]: JSON,
        list[Any]: JSON,
        bool: Boolean(create_constraint=False),
    }


class User(Base):
    """A local account."""

    __tablename__ = "users"
    username: Mapped[str] = mapped_column(String(64), primary_key=True)
    password_hash: Mapped[str] = mapped_column(String(255))
    role: Mapped[str] = mapped_column(String(16))
    is_disabled: Mapped[bool] = mapped_column(default=False)
    created_utc: Mapped[datetime]


class LoginSession(Base):
    """A signed-in browser or program; the token itself is never stored."""

    __tablename__ = "sessions"
    session_id: Mapped[str] = mapped_column(String(36), primary_key=True)
    token_sha256: Mapped[str] = mapped_column(String(64), unique=True)
    username: Mapped[str] = mapped_column(ForeignKey("users.username"))
    created_utc: Mapped[datetime]
    expires_utc: Mapped[datetime] = mapped_column(index=True)
    ended_utc: Mapped[datetime | None]


class Machine(Base):
    """A machine of the site; never deleted, so that it never vanishes from the console."""

    __tablename__ = "machines"
    machine_id: Mapped[str] = mapped_column(String(32), primary_key=True)
    site: Mapped[str] = mapped_column(String(32))
    name: Mapped[str] = mapped_column(String(80), default="")
    tags: Mapped[list[Any]] = mapped_column(default=list, server_default="[]")
    token_sha256: Mapped[str] = mapped_column(String(64))
    is_listed: Mapped[bool] = mapped_column(default=False)
    """Enrolled by a person or seen at least once; spare accounts are not shown."""
    enrolled_utc: Mapped[datetime]
    last_seen_utc: Mapped[datetime | None]
    retired_utc: Mapped[datetime | None]
    """Out of service since then; its history stays."""
    stop_requested_utc: Mapped[datetime | None]
    """STOP was pressed and not confirmed yet; survives a restart of the server."""


class Lease(Base):
    """Who may command a machine; the epoch only grows."""

    __tablename__ = "leases"
    machine_id: Mapped[str] = mapped_column(ForeignKey("machines.machine_id"), primary_key=True)
    epoch_count: Mapped[int] = mapped_column(BigInteger, default=0)
    holder: Mapped[str | None] = mapped_column(String(64))
    holder_session_id: Mapped[str | None] = mapped_column(String(36))
    acquired_utc: Mapped[datetime | None]
    expires_utc: Mapped[datetime | None]
    active_utc: Mapped[datetime | None]


class Policy(Base):
    """A policy version that was ever seen in the policies folder."""

    __tablename__ = "policies"
    policy_sha256: Mapped[str] = mapped_column(String(64), primary_key=True)
    policy_id: Mapped[str] = mapped_column(String(64))
    mode: Mapped[str] = mapped_column(String(2))
    card: Mapped[dict[str, Any]]
    first_seen_utc: Mapped[datetime]


class PolicyTransition(Base):
    """One step in the life of a policy version; rows are only added (server/plans/policy_life.py)."""

    __tablename__ = "policy_transitions"
    transition_count: Mapped[int] = mapped_column(BigCount, primary_key=True)
    policy_sha256: Mapped[str] = mapped_column(ForeignKey("policies.policy_sha256"), index=True)
    from_state: Mapped[str | None] = mapped_column(String(16))
    """None: the server met the version."""
    to_state: Mapped[str] = mapped_column(String(16))
    """server.schemas.policies.PolicyState"""
    actor: Mapped[str] = mapped_column(String(64))
    reason: Mapped[str] = mapped_column(String(300))
    evidence: Mapped[dict[str, Any]]
    at_utc: Mapped[datetime]


class MachinePolicy(Base):
    """Which policy a machine had loaded from a moment on, as its own events say; rows are only added."""

    __tablename__ = "machine_policies"
    machine_policy_count: Mapped[int] = mapped_column(BigCount, primary_key=True)
    """In the order of the machine's events."""
    machine_id: Mapped[str] = mapped_column(String(32))
    mode: Mapped[str] = mapped_column(String(2))
    policy_sha256: Mapped[str | None] = mapped_column(String(64))
    """None: no usable policy on board."""
    since_utc: Mapped[datetime]
    """By the machine's clock."""
    cause: Mapped[str | None] = mapped_column(String(16))
    """server.schemas.deployments.ChangeCause; None: the machine itself, for example at a start."""
    __table_args__ = (Index("ix_machine_policies_machine_id_since_utc", "machine_id", "since_utc"),)


class Deployment(Base):
    """A version that a machine is to have in one mode; the newest counts."""

    __tablename__ = "deployments"
    machine_id: Mapped[str] = mapped_column(ForeignKey("machines.machine_id"), primary_key=True)
    mode: Mapped[str] = mapped_column(String(2), primary_key=True)
    deployment_count: Mapped[int] = mapped_column(BigInteger, primary_key=True, autoincrement=False)
    policy_sha256: Mapped[str] = mapped_column(String(64))
    is_rollback: Mapped[bool]
    reason: Mapped[str] = mapped_column(String(300))
    created_by: Mapped[str] = mapped_column(String(64))
    created_utc: Mapped[datetime]
    outcome: Mapped[str] = mapped_column(String(16))
    """server.schemas.deployments.DeploymentOutcome"""
    detail: Mapped[str] = mapped_column(Text)
    """Why the machine refused it."""
    ended_utc: Mapped[datetime | None]


class Plan(Base):
    """A previewed throw; what is armed is frozen in `plan_json`."""

    __tablename__ = "plans"
    plan_id: Mapped[str] = mapped_column(String(36), primary_key=True)
    machine_id: Mapped[str] = mapped_column(ForeignKey("machines.machine_id"))
    session_id: Mapped[str] = mapped_column(String(36))
    created_by: Mapped[str] = mapped_column(String(64))
    created_utc: Mapped[datetime]
    expires_utc: Mapped[datetime]
    state: Mapped[str] = mapped_column(String(16))
    is_complete: Mapped[bool] = mapped_column(default=False)
    mode: Mapped[str] = mapped_column(String(2))
    target_x_m: Mapped[float]
    target_y_m: Mapped[float]
    target_z_m: Mapped[float]
    pace_ratio: Mapped[float] = mapped_column(default=DEFAULT_PACE_RATIO, server_default="0.0")
    policy_id: Mapped[str | None] = mapped_column(String(64))
    policy_sha256: Mapped[str | None] = mapped_column(String(64))
    model_sha256: Mapped[str] = mapped_column(String(64))
    twin_profile_version: Mapped[int]
    refusals: Mapped[list[Any]]
    prediction: Mapped[dict[str, Any] | None] = mapped_column(JSON(none_as_null=True))
    site: Mapped[list[Any]] = mapped_column(default=list, server_default="[]")
    """JSON of the objects that the preview saw around the machine."""
    zones: Mapped[list[Any]] = mapped_column(default=list, server_default="[]")
    """JSON of the exclusion zones that the preview was checked against."""
    swept_path_rad_m: Mapped[list[Any]] = mapped_column(default=list, server_default="[]")
    """Poses of the previewed motion, of a plan with exclusion zones."""
    aim: Mapped[dict[str, Any] | None] = mapped_column(JSON(none_as_null=True))
    """JSON of machine.messages.AimShift; None where the policy aims at the target."""
    material: Mapped[dict[str, Any] | None] = mapped_column(JSON(none_as_null=True))
    """JSON of machine.site.thrown_material.ThrownMaterial; None for a ball."""
    calibration_sha256: Mapped[str | None] = mapped_column(String(64))
    """Of the machine's calibration when the plan was made; None from older software."""
    start_rad_m: Mapped[list[Any]]
    """Joint positions the preview started from."""
    plan_json: Mapped[str | None] = mapped_column(Text)
    plan_hash: Mapped[str | None] = mapped_column(String(64))
    armed_utc: Mapped[datetime | None]
    fired_utc: Mapped[datetime | None]
    frames: Mapped[bytes | None] = mapped_column(LargeBinary, deferred=True)
    """Compressed JSON of PlanFrames."""


class Throw(Base):
    """One throw from the moment fire was pressed."""

    __tablename__ = "throws"
    throw_id: Mapped[str] = mapped_column(String(36), primary_key=True)
    machine_id: Mapped[str] = mapped_column(ForeignKey("machines.machine_id"))
    plan_id: Mapped[str] = mapped_column(String(36))
    session_id: Mapped[str] = mapped_column(String(36))
    created_utc: Mapped[datetime]
    operator: Mapped[str] = mapped_column(String(64))
    epoch_count: Mapped[int] = mapped_column(BigInteger)
    mode: Mapped[str] = mapped_column(String(2))
    target_x_m: Mapped[float]
    target_y_m: Mapped[float]
    target_z_m: Mapped[float]
    range_m: Mapped[float]
    pace_ratio: Mapped[float] = mapped_column(default=DEFAULT_PACE_RATIO, server_default="0.0")
    policy_id: Mapped[str] = mapped_column(String(64))
    policy_sha256: Mapped[str] = mapped_column(String(64))
    phase: Mapped[str] = mapped_column(String(16))
    outcome: Mapped[str | None] = mapped_column(String(16))
    detail: Mapped[str] = mapped_column(Text, default="")
    is_policys_own: Mapped[bool | None]
    """Of an aborted throw: whether what the policy did is its reason; None where the machine did not say."""
    predicted_downrange_error_m: Mapped[float | None]
    predicted_crossrange_error_m: Mapped[float | None]
    predicted_sd_downrange_m: Mapped[float | None]
    predicted_sd_crossrange_m: Mapped[float | None]
    measured_downrange_error_m: Mapped[float | None]
    measured_crossrange_error_m: Mapped[float | None]
    impact_source: Mapped[str | None] = mapped_column(String(16))
    release_speed_m_per_s: Mapped[float | None]
    throw_duration_s: Mapped[float | None]
    has_log: Mapped[bool] = mapped_column(default=False)
    __table_args__ = (
        Index(
            "ix_throws_machine_id_throw_id", "machine_id", "throw_id", "mode", "range_m", "outcome"
        ),
        Index("ix_throws_mode_throw_id", "mode", "throw_id"),
        Index("ix_throws_policy_sha256_throw_id", "policy_sha256", "throw_id"),
        Index("ix_throws_operator_throw_id", "operator", "throw_id"),
        Index("ix_throws_outcome_throw_id", "outcome", "throw_id"),
        Index("ix_throws_phase_throw_id", "phase", "throw_id"),
        Index(
            "ix_throws_range_m",
            *("range_m", "throw_id", "machine_id", "mode", "measured_downrange_error_m"),
        ),
        Index("ix_throws_plan_id", "plan_id"),
    )


class Impact(Base):
    """A record of where a load came down; rows are only added."""

    __tablename__ = "impacts"
    impact_id: Mapped[str] = mapped_column(String(36), primary_key=True)
    throw_id: Mapped[str] = mapped_column(String(36), index=True)
    source: Mapped[str] = mapped_column(String(16))
    x_m: Mapped[float]
    y_m: Mapped[float]
    z_m: Mapped[float]
    downrange_error_m: Mapped[float]
    crossrange_error_m: Mapped[float]
    sd_m: Mapped[float | None]
    footprint: Mapped[dict[str, Any] | None] = mapped_column(JSON(none_as_null=True))
    """JSON of machine.site.thrown_material.MaterialFootprint; None for a ball, and where not measured."""
    recorded_by: Mapped[str] = mapped_column(String(64))
    note: Mapped[str] = mapped_column(String(500), default="")
    created_utc: Mapped[datetime]


class Event(Base):
    """A machine's event; unique, so that a repeated delivery changes nothing."""

    __tablename__ = "events"
    event_count: Mapped[int] = mapped_column(BigCount, primary_key=True, autoincrement=True)
    machine_id: Mapped[str] = mapped_column(String(32))
    boot_id: Mapped[str] = mapped_column(String(64))
    sequence_count: Mapped[int] = mapped_column(BigInteger)
    t_mono_ns: Mapped[int] = mapped_column(BigInteger)
    t_utc: Mapped[str] = mapped_column(String(40))
    kind: Mapped[str] = mapped_column(String(32))
    throw_id: Mapped[str | None] = mapped_column(String(64), index=True)
    plan_id: Mapped[str | None] = mapped_column(String(64))
    data: Mapped[dict[str, Any]]
    received_utc: Mapped[datetime]
    __table_args__ = (UniqueConstraint("machine_id", "boot_id", "sequence_count"),)


class StoredThrowLog(Base):
    """A throw's log file, kept under the data folder by its hash."""

    __tablename__ = "throw_logs"
    throw_id: Mapped[str] = mapped_column(String(64), primary_key=True)
    machine_id: Mapped[str] = mapped_column(String(32))
    log_sha256: Mapped[str] = mapped_column(String(64))
    size_bytes: Mapped[int] = mapped_column(BigInteger)
    path: Mapped[str] = mapped_column(String(255))
    """Relative to the data folder."""
    received_utc: Mapped[datetime]


class GapRun(Base):
    """A diagnosis of a machine against its twin; kept whatever became of it."""

    __tablename__ = "gap_runs"
    gap_run_id: Mapped[str] = mapped_column(String(36), primary_key=True)
    machine_id: Mapped[str] = mapped_column(ForeignKey("machines.machine_id"))
    created_by: Mapped[str] = mapped_column(String(64))
    created_utc: Mapped[datetime]
    started_utc: Mapped[datetime | None]
    ended_utc: Mapped[datetime | None]
    state: Mapped[str] = mapped_column(String(16), index=True)
    detail: Mapped[str] = mapped_column(Text, default="")
    """Why it has no result."""
    throw_ids: Mapped[list[Any]]
    reference_throw_ids: Mapped[list[Any]] = mapped_column(server_default="[]")
    """Healthy throws of the machine that it is compared with; empty: healthy machines of the type."""
    profile_version_count: Mapped[int] = mapped_column(BigInteger)
    """Of the twin that the throws were compared with: when the run was asked for, then when it began."""
    profile_sha256: Mapped[str] = mapped_column(String(64))
    """Of that profile's content (server.machines.twin_files.content_sha256)."""
    verdict: Mapped[str | None] = mapped_column(String(16))
    sentence: Mapped[str] = mapped_column(Text, default="")
    effect_count: Mapped[int] = mapped_column(BigInteger, default=0)
    """Effects that could be applied to the twin."""
    result: Mapped[dict[str, Any] | None] = mapped_column(JSON(none_as_null=True), deferred=True)
    """JSON of diagnosis.verdict.Diagnosis."""
    report: Mapped[bytes | None] = mapped_column(LargeBinary, deferred=True)
    """Compressed HTML page, as it was made with the result."""
    applied_version_count: Mapped[int | None] = mapped_column(BigInteger)
    """Version of the twin profile that this run was applied as."""
    __table_args__ = (Index("ix_gap_runs_machine_id_gap_run_id", "machine_id", "gap_run_id"),)


class TwinVersion(Base):
    """Where a version of a machine's twin profile came from; the profiles themselves are files."""

    __tablename__ = "twin_versions"
    machine_id: Mapped[str] = mapped_column(ForeignKey("machines.machine_id"), primary_key=True)
    version_count: Mapped[int] = mapped_column(BigInteger, primary_key=True, autoincrement=False)
    profile_sha256: Mapped[str] = mapped_column(String(64))
    """Of its content: a file that somebody else has put there is no version of ours."""
    before_version_count: Mapped[int | None] = mapped_column(BigInteger)
    """Version that undo goes back to; None when there is none."""
    before_file: Mapped[str | None] = mapped_column(String(128))
    """Where that version is kept, beside the profile."""
    cause: Mapped[str] = mapped_column(String(16))
    """``applied`` or ``undone``."""
    gap_run_id: Mapped[str | None] = mapped_column(String(36))
    """Run whose effects were the last to be added to what this version says."""
    created_by: Mapped[str] = mapped_column(String(64))
    created_utc: Mapped[datetime]


class SiteVersion(Base):
    """What stood around a machine from one change to the next."""

    __tablename__ = "site_versions"
    machine_id: Mapped[str] = mapped_column(ForeignKey("machines.machine_id"), primary_key=True)
    version_count: Mapped[int] = mapped_column(BigInteger, primary_key=True, autoincrement=False)
    objects: Mapped[list[Any]]
    """JSON of machine.site.objects.SiteObject."""
    before_version_count: Mapped[int | None] = mapped_column(BigInteger)
    """Version that undo goes back to; 0 is an empty site, None when there is none."""
    created_by: Mapped[str] = mapped_column(String(64))
    created_utc: Mapped[datetime]


class ZoneVersion(Base):
    """Exclusion zones of a machine: a draft, or approved; the newest approved one is in force."""

    __tablename__ = "zone_versions"
    machine_id: Mapped[str] = mapped_column(ForeignKey("machines.machine_id"), primary_key=True)
    version_count: Mapped[int] = mapped_column(BigInteger, primary_key=True, autoincrement=False)
    zones: Mapped[list[Any]]
    """JSON of machine.site.zones.Zone."""
    zones_sha256: Mapped[str] = mapped_column(String(64))
    """machine.site.zones.zones_sha256; empty for no zones."""
    reason: Mapped[str] = mapped_column(String(300))
    before_version_count: Mapped[int | None] = mapped_column(BigInteger)
    """Version that undo goes back to; 0 is no zones, None when there is none."""
    created_by: Mapped[str] = mapped_column(String(64))
    created_utc: Mapped[datetime]
    approved_by: Mapped[str | None] = mapped_column(String(64))
    approved_utc: Mapped[datetime | None]


class Audit(Base):
    """One link of the hash chain; the database itself refuses to change or delete it."""

    __tablename__ = "audit"
    sequence_count: Mapped[int] = mapped_column(BigCount, primary_key=True, autoincrement=False)
    t_utc: Mapped[datetime]
    actor: Mapped[str] = mapped_column(String(64))
    session_id: Mapped[str | None] = mapped_column(String(36))
    machine_id: Mapped[str | None] = mapped_column(String(32), index=True)
    throw_id: Mapped[str | None] = mapped_column(String(36), index=True)
    action: Mapped[str] = mapped_column(String(48), index=True)
    phase: Mapped[str] = mapped_column(String(16))
    detail_json: Mapped[str] = mapped_column(Text)
    previous_sha256: Mapped[str] = mapped_column(String(64))
    row_sha256: Mapped[str] = mapped_column(String(64))
