"""The card with which a version was validated: an approval rests on the same files."""

import sqlalchemy as sa
from alembic import op

revision = "0014"
down_revision = "0013"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column(
        "policy_validations", sa.Column("card_sha256", sa.String(length=64), nullable=True)
    )


def downgrade() -> None:
    # Not by batch: that drops the table, which its parts refer to. SQLite can since 3.35.
    op.drop_column("policy_validations", "card_sha256")
