"""Shadows that were run, with their figures."""

import sqlalchemy as sa
from alembic import op

revision = "0021"
down_revision = "0023"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "policy_shadows",
        sa.Column("shadow_id", sa.String(length=36), nullable=False),
        sa.Column("policy_sha256", sa.String(length=64), nullable=False),
        sa.Column("machine_id", sa.String(length=32), nullable=True),
        sa.Column("since_utc", sa.DateTime(timezone=True), nullable=True),
        sa.Column("until_utc", sa.DateTime(timezone=True), nullable=True),
        sa.Column("created_by", sa.String(length=64), nullable=False),
        sa.Column("created_utc", sa.DateTime(timezone=True), nullable=False),
        sa.Column("figures", sa.JSON(), nullable=False),
        sa.Column("report", sa.JSON(), nullable=False),
        sa.ForeignKeyConstraint(
            ["policy_sha256"],
            ["policies.policy_sha256"],
            name=op.f("fk_policy_shadows_policy_sha256"),
        ),
        sa.PrimaryKeyConstraint("shadow_id", name=op.f("pk_policy_shadows")),
    )
    op.create_index(
        "ix_policy_shadows_policy_sha256_shadow_id",
        "policy_shadows",
        ["policy_sha256", "shadow_id"],
    )


def downgrade() -> None:
    op.drop_index("ix_policy_shadows_policy_sha256_shadow_id", table_name="policy_shadows")
    op.drop_table("policy_shadows")
