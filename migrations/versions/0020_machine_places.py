"""Places of machines in the yard."""

import sqlalchemy as sa
from alembic import op

revision = "0020"
down_revision = "0018"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "machine_places",
        sa.Column("machine_id", sa.String(length=32), nullable=False),
        sa.Column("x_m", sa.Double(), nullable=False),
        sa.Column("y_m", sa.Double(), nullable=False),
        sa.Column("heading_rad", sa.Double(), nullable=False),
        sa.Column("changed_by", sa.String(length=64), nullable=False),
        sa.Column("changed_utc", sa.DateTime(timezone=True), nullable=False),
        sa.ForeignKeyConstraint(
            ["machine_id"], ["machines.machine_id"], name=op.f("fk_machine_places_machine_id")
        ),
        sa.PrimaryKeyConstraint("machine_id", name=op.f("pk_machine_places")),
    )


def downgrade() -> None:
    op.drop_table("machine_places")
