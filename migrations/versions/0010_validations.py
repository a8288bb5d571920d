"""Validations of policy versions, their finished parts, and the gates that people set."""

import sqlalchemy as sa
from alembic import op

revision = "0010"
down_revision = "0009"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "policy_validations",
        sa.Column("validation_id", sa.String(length=36), nullable=False),
        sa.Column("policy_sha256", sa.String(length=64), nullable=False),
        sa.Column("active_sha256", sa.String(length=64), nullable=True),
        sa.Column("created_by", sa.String(length=64), nullable=False),
        sa.Column("created_utc", sa.DateTime(timezone=True), nullable=False),
        sa.Column("started_utc", sa.DateTime(timezone=True), nullable=True),
        sa.Column("ended_utc", sa.DateTime(timezone=True), nullable=True),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("detail", sa.Text(), nullable=False),
        sa.Column("plan", sa.JSON(), nullable=False),
        sa.Column("gates", sa.JSON(), nullable=False),
        sa.Column("is_passed", sa.Boolean(), nullable=True),
        sa.Column("result", sa.JSON(none_as_null=True), nullable=True),
        sa.ForeignKeyConstraint(
            ["policy_sha256"],
            ["policies.policy_sha256"],
            name=op.f("fk_policy_validations_policy_sha256"),
        ),
        sa.PrimaryKeyConstraint("validation_id", name=op.f("pk_policy_validations")),
    )
    op.create_index(
        "ix_policy_validations_policy_sha256_validation_id",
        "policy_validations",
        ["policy_sha256", "validation_id"],
        unique=False,
    )
    op.create_index(
        op.f("ix_policy_validations_state"), "policy_validations", ["state"], unique=False
    )
    op.create_table(
        "policy_validation_parts",
        sa.Column("validation_id", sa.String(length=36), nullable=False),
        sa.Column("part", sa.String(length=64), nullable=False),
        sa.Column("landings", sa.JSON(), nullable=False),
        sa.ForeignKeyConstraint(
            ["validation_id"],
            ["policy_validations.validation_id"],
            name=op.f("fk_policy_validation_parts_validation_id"),
        ),
        sa.PrimaryKeyConstraint("validation_id", "part", name=op.f("pk_policy_validation_parts")),
    )
    op.create_table(
        "validation_gates",
        sa.Column("mode", sa.String(length=2), nullable=False),
        sa.Column("version_count", sa.BigInteger(), autoincrement=False, nullable=False),
        sa.Column("gates", sa.JSON(), nullable=False),
        sa.Column("reason", sa.String(length=300), nullable=False),
        sa.Column("created_by", sa.String(length=64), nullable=False),
        sa.Column("created_utc", sa.DateTime(timezone=True), nullable=False),
        sa.PrimaryKeyConstraint("mode", "version_count", name=op.f("pk_validation_gates")),
    )


def downgrade() -> None:
    op.drop_table("validation_gates")
    op.drop_table("policy_validation_parts")
    op.drop_index(op.f("ix_policy_validations_state"), table_name="policy_validations")
    op.drop_index(
        "ix_policy_validations_policy_sha256_validation_id", table_name="policy_validations"
    )
    op.drop_table("policy_validations")
