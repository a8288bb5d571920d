"""Tags by which people sort machines."""

import sqlalchemy as sa
from alembic import op

revision = "0013"
down_revision = "0012"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("machines", sa.Column("tags", sa.JSON(), nullable=False, server_default="[]"))


def downgrade() -> None:
    # Not by batch: that drops the table, which leases refer to. SQLite can since 3.35.
    op.drop_column("machines", "tags")
