"""Time of a page of the throw history and of its statistics, for every kind of filter, of a million throws.

    python -m benchmarks.history [--rows 1000000] [--database-urls URL ...] [--json FILE]

Pages lie at random depths; statistics are those of the newest throws that match, as JSON. Without a URL the
database is a SQLite file in a temporary folder; a database that holds throws already is measured as it is.
"""

import os
import random
import tempfile
import time
from datetime import UTC, datetime, timedelta
from pathlib import Path

import tyro
from sqlalchemy import insert, select

from benchmarks.result_file import RESULTS, Row, describe, percentile, row, write_result
from machine.conventions import Mode
from server.clock import id_at, utc_now
from server.schemas.history import GroupBy, Outcome
from server.serve import settle_memory
from server.store.database import Database, upgrade
from server.store.models import Machine, Throw
from server.throws.throw_history import ThrowFilter, ThrowHistory
from server.throws.throw_statistics import ThrowStatistics

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
    "range, 20 cm": ThrowFilter(min_range_m=8.0, max_range_m=8.2),
    "range, none": ThrowFilter(min_range_m=20.0),
    "machine and mode": ThrowFilter(machine_id="m005", mode=Mode.SPATIAL),
    "machine and outcome": ThrowFilter(machine_id="m018", outcome=Outcome.FAULT),
    "operator and policy": ThrowFilter(operator="operator40", policy_sha256=f"{20:064d}"),
    "machine and range": ThrowFilter(machine_id="m010", min_range_m=8.0, max_range_m=8.1),
    "one week": ThrowFilter(since=START + timedelta(days=200), until=START + timedelta(days=207)),
}


def main(
    rows: int = 1_000_000,
    database_urls: tuple[str, ...] = (),
    repeats: int = 40,
    json: Path = RESULTS / "history.json",
) -> None:
    """Fill databases and time pages and statistics."""
    found: list[Row] = []
    with tempfile.TemporaryDirectory() as folder:
        for url in database_urls or (f"sqlite:///{Path(folder) / 'bench.db'}",):
            upgrade(url)
            database = Database(url)
            if not _is_filled(database):
                fill(database, rows)
            settle_memory()
            found += measure(database, repeats)
            database.close()
    title = f"Time of one page and of statistics of {rows} throws"
    notes = f"load average of the computer: {os.getloadavg()[0]:.0f}"
    if os.sched_getscheduler(0) == os.SCHED_FIFO:
        notes += "; the benchmark had real-time priority (chrt -f 5)"
    write_result(describe("history", title, found, seed=2, notes=notes), json)


def measure(database: Database, repeats: int) -> list[Row]:
    """Rows of each filter and of all together."""
    rng = random.Random(2)
    history, statistics = ThrowHistory(database), ThrowStatistics(database)

    def page(wanted: ThrowFilter, repeat: int) -> None:
        depth = START + timedelta(days=rng.uniform(0, 730))
        history.page(wanted, None if repeat % 2 else id_at(depth), 50)

    def figures(wanted: ThrowFilter, _: int) -> None:
        statistics.of(wanted, GroupBy.POLICY).model_dump_json()

    found: list[Row] = []
    print(f"{'filter':<44}{'p50 ms':>9}{'p95 ms':>9}{'max ms':>9}")
    for operation, act in (("page", page), ("statistics", figures)):
        labels = {"operation": operation, "database": database.dialect}
        everything: list[float] = []
        for name, wanted in FILTERS.items():
            times: list[float] = []
            for repeat in range(repeats):
                began_s = time.perf_counter()
                act(wanted, repeat)
                times.append((time.perf_counter() - began_s) * 1e3)
            everything += times
            found.append(summary(labels | {"filter": name}, times))
        found.append(summary(labels | {"filter": "all"}, everything))
    return found


def _is_filled(database: Database) -> bool:
    with database.read() as session:
        return session.scalar(select(Throw.throw_id).limit(1)) is not None


def summary(labels: dict[str, str], times: list[float]) -> Row:
    """Print and return percentiles of one filter."""
    values = {
        "p50_ms": percentile(times, 50),
        "p95_ms": percentile(times, 95),
        "max_ms": max(times),
    }
    line = row(len(times), labels, values)
    print(
        f"{', '.join(labels.values()):<44}"
        + "".join(f"{v.value:>9.1f}" for v in line.values.values())
    )
    return line


if __name__ == "__main__":
    tyro.cli(main)
