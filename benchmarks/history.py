"""History of a million throws: time of one page for every kind of filter, at random depths.

    python benchmarks/history.py [--rows 1000000] [--database-url URL]

Without a URL a SQLite file in a temporary folder. The floor is the cheapest page: no filter, first page.
"""

import random
import tempfile
import time
from datetime import UTC, datetime, timedelta
from pathlib import Path

import tyro
from sqlalchemy import insert

from machine.conventions import Mode
from server.clock import id_at, utc_now
from server.schemas.history import GroupBy, Outcome
from server.store.database import Database, upgrade
from server.store.models import Machine, Throw
from server.throws.history import History, ThrowFilter
from server.throws.stats import Statistics

START = datetime(2024, 1, 1, tzinfo=UTC)
CHUNK = 20_000


def fill(database: Database, rows: int) -> timedelta:
    """Insert throws evenly over two years; returns the time between two of them."""
    rng = random.Random(1)
    step = timedelta(days=730) / rows
    with database.write() as session:
        session.add_all(
            Machine(
                machine_id=f"m{index:03d}",
                site="yard",
                name="",
                token_sha256="",
                is_listed=True,
                enrolled_utc=utc_now(),
            )
            for index in range(20)
        )
    for first in range(0, rows, CHUNK):
        batch = [
            throw(rng, START + step * index) for index in range(first, min(first + CHUNK, rows))
        ]
        with database.write() as session:
            session.execute(insert(Throw), batch)
    return step


def throw(rng: random.Random, moment: datetime) -> dict[str, object]:
    landed = rng.random() < 0.97
    range_m = rng.uniform(6.0, 10.9)
    return {
        "throw_id": id_at(moment),
        "machine_id": f"m{int(rng.triangular(0, 20, 0)):03d}",
        "plan_id": id_at(moment),
        "session_id": "s",
        "created_utc": moment,
        "operator": f"operator{int(rng.triangular(0, 50, 0))}",
        "epoch_count": 1,
        "mode": rng.choice(("2d", "3d")),
        "target_x_m": range_m,
        "target_y_m": 0.0,
        "target_z_m": 0.0,
        "range_m": range_m,
        "policy_id": "p",
        "policy_sha256": f"{int(rng.triangular(0, 30, 0)):064d}",
        "phase": "ended",
        "outcome": "landed" if landed else rng.choice(("aborted", "stopped", "fault")),
        "detail": "",
        "predicted_downrange_error_m": 0.0,
        "predicted_crossrange_error_m": 0.0,
        "measured_downrange_error_m": rng.gauss(0.0, 0.2) if landed else None,
        "measured_crossrange_error_m": rng.gauss(0.0, 0.1) if landed else None,
        "impact_source": "survey",
        "has_log": True,
    }


FILTERS = {
    "none": ThrowFilter(),
    "machine, busy": ThrowFilter(machine_id="m000"),
    "machine, rare": ThrowFilter(machine_id="m019"),
    "mode": ThrowFilter(mode=Mode.PLANAR),
    "policy, rare": ThrowFilter(policy_sha256=f"{29:064d}"),
    "operator, rare": ThrowFilter(operator="operator49"),
    "outcome, rare": ThrowFilter(outcome=Outcome.FAULT),
    "outcome, none": ThrowFilter(outcome=Outcome.REFUSED),
    "range, wide": ThrowFilter(min_range_m=7.0, max_range_m=9.0),
    "range, 1 cm": ThrowFilter(min_range_m=8.0, max_range_m=8.01),
    "range, none": ThrowFilter(min_range_m=20.0),
    "machine and mode": ThrowFilter(machine_id="m005", mode=Mode.SPATIAL),
    "machine and outcome": ThrowFilter(machine_id="m018", outcome=Outcome.FAULT),
    "operator and policy": ThrowFilter(operator="operator40", policy_sha256=f"{20:064d}"),
    "machine and range": ThrowFilter(machine_id="m010", min_range_m=8.0, max_range_m=8.1),
    "one week": ThrowFilter(since=START + timedelta(days=200), until=START + timedelta(days=207)),
}


def main(rows: int = 1_000_000, database_url: str | None = None, repeats: int = 40) -> None:
    """Fill and measure."""
    with tempfile.TemporaryDirectory() as folder:
        url = database_url or f"sqlite:///{Path(folder) / 'bench.db'}"
        upgrade(url)
        database = Database(url)
        began_s = time.perf_counter()
        fill(database, rows)
        print(f"{rows} throws in {time.perf_counter() - began_s:.0f} s, {database.dialect}")
        measure(History(database), Statistics(database), repeats)
        database.close()


def measure(history: History, statistics: Statistics, repeats: int) -> None:
    rng = random.Random(2)
    everything: list[float] = []
    print(f"{'filter':<22}{'p50 ms':>9}{'p95 ms':>9}{'max ms':>9}")
    for name, wanted in FILTERS.items():
        times: list[float] = []
        for repeat in range(repeats):
            depth = START + timedelta(days=rng.uniform(0, 730))
            cursor = None if repeat % 2 else id_at(depth)
            began_s = time.perf_counter()
            history.page(wanted, cursor, 50)
            times.append((time.perf_counter() - began_s) * 1e3)
        everything += times
        show(name, times)
    show("all", everything)
    for name, wanted in (
        ("stats", ThrowFilter()),
        ("stats of a machine", FILTERS["machine, rare"]),
    ):
        times = []
        for _ in range(5):
            began_s = time.perf_counter()
            statistics.of(wanted, GroupBy.POLICY)
            times.append((time.perf_counter() - began_s) * 1e3)
        show(name, times)


def show(name: str, times: list[float]) -> None:
    ordered = sorted(times)
    p50, p95 = ordered[len(ordered) // 2], ordered[int(len(ordered) * 0.95)]
    print(f"{name:<22}{p50:>9.1f}{p95:>9.1f}{ordered[-1]:>9.1f}")


if __name__ == "__main__":
    tyro.cli(main)
