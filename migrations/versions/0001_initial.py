"""First schema: accounts, machines, leases, policies, plans, throws, impacts, events, logs, audit.

The audit table refuses changes and deletions itself, on both databases.
"""

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None


_SQLITE_TRIGGER = (
    "CREATE TRIGGER audit_refuses_{verb} BEFORE {verb} ON audit "
    "BEGIN SELECT RAISE(ABORT, 'audit rows are never changed or deleted'); END"
)
_POSTGRES_FUNCTION = (
    "CREATE FUNCTION audit_refuse() RETURNS trigger LANGUAGE plpgsql AS "
    "$$BEGIN RAISE EXCEPTION 'audit rows are never changed or deleted'; END$$"
)
_POSTGRES_TRIGGER = (
    "CREATE TRIGGER audit_refuses_{verb} BEFORE {verb} ON audit "
    "FOR EACH ROW EXECUTE FUNCTION audit_refuse()"
)


def _protect_audit() -> None:
    is_sqlite = op.get_bind().dialect.name == "sqlite"
    if not is_sqlite:
        op.execute(_POSTGRES_FUNCTION)
    for verb in ("UPDATE", "DELETE"):
        op.execute((_SQLITE_TRIGGER if is_sqlite else _POSTGRES_TRIGGER).format(verb=verb))
    if not is_sqlite:
        op.execute(
            "CREATE TRIGGER audit_refuses_truncate BEFORE TRUNCATE ON audit "
            "FOR EACH STATEMENT EXECUTE FUNCTION audit_refuse()"
        )


