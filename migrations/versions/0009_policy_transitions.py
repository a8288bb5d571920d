"""The life of each policy version: who moved it from which state to which, when, why, on what evidence."""

import sqlalchemy as sa
from alembic import op

revision = "0009"
down_revision = "0008"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "policy_transitions",
        sa.Column(
            "transition_count",
            sa.BigInteger().with_variant(sa.Integer(), "sqlite"),
            autoincrement=True,
            nullable=False,
        ),
        sa.Column("policy_sha256", sa.String(length=64), nullable=False),
        sa.Column("from_state", sa.String(length=16), nullable=True),
        sa.Column("to_state", sa.String(length=16), nullable=False),
        sa.Column("actor", sa.String(length=64), nullable=False),
        sa.Column("reason", sa.String(length=300), nullable=False),
        sa.Column("evidence", sa.JSON(), nullable=False),
        sa.Column("at_utc", sa.DateTime(timezone=True), nullable=False),
        sa.ForeignKeyConstraint(
            ["policy_sha256"],
            ["policies.policy_sha256"],
            name=op.f("fk_policy_transitions_policy_sha256"),
        ),
        sa.PrimaryKeyConstraint("transition_count", name=op.f("pk_policy_transitions")),
    )
    op.create_index(
        op.f("ix_policy_transitions_policy_sha256"), "policy_transitions", ["policy_sha256"]
    )


def downgrade() -> None:
    op.drop_table("policy_transitions")
