"""Aim corrections of machines, and what each plan was made with."""

import sqlalchemy as sa
from alembic import op

revision = "0019"
down_revision = "0020"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("plans", sa.Column("aim", sa.JSON(), nullable=True))
    op.add_column("plans", sa.Column("calibration_sha256", sa.String(length=64), nullable=True))
    op.create_table(
        "aim_corrections",
        sa.Column("machine_id", sa.String(length=32), nullable=False),
        sa.Column("version_count", sa.BigInteger(), autoincrement=False, nullable=False),
        sa.Column("mode", sa.String(length=2), nullable=False),
        sa.Column("policy_sha256", sa.String(length=64), nullable=False),
        sa.Column("calibration_sha256", sa.String(length=64), nullable=False),
        sa.Column("profile_sha256", sa.String(length=64), nullable=False),
        sa.Column("content", sa.JSON(), nullable=False),
        sa.Column("before_version_count", sa.BigInteger(), nullable=True),
        sa.Column("cause", sa.String(length=16), nullable=False),
        sa.Column("created_by", sa.String(length=64), nullable=False),
        sa.Column("created_utc", sa.DateTime(timezone=True), nullable=False),
        sa.Column("ended_utc", sa.DateTime(timezone=True), nullable=True),
        sa.Column("ended_by", sa.String(length=64), nullable=True),
        sa.Column("end_reason", sa.Text(), nullable=False),
        sa.ForeignKeyConstraint(
            ["machine_id"], ["machines.machine_id"], name=op.f("fk_aim_corrections_machine_id")
        ),
        sa.PrimaryKeyConstraint("machine_id", "version_count", name=op.f("pk_aim_corrections")),
    )
    op.create_index(
        "ix_aim_corrections_machine_id_mode_ended_utc",
        "aim_corrections",
        ["machine_id", "mode", "ended_utc"],
    )


def downgrade() -> None:
    op.drop_index("ix_aim_corrections_machine_id_mode_ended_utc", table_name="aim_corrections")
    op.drop_table("aim_corrections")
    op.drop_column("plans", "calibration_sha256")
    op.drop_column("plans", "aim")
