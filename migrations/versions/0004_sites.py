"""Objects around machines, in versions; plans keep the site of their preview."""

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "site_versions",
        sa.Column("machine_id", sa.String(length=32), nullable=False),
        sa.Column("version_count", sa.BigInteger(), autoincrement=False, nullable=False),
        sa.Column("objects", sa.JSON(), nullable=False),
        sa.Column("before_version_count", sa.BigInteger(), nullable=True),
        sa.Column("created_by", sa.String(length=64), nullable=False),
        sa.Column("created_utc", sa.DateTime(timezone=True), nullable=False),
        sa.ForeignKeyConstraint(
            ["machine_id"], ["machines.machine_id"], name=op.f("fk_site_versions_machine_id")
        ),
        sa.PrimaryKeyConstraint("machine_id", "version_count", name=op.f("pk_site_versions")),
    )
    op.add_column("plans", sa.Column("site", sa.JSON(), nullable=False, server_default="[]"))


def downgrade() -> None:
    op.drop_column("plans", "site")
    op.drop_table("site_versions")
