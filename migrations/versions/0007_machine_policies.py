"""Which policy each machine had on board since when; filled from the starts that are known."""

from datetime import UTC, datetime

import sqlalchemy as sa
from alembic import op

revision = "0007"
down_revision = "0006"
branch_labels = None
depends_on = None

MODES = ("2d", "3d")


def upgrade() -> None:
    table = op.create_table(
        "machine_policies",
        sa.Column(
            "machine_policy_count",
            sa.BigInteger().with_variant(sa.Integer(), "sqlite"),
            autoincrement=True,
            nullable=False,
        ),
        sa.Column("machine_id", sa.String(length=32), nullable=False),
        sa.Column("mode", sa.String(length=2), nullable=False),
        sa.Column("policy_sha256", sa.String(length=64), nullable=True),
        sa.Column("since_utc", sa.DateTime(timezone=True), nullable=False),
        sa.PrimaryKeyConstraint("machine_policy_count", name=op.f("pk_machine_policies")),
    )
    op.create_index(
        op.f("ix_machine_policies_machine_id_since_utc"),
        "machine_policies",
        ["machine_id", "since_utc"],
    )
    events = sa.table(
        "events",
        sa.column("event_count", sa.BigInteger()),
        sa.column("machine_id", sa.String()),
        sa.column("kind", sa.String()),
        sa.column("t_utc", sa.String()),
        sa.column("data", sa.JSON()),
    )
    connection = op.get_bind()
    booted = connection.execute(
        sa.select(events.c.machine_id, events.c.t_utc, events.c.data)
        .where(events.c.kind == "booted")
        .order_by(events.c.event_count)
    ).all()
    for machine_id, t_utc, data in booted:
        aboard = data.get("policy_sha256") if isinstance(data, dict) else None
        since_utc = _time(t_utc)
        if not isinstance(aboard, dict) or since_utc is None:
            continue
        for mode in MODES:
            connection.execute(
                table.insert().values(
                    machine_id=machine_id,
                    mode=mode,
                    policy_sha256=aboard.get(mode),
                    since_utc=since_utc,
                )
            )


def _time(text: str) -> datetime | None:
    try:
        time = datetime.fromisoformat(text)
    except ValueError:
        return None
    time = time if time.tzinfo is not None else time.replace(tzinfo=UTC)
    return time.astimezone(UTC).replace(tzinfo=None if _is_sqlite() else UTC)


def _is_sqlite() -> bool:
    return op.get_bind().dialect.name == "sqlite"


def downgrade() -> None:
    op.drop_index(op.f("ix_machine_policies_machine_id_since_utc"), table_name="machine_policies")
    op.drop_table("machine_policies")
