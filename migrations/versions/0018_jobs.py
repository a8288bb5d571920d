"""Bulk jobs, their loads and surveys."""

import sqlalchemy as sa
from alembic import op

revision = "0018"
down_revision = "0017"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "jobs",
        sa.Column("job_id", sa.String(length=36), nullable=False),
        sa.Column("machine_id", sa.String(length=32), nullable=False),
        sa.Column("name", sa.String(length=80), nullable=False),
        sa.Column("file", sa.JSON(), nullable=False),
        sa.Column("version_count", sa.BigInteger(), nullable=False),
        sa.Column("created_by", sa.String(length=64), nullable=False),
        sa.Column("created_utc", sa.DateTime(timezone=True), nullable=False),
        sa.Column("ended_by", sa.String(length=64), nullable=True),
        sa.Column("ended_utc", sa.DateTime(timezone=True), nullable=True),
        sa.Column("end_reason", sa.String(length=300), nullable=False),
        sa.Column("progress", sa.JSON(), nullable=False),
        sa.Column("plan_state", sa.String(length=16), nullable=False),
        sa.Column("plan_error", sa.Text(), nullable=False),
        sa.Column("landing_by", sa.String(length=16), nullable=True),
        sa.Column("proposals", sa.JSON(), nullable=False),
        sa.Column("offered", sa.JSON(), nullable=False),
        sa.Column("passed_m", sa.JSON(), nullable=False),
        sa.ForeignKeyConstraint(
            ["machine_id"], ["machines.machine_id"], name=op.f("fk_jobs_machine_id")
        ),
        sa.PrimaryKeyConstraint("job_id", name=op.f("pk_jobs")),
    )
    op.create_index("ix_jobs_machine_id_job_id", "jobs", ["machine_id", "job_id"])
    op.create_table(
        "job_loads",
        sa.Column("job_id", sa.String(length=36), nullable=False),
        sa.Column("load_count", sa.BigInteger(), nullable=False),
        sa.Column("version_count", sa.BigInteger(), nullable=False),
        sa.Column("throw_id", sa.String(length=36), nullable=True),
        sa.Column("x_m", sa.Double(), nullable=False),
        sa.Column("y_m", sa.Double(), nullable=False),
        sa.Column("volume_m3", sa.Double(), nullable=False),
        sa.Column("landed_by", sa.String(length=16), nullable=False),
        sa.Column("recorded_by", sa.String(length=64), nullable=False),
        sa.Column("at_utc", sa.DateTime(timezone=True), nullable=False),
        sa.Column("is_withdrawn", sa.Boolean(), nullable=False),
        sa.Column("filled_ratio", sa.Double(), nullable=True),
        sa.Column("spill_ratio", sa.Double(), nullable=True),
        sa.ForeignKeyConstraint(["job_id"], ["jobs.job_id"], name=op.f("fk_job_loads_job_id")),
        sa.PrimaryKeyConstraint("job_id", "load_count", name=op.f("pk_job_loads")),
    )
    op.create_index("ix_job_loads_throw_id", "job_loads", ["throw_id"])
    op.create_table(
        "job_surveys",
        sa.Column("job_id", sa.String(length=36), nullable=False),
        sa.Column("version_count", sa.BigInteger(), nullable=False),
        sa.Column("grid", sa.JSON(), nullable=False),
        sa.Column("heights", sa.LargeBinary(), nullable=False),
        sa.Column("recorded_by", sa.String(length=64), nullable=False),
        sa.Column("at_utc", sa.DateTime(timezone=True), nullable=False),
        sa.ForeignKeyConstraint(["job_id"], ["jobs.job_id"], name=op.f("fk_job_surveys_job_id")),
        sa.PrimaryKeyConstraint("job_id", "version_count", name=op.f("pk_job_surveys")),
    )


def downgrade() -> None:
    op.drop_table("job_surveys")
    op.drop_index("ix_job_loads_throw_id", table_name="job_loads")
    op.drop_table("job_loads")
    op.drop_index("ix_jobs_machine_id_job_id", table_name="jobs")
    op.drop_table("jobs")
