"""One-time tokens by which machines are set up, and machines out of service."""

import sqlalchemy as sa
from alembic import op

revision = "0016"
down_revision = "0014"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("machines", sa.Column("retired_utc", sa.DateTime(timezone=True), nullable=True))
    op.create_table(
        "enrolments",
        sa.Column("enrolment_id", sa.String(36), nullable=False),
        sa.Column("machine_id", sa.String(32), nullable=False),
        sa.Column("token_sha256", sa.String(64), nullable=False),
        sa.Column("created_by", sa.String(64), nullable=False),
        sa.Column("created_utc", sa.DateTime(timezone=True), nullable=False),
        sa.Column("expires_utc", sa.DateTime(timezone=True), nullable=False),
        sa.Column("claimed_utc", sa.DateTime(timezone=True), nullable=True),
        sa.Column("claimed_from", sa.String(64), nullable=False),
        sa.Column("self_test", sa.JSON(), nullable=True),
        sa.Column("tested_utc", sa.DateTime(timezone=True), nullable=True),
        sa.PrimaryKeyConstraint("enrolment_id", name="pk_enrolments"),
        sa.ForeignKeyConstraint(
            ["machine_id"], ["machines.machine_id"], name="fk_enrolments_machine_id_machines"
        ),
        sa.UniqueConstraint("token_sha256", name="uq_enrolments_token_sha256"),
    )
    op.create_index(
        "ix_enrolments_machine_id_enrolment_id", "enrolments", ["machine_id", "enrolment_id"]
    )


def downgrade() -> None:
    op.drop_table("enrolments")
    # Not by batch: that drops the table, which leases refer to. SQLite can since 3.35.
    op.drop_column("machines", "retired_utc")
