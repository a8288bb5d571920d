"""The motion of a plan with exclusion zones, as the machine checks it."""

import sqlalchemy as sa
from alembic import op

revision = "0022"
down_revision = "0021"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column(
        "plans", sa.Column("swept_path_rad_m", sa.JSON(), nullable=False, server_default="[]")
    )


def downgrade() -> None:
    with op.batch_alter_table("plans") as plans:
        plans.drop_column("swept_path_rad_m")
