"""Indexes of throws that hold what filters and statistics check, so that only what matches is fetched."""

from alembic import op

revision = "0023"
down_revision = "0019"
branch_labels = None
depends_on = None


def upgrade() -> None:
    _replace(
        ["machine_id", "throw_id", "mode", "range_m", "outcome"],
        ["range_m", "throw_id", "machine_id", "mode", "measured_downrange_error_m"],
    )


def downgrade() -> None:
    _replace(["machine_id", "throw_id"], ["range_m"])


def _replace(machine_columns: list[str], range_columns: list[str]) -> None:
    for name, columns in (
        ("ix_throws_machine_id_throw_id", machine_columns),
        ("ix_throws_range_m", range_columns),
    ):
        op.drop_index(name, table_name="throws")
        op.create_index(name, "throws", columns)
