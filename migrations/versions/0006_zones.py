"""Exclusion zones in versions, and those that each plan was checked against."""

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = "0005"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "zone_versions",
        sa.Column("machine_id", sa.String(length=32), nullable=False),
        sa.Column("version_count", sa.BigInteger(), autoincrement=False, nullable=False),
        sa.Column("zones", sa.JSON(), nullable=False),
        sa.Column("zones_sha256", sa.String(length=64), nullable=False),
        sa.Column("reason", sa.String(length=300), nullable=False),
        sa.Column("before_version_count", sa.BigInteger(), nullable=True),
        sa.Column("created_by", sa.String(length=64), nullable=False),
        sa.Column("created_utc", sa.DateTime(timezone=True), nullable=False),
        sa.Column("approved_by", sa.String(length=64), nullable=True),
        sa.Column("approved_utc", sa.DateTime(timezone=True), nullable=True),
        sa.ForeignKeyConstraint(
            ["machine_id"], ["machines.machine_id"], name=op.f("fk_zone_versions_machine_id")
        ),
        sa.PrimaryKeyConstraint("machine_id", "version_count", name=op.f("pk_zone_versions")),
    )
    op.add_column("plans", sa.Column("zones", sa.JSON(), nullable=False, server_default="[]"))


def downgrade() -> None:
    with op.batch_alter_table("plans") as plans:
        plans.drop_column("zones")
    op.drop_table("zone_versions")
