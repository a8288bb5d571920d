"""Diagnoses keep which healthy throws of the machine they were compared with."""

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column(
        "gap_runs",
        sa.Column("reference_throw_ids", sa.JSON(), nullable=False, server_default="[]"),
    )


def downgrade() -> None:
    op.drop_column("gap_runs", "reference_throw_ids")
