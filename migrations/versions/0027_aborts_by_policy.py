"""Whether a throw was aborted by what its policy did."""

import sqlalchemy as sa
from alembic import op

revision = "0027"
down_revision = "0026"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("throws", sa.Column("is_policys_own", sa.Boolean(), nullable=True))


def downgrade() -> None:
    with op.batch_alter_table("throws") as batch:
        batch.drop_column("is_policys_own")
