"""Accuracy of throws: scatter, one sigma ellipses by group, and error against range (the paper's figures)."""

from server.schemas.history import GroupBy, ThrowStats
from server.store.database import Database
from server.store.models import Throw
from server.throws.landing_statistics import Measured, statistics_of
from server.throws.throw_history import ThrowFilter, newest_values

CONSIDERED_LIMIT = 2000
"""Newest measured throws that statistics are made of: they tell a scatter to 1.6 %.
More are neither readable nor quick (benchmarks/history.py)."""

_MEASURED = (
    Throw.throw_id,
    Throw.machine_id,
    Throw.operator,
    Throw.mode,
    Throw.policy_id,
    Throw.policy_sha256,
    Throw.range_m,
    Throw.measured_downrange_error_m,
    Throw.measured_crossrange_error_m,
    Throw.predicted_downrange_error_m,
    Throw.predicted_crossrange_error_m,
)


class ThrowStatistics:
    """Makes statistics from the history."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def of(self, wanted: ThrowFilter, group_by: GroupBy) -> ThrowStats:
        """Statistics of the newest throws that match and have a measured impact."""
        with self._database.read() as database:
            rows = newest_values(
                database, wanted, CONSIDERED_LIMIT + 1, _MEASURED, is_measured=True
            )
        used = [Measured._make(row) for row in rows[:CONSIDERED_LIMIT]]
        return statistics_of(used, group_by, is_truncated=len(rows) > CONSIDERED_LIMIT)
