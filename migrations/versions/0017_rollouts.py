"""Rollouts of policy versions, their steps and machines."""

import sqlalchemy as sa
from alembic import op

revision = "0017"
down_revision = "0016"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "rollouts",
        sa.Column("rollout_id", sa.String(length=36), nullable=False),
        sa.Column("mode", sa.String(length=2), nullable=False),
        sa.Column("policy_sha256", sa.String(length=64), nullable=False),
        sa.Column("stages", sa.JSON(), nullable=False),
        sa.Column("deadline_s", sa.Double(), nullable=False),
        sa.Column("throws_count", sa.Integer(), nullable=False),
        sa.Column("reason", sa.String(length=300), nullable=False),
        sa.Column("created_by", sa.String(length=64), nullable=False),
        sa.Column("created_utc", sa.DateTime(timezone=True), nullable=False),
        sa.PrimaryKeyConstraint("rollout_id", name=op.f("pk_rollouts")),
    )
    op.create_table(
        "rollout_steps",
        sa.Column(
            "step_count",
            sa.BigInteger().with_variant(sa.Integer(), "sqlite"),
            nullable=False,
        ),
        sa.Column("rollout_id", sa.String(length=36), nullable=False),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("stage_count", sa.BigInteger(), nullable=False),
        sa.Column("actor", sa.String(length=64), nullable=False),
        sa.Column("sentence", sa.Text(), nullable=False),
        sa.Column("at_utc", sa.DateTime(timezone=True), nullable=False),
        sa.ForeignKeyConstraint(
            ["rollout_id"], ["rollouts.rollout_id"], name=op.f("fk_rollout_steps_rollout_id")
        ),
        sa.PrimaryKeyConstraint("step_count", name=op.f("pk_rollout_steps")),
    )
    op.create_index(
        "ix_rollout_steps_rollout_id_step_count", "rollout_steps", ["rollout_id", "step_count"]
    )
    op.create_table(
        "rollout_machines",
        sa.Column("rollout_id", sa.String(length=36), nullable=False),
        sa.Column("machine_id", sa.String(length=32), nullable=False),
        sa.Column("before_sha256", sa.String(length=64), nullable=True),
        sa.Column("deployment_count", sa.BigInteger(), nullable=True),
        sa.Column("asked_utc", sa.DateTime(timezone=True), nullable=False),
        sa.ForeignKeyConstraint(
            ["machine_id"], ["machines.machine_id"], name=op.f("fk_rollout_machines_machine_id")
        ),
        sa.ForeignKeyConstraint(
            ["rollout_id"], ["rollouts.rollout_id"], name=op.f("fk_rollout_machines_rollout_id")
        ),
        sa.PrimaryKeyConstraint("rollout_id", "machine_id", name=op.f("pk_rollout_machines")),
    )


def downgrade() -> None:
    op.drop_table("rollout_machines")
    op.drop_index("ix_rollout_steps_rollout_id_step_count", table_name="rollout_steps")
    op.drop_table("rollout_steps")
    op.drop_table("rollouts")
