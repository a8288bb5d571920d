"""Keys that machines trust, as they say."""

import sqlalchemy as sa
from alembic import op

revision = "0025"
down_revision = "0022"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "machine_trusts",
        sa.Column("machine_id", sa.String(length=32), nullable=False),
        sa.Column("serial_count", sa.BigInteger(), nullable=False),
        sa.Column("key_ids", sa.JSON(), nullable=False),
        sa.Column("reported_utc", sa.DateTime(timezone=True), nullable=False),
        sa.ForeignKeyConstraint(
            ["machine_id"], ["machines.machine_id"], name=op.f("fk_machine_trusts_machine_id")
        ),
        sa.PrimaryKeyConstraint("machine_id", name=op.f("pk_machine_trusts")),
    )


def downgrade() -> None:
    op.drop_table("machine_trusts")