def upgrade() -> None:
    op.create_table(
        "audit",
        sa.Column(
            "sequence_count",
            sa.BigInteger().with_variant(sa.Integer(), "sqlite"),
            autoincrement=False,
            nullable=False,
        ),
        sa.Column("t_utc", sa.DateTime(timezone=True), nullable=False),
        sa.Column("actor", sa.String(length=64), nullable=False),
        sa.Column("session_id", sa.String(length=36), nullable=True),
        sa.Column("machine_id", sa.String(length=32), nullable=True),
        sa.Column("throw_id", sa.String(length=36), nullable=True),
        sa.Column("action", sa.String(length=48), nullable=False),
        sa.Column("phase", sa.String(length=16), nullable=False),
        sa.Column("detail_json", sa.Text(), nullable=False),
        sa.Column("previous_sha256", sa.String(length=64), nullable=False),
        sa.Column("row_sha256", sa.String(length=64), nullable=False),
        sa.PrimaryKeyConstraint("sequence_count", name=op.f("pk_audit")),
    )
    op.create_index(op.f("ix_audit_action"), "audit", ["action"], unique=False)
    op.create_index(op.f("ix_audit_machine_id"), "audit", ["machine_id"], unique=False)
    op.create_index(op.f("ix_audit_throw_id"), "audit", ["throw_id"], unique=False)
    op.create_table(
        "events",
        sa.Column(
            "event_count",
            sa.BigInteger().with_variant(sa.Integer(), "sqlite"),
            autoincrement=True,
            nullable=False,
        ),
        sa.Column("machine_id", sa.String(length=32), nullable=False),
        sa.Column("boot_id", sa.String(length=64), nullable=False),
        sa.Column("sequence_count", sa.BigInteger(), nullable=False),
        sa.Column("t_mono_ns", sa.BigInteger(), nullable=False),
        sa.Column("t_utc", sa.String(length=40), nullable=False),
        sa.Column("kind", sa.String(length=32), nullable=False),
        sa.Column("throw_id", sa.String(length=64), nullable=True),
        sa.Column("plan_id", sa.String(length=64), nullable=True),
        sa.Column("data", sa.JSON(), nullable=False),
        sa.Column("received_utc", sa.DateTime(timezone=True), nullable=False),
        sa.PrimaryKeyConstraint("event_count", name=op.f("pk_events")),
        sa.UniqueConstraint(
            "machine_id",
            "boot_id",
            "sequence_count",
            name=op.f("uq_events_machine_id_boot_id_sequence_count"),
        ),
    )
    op.create_index(op.f("ix_events_throw_id"), "events", ["throw_id"], unique=False)
    op.create_table(
        "impacts",
        sa.Column("impact_id", sa.String(length=36), nullable=False),
        sa.Column("throw_id", sa.String(length=36), nullable=False),
        sa.Column("source", sa.String(length=16), nullable=False),
        sa.Column("x_m", sa.Double(), nullable=False),
        sa.Column("y_m", sa.Double(), nullable=False),
        sa.Column("z_m", sa.Double(), nullable=False),
        sa.Column("downrange_error_m", sa.Double(), nullable=False),
        sa.Column("crossrange_error_m", sa.Double(), nullable=False),
        sa.Column("sd_m", sa.Double(), nullable=True),
        sa.Column("recorded_by", sa.String(length=64), nullable=False),
        sa.Column("note", sa.String(length=500), nullable=False),
        sa.Column("created_utc", sa.DateTime(timezone=True), nullable=False),
        sa.PrimaryKeyConstraint("impact_id", name=op.f("pk_impacts")),
    )
    op.create_index(op.f("ix_impacts_throw_id"), "impacts", ["throw_id"], unique=False)
    op.create_table(
        "machines",
        sa.Column("machine_id", sa.String(length=32), nullable=False),
        sa.Column("site", sa.String(length=32), nullable=False),
        sa.Column("name", sa.String(length=80), nullable=False),
        sa.Column("token_sha256", sa.String(length=64), nullable=False),
        sa.Column("is_listed", sa.Boolean(), nullable=False),
        sa.Column("enrolled_utc", sa.DateTime(timezone=True), nullable=False),
        sa.Column("last_seen_utc", sa.DateTime(timezone=True), nullable=True),
        sa.Column("stop_requested_utc", sa.DateTime(timezone=True), nullable=True),
        sa.PrimaryKeyConstraint("machine_id", name=op.f("pk_machines")),
    )
    op.create_table(
        "policies",
        sa.Column("policy_sha256", sa.String(length=64), nullable=False),
        sa.Column("policy_id", sa.String(length=64), nullable=False),
        sa.Column("mode", sa.String(length=2), nullable=False),
        sa.Column("card", sa.JSON(), nullable=False),
        sa.Column("first_seen_utc", sa.DateTime(timezone=True), nullable=False),
        sa.PrimaryKeyConstraint("policy_sha256", name=op.f("pk_policies")),
    )
    op.create_table(
        "throw_logs",
        sa.Column("throw_id", sa.String(length=64), nullable=False),
        sa.Column("machine_id", sa.String(length=32), nullable=False),
        sa.Column("log_sha256", sa.String(length=64), nullable=False),
        sa.Column("size_bytes", sa.BigInteger(), nullable=False),
        sa.Column("path", sa.String(length=255), nullable=False),
        sa.Column("received_utc", sa.DateTime(timezone=True), nullable=False),
        sa.PrimaryKeyConstraint("throw_id", name=op.f("pk_throw_logs")),
    )
    op.create_table(
        "users",
        sa.Column("username", sa.String(length=64), nullable=False),
        sa.Column("password_hash", sa.String(length=255), nullable=False),
        sa.Column("role", sa.String(length=16), nullable=False),
        sa.Column("is_disabled", sa.Boolean(), nullable=False),
        sa.Column("created_utc", sa.DateTime(timezone=True), nullable=False),
        sa.PrimaryKeyConstraint("username", name=op.f("pk_users")),
    )
    op.create_table(
        "leases",
        sa.Column("machine_id", sa.String(length=32), nullable=False),
        sa.Column("epoch_count", sa.BigInteger(), nullable=False),
        sa.Column("holder", sa.String(length=64), nullable=True),
        sa.Column("holder_session_id", sa.String(length=36), nullable=True),
        sa.Column("acquired_utc", sa.DateTime(timezone=True), nullable=True),
        sa.Column("expires_utc", sa.DateTime(timezone=True), nullable=True),
        sa.Column("active_utc", sa.DateTime(timezone=True), nullable=True),
        sa.ForeignKeyConstraint(
            ["machine_id"], ["machines.machine_id"], name=op.f("fk_leases_machine_id")
        ),
        sa.PrimaryKeyConstraint("machine_id", name=op.f("pk_leases")),
    )
    op.create_table(
        "plans",
        sa.Column("plan_id", sa.String(length=36), nullable=False),
        sa.Column("machine_id", sa.String(length=32), nullable=False),
        sa.Column("session_id", sa.String(length=36), nullable=False),
        sa.Column("created_by", sa.String(length=64), nullable=False),
        sa.Column("created_utc", sa.DateTime(timezone=True), nullable=False),
        sa.Column("expires_utc", sa.DateTime(timezone=True), nullable=False),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("is_complete", sa.Boolean(), nullable=False),
        sa.Column("mode", sa.String(length=2), nullable=False),
        sa.Column("target_x_m", sa.Double(), nullable=False),
        sa.Column("target_y_m", sa.Double(), nullable=False),
        sa.Column("target_z_m", sa.Double(), nullable=False),
        sa.Column("policy_id", sa.String(length=64), nullable=True),
        sa.Column("policy_sha256", sa.String(length=64), nullable=True),
        sa.Column("model_sha256", sa.String(length=64), nullable=False),
        sa.Column("twin_profile_version", sa.Integer(), nullable=False),
        sa.Column("refusals", sa.JSON(), nullable=False),
        sa.Column("prediction", sa.JSON(none_as_null=True), nullable=True),
        sa.Column("start_rad_m", sa.JSON(), nullable=False),
        sa.Column("plan_json", sa.Text(), nullable=True),
        sa.Column("plan_hash", sa.String(length=64), nullable=True),
        sa.Column("armed_utc", sa.DateTime(timezone=True), nullable=True),
        sa.Column("fired_utc", sa.DateTime(timezone=True), nullable=True),
        sa.Column("frames", sa.LargeBinary(), nullable=True),
        sa.ForeignKeyConstraint(
            ["machine_id"], ["machines.machine_id"], name=op.f("fk_plans_machine_id")
        ),
        sa.PrimaryKeyConstraint("plan_id", name=op.f("pk_plans")),
    )
    op.create_table(
        "sessions",
        sa.Column("session_id", sa.String(length=36), nullable=False),
        sa.Column("token_sha256", sa.String(length=64), nullable=False),
        sa.Column("username", sa.String(length=64), nullable=False),
        sa.Column("created_utc", sa.DateTime(timezone=True), nullable=False),
        sa.Column("expires_utc", sa.DateTime(timezone=True), nullable=False),
        sa.Column("ended_utc", sa.DateTime(timezone=True), nullable=True),
        sa.ForeignKeyConstraint(
            ["username"], ["users.username"], name=op.f("fk_sessions_username")
        ),
        sa.PrimaryKeyConstraint("session_id", name=op.f("pk_sessions")),
        sa.UniqueConstraint("token_sha256", name=op.f("uq_sessions_token_sha256")),
    )
    op.create_index(op.f("ix_sessions_expires_utc"), "sessions", ["expires_utc"], unique=False)
    op.create_table(
        "throws",
        sa.Column("throw_id", sa.String(length=36), nullable=False),
        sa.Column("machine_id", sa.String(length=32), nullable=False),
        sa.Column("plan_id", sa.String(length=36), nullable=False),
        sa.Column("session_id", sa.String(length=36), nullable=False),
        sa.Column("created_utc", sa.DateTime(timezone=True), nullable=False),
        sa.Column("operator", sa.String(length=64), nullable=False),
        sa.Column("epoch_count", sa.BigInteger(), nullable=False),
        sa.Column("mode", sa.String(length=2), nullable=False),
        sa.Column("target_x_m", sa.Double(), nullable=False),
        sa.Column("target_y_m", sa.Double(), nullable=False),
        sa.Column("target_z_m", sa.Double(), nullable=False),
        sa.Column("range_m", sa.Double(), nullable=False),
        sa.Column("policy_id", sa.String(length=64), nullable=False),
        sa.Column("policy_sha256", sa.String(length=64), nullable=False),
        sa.Column("phase", sa.String(length=16), nullable=False),
        sa.Column("outcome", sa.String(length=16), nullable=True),
        sa.Column("detail", sa.Text(), nullable=False),
        sa.Column("predicted_downrange_error_m", sa.Double(), nullable=True),
        sa.Column("predicted_crossrange_error_m", sa.Double(), nullable=True),
        sa.Column("predicted_sd_downrange_m", sa.Double(), nullable=True),
        sa.Column("predicted_sd_crossrange_m", sa.Double(), nullable=True),
        sa.Column("measured_downrange_error_m", sa.Double(), nullable=True),
        sa.Column("measured_crossrange_error_m", sa.Double(), nullable=True),
        sa.Column("impact_source", sa.String(length=16), nullable=True),
        sa.Column("release_speed_m_per_s", sa.Double(), nullable=True),
        sa.Column("throw_duration_s", sa.Double(), nullable=True),
        sa.Column("has_log", sa.Boolean(), nullable=False),
        sa.ForeignKeyConstraint(
            ["machine_id"], ["machines.machine_id"], name=op.f("fk_throws_machine_id")
        ),
        sa.PrimaryKeyConstraint("throw_id", name=op.f("pk_throws")),
    )
    op.create_index(
        "ix_throws_machine_id_throw_id", "throws", ["machine_id", "throw_id"], unique=False
    )
    op.create_index("ix_throws_mode_throw_id", "throws", ["mode", "throw_id"], unique=False)
    op.create_index("ix_throws_operator_throw_id", "throws", ["operator", "throw_id"], unique=False)
    op.create_index("ix_throws_outcome_throw_id", "throws", ["outcome", "throw_id"], unique=False)
    op.create_index("ix_throws_phase_throw_id", "throws", ["phase", "throw_id"], unique=False)
    op.create_index("ix_throws_plan_id", "throws", ["plan_id"], unique=False)
    op.create_index(
        "ix_throws_policy_sha256_throw_id", "throws", ["policy_sha256", "throw_id"], unique=False
    )
    op.create_index("ix_throws_range_m", "throws", ["range_m"], unique=False)
    _protect_audit()


