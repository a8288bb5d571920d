"""The pace of plans and throws; earlier rows have none."""

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"
branch_labels = None
depends_on = None

TABLES = ("plans", "throws")


def upgrade() -> None:
    for table in TABLES:
        op.add_column(
            table, sa.Column("pace_ratio", sa.Double(), nullable=False, server_default="0.0")
        )


def downgrade() -> None:
    for table in TABLES:
        op.drop_column(table, "pace_ratio")
