"""Diagnoses of machines against their twins, and the lineage of twin profiles."""

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "gap_runs",
        sa.Column("gap_run_id", sa.String(length=36), nullable=False),
        sa.Column("machine_id", sa.String(length=32), nullable=False),
        sa.Column("created_by", sa.String(length=64), nullable=False),
        sa.Column("created_utc", sa.DateTime(timezone=True), nullable=False),
        sa.Column("started_utc", sa.DateTime(timezone=True), nullable=True),
        sa.Column("ended_utc", sa.DateTime(timezone=True), nullable=True),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("detail", sa.Text(), nullable=False),
        sa.Column("throw_ids", sa.JSON(), nullable=False),
        sa.Column("profile_version_count", sa.BigInteger(), nullable=False),
        sa.Column("profile_sha256", sa.String(length=64), nullable=False),
        sa.Column("verdict", sa.String(length=16), nullable=True),
        sa.Column("sentence", sa.Text(), nullable=False),
        sa.Column("effect_count", sa.BigInteger(), nullable=False),
        sa.Column("result", sa.JSON(none_as_null=True), nullable=True),
        sa.Column("report", sa.LargeBinary(), nullable=True),
        sa.Column("applied_version_count", sa.BigInteger(), nullable=True),
        sa.ForeignKeyConstraint(
            ["machine_id"], ["machines.machine_id"], name=op.f("fk_gap_runs_machine_id")
        ),
        sa.PrimaryKeyConstraint("gap_run_id", name=op.f("pk_gap_runs")),
    )
    op.create_index(
        "ix_gap_runs_machine_id_gap_run_id", "gap_runs", ["machine_id", "gap_run_id"], unique=False
    )
    op.create_index(op.f("ix_gap_runs_state"), "gap_runs", ["state"], unique=False)
    op.create_table(
        "twin_versions",
        sa.Column("machine_id", sa.String(length=32), nullable=False),
        sa.Column("version_count", sa.BigInteger(), autoincrement=False, nullable=False),
        sa.Column("profile_sha256", sa.String(length=64), nullable=False),
        sa.Column("before_version_count", sa.BigInteger(), nullable=True),
        sa.Column("before_file", sa.String(length=128), nullable=True),
        sa.Column("cause", sa.String(length=16), nullable=False),
        sa.Column("gap_run_id", sa.String(length=36), nullable=True),
        sa.Column("created_by", sa.String(length=64), nullable=False),
        sa.Column("created_utc", sa.DateTime(timezone=True), nullable=False),
        sa.ForeignKeyConstraint(
            ["machine_id"], ["machines.machine_id"], name=op.f("fk_twin_versions_machine_id")
        ),
        sa.PrimaryKeyConstraint("machine_id", "version_count", name=op.f("pk_twin_versions")),
    )


def downgrade() -> None:
    op.drop_table("twin_versions")
    op.drop_index(op.f("ix_gap_runs_state"), table_name="gap_runs")
    op.drop_index("ix_gap_runs_machine_id_gap_run_id", table_name="gap_runs")
    op.drop_table("gap_runs")