def downgrade() -> None:
    op.drop_index("ix_throws_range_m", table_name="throws")
    op.drop_index("ix_throws_policy_sha256_throw_id", table_name="throws")
    op.drop_index("ix_throws_plan_id", table_name="throws")
    op.drop_index("ix_throws_phase_throw_id", table_name="throws")
    op.drop_index("ix_throws_outcome_throw_id", table_name="throws")
    op.drop_index("ix_throws_operator_throw_id", table_name="throws")
    op.drop_index("ix_throws_mode_throw_id", table_name="throws")
    op.drop_index("ix_throws_machine_id_throw_id", table_name="throws")
    op.drop_table("throws")
    op.drop_index(op.f("ix_sessions_expires_utc"), table_name="sessions")
    op.drop_table("sessions")
    op.drop_table("plans")
    op.drop_table("leases")
    op.drop_table("users")
    op.drop_table("throw_logs")
    op.drop_table("policies")
    op.drop_table("machines")
    op.drop_index(op.f("ix_impacts_throw_id"), table_name="impacts")
    op.drop_table("impacts")
    op.drop_index(op.f("ix_events_throw_id"), table_name="events")
    op.drop_table("events")
    op.drop_index(op.f("ix_audit_throw_id"), table_name="audit")
    op.drop_index(op.f("ix_audit_machine_id"), table_name="audit")
    op.drop_index(op.f("ix_audit_action"), table_name="audit")
    op.drop_table("audit")
    if op.get_bind().dialect.name != "sqlite":
        op.execute("DROP FUNCTION audit_refuse()")
