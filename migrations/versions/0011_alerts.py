"""Alerts: what was found when, who acknowledged it, and until when it is silent."""

import sqlalchemy as sa
from alembic import op

revision = "0011"
down_revision = "0010"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "alerts",
        sa.Column("alert_id", sa.String(length=36), nullable=False),
        sa.Column("rule", sa.String(length=16), nullable=False),
        sa.Column("severity", sa.String(length=16), nullable=False),
        sa.Column("machine_id", sa.String(length=32), nullable=True),
        sa.Column("text", sa.Text(), nullable=False),
        sa.Column("opened_utc", sa.DateTime(timezone=True), nullable=False),
        sa.Column("seen_utc", sa.DateTime(timezone=True), nullable=False),
        sa.Column("cleared_utc", sa.DateTime(timezone=True), nullable=True),
        sa.Column("acknowledged_by", sa.String(length=64), nullable=True),
        sa.Column("acknowledged_utc", sa.DateTime(timezone=True), nullable=True),
        sa.Column("note", sa.String(length=500), nullable=False),
        sa.Column("silenced_until_utc", sa.DateTime(timezone=True), nullable=True),
        sa.Column("silenced_by", sa.String(length=64), nullable=True),
        sa.PrimaryKeyConstraint("alert_id", name=op.f("pk_alerts")),
    )
    op.create_index(op.f("ix_alerts_cleared_utc"), "alerts", ["cleared_utc"])
    op.create_index(op.f("ix_alerts_machine_id_alert_id"), "alerts", ["machine_id", "alert_id"])


def downgrade() -> None:
    op.drop_index(op.f("ix_alerts_machine_id_alert_id"), table_name="alerts")
    op.drop_index(op.f("ix_alerts_cleared_utc"), table_name="alerts")
    op.drop_table("alerts")
