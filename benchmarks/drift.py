"""False alarms and delays of the drift test over simulated machine-months.

    python -m benchmarks.drift [--months 2000] [--json FILE]

A machine-month is 1000 measured throws of a machine in one mode: 50 on each of 20 days. Half of the months
have normal misses, the others those of heavier tails and of a skewed distribution; the misses along and
across are correlated. Delays begin after 300 throws without a change.
"""

from pathlib import Path

import numpy as np
import tyro

from benchmarks.result_file import RESULTS, Row, Value, describe, percentile, row, write_result
from server.drift.drift_test import FALSE_ALARM_THROWS, Drift, DriftTest, ThrowMiss

MONTH_COUNT = 1000
BEFORE_COUNT = 300
AFTER_COUNT = 1500
DELAY_REPEATS = 200
CORRELATION = 0.3
SEED = 20

Scatter = np.ndarray


def normal(rng: np.random.Generator, count: int) -> Scatter:
    """Normal misses (count, 2) of spread 1."""
    scatter = rng.standard_normal((count, 2))
    scatter[:, 1] = CORRELATION * scatter[:, 0] + np.sqrt(1 - CORRELATION**2) * scatter[:, 1]
    return scatter


def student(rng: np.random.Generator, count: int) -> Scatter:
    """Misses with heavy tails: Student's t with 4 degrees of freedom, spread 1."""
    return normal(rng, count) / np.sqrt(rng.chisquare(4, (count, 1)) / 4) / np.sqrt(2.0)


def skewed(rng: np.random.Generator, count: int) -> Scatter:
    """Skewed misses: exponential of normal ones, spread 1."""
    return np.exp(0.5 * normal(rng, count)) / 0.604


def add(test: DriftTest, scatter: Scatter, sd_m: float) -> list[bool]:
    """Whether the test stands at an alarm after each throw."""
    return [
        test.add(ThrowMiss(along, across, along * sd_m, across * sd_m)) is not None
        for along, across in scatter.tolist()
    ]


def first_drift(test: DriftTest, scatter: Scatter, sd_m: float) -> Drift | None:
    """The first alarm, if there is one."""
    for along, across in scatter.tolist():
        found = test.add(ThrowMiss(along, across, along * sd_m, across * sd_m))
        if found is not None:
            return found
    return None


def false_alarms(months: int) -> list[Row]:
    rows: list[Row] = []
    for kind, share in ((normal, 0.5), (student, 0.25), (skewed, 0.25)):
        rng = np.random.default_rng([SEED, len(rows)])
        count = round(months * share)
        per_month = np.zeros(count)
        for month in range(count):
            alarm = np.array([False, *add(DriftTest(), kind(rng, MONTH_COUNT), 0.1)])
            per_month[month] = np.count_nonzero(alarm[1:] & ~alarm[:-1])
        rate = per_month.sum() / (count * MONTH_COUNT)
        error = per_month.std(ddof=1) / np.sqrt(count) / MONTH_COUNT
        lowest = max(rate - 1.96 * error, 1e-9)
        throws = Value(
            value=1.0 / max(rate, 1e-9), low=1.0 / (rate + 1.96 * error), high=1.0 / lowest
        )
        rows.append(
            row(
                count,
                {"what": "false alarm", "misses": kind.__name__, "spread_m": "any"},
                {
                    "throws_count": throws,
                    "p90_throws_count": None,
                    "found_ratio": None,
                    "p95_late_count": None,
                },
            )
        )
    return rows


def delays() -> list[Row]:
    rows: list[Row] = []
    for sd_m in (0.1, 0.2, 0.3):
        for what, shift_m, ratio in (
            ("bias of 5 cm", 0.05, 1.0),
            ("bias of one spread", sd_m, 1.0),
            ("1.5 times the spread", 0.0, 1.5),
        ):
            rng = np.random.default_rng([SEED, 100 + len(rows)])
            found: list[float] = []
            late: list[float] = []
            for _ in range(DELAY_REPEATS):
                test = DriftTest()
                while any(add(test, normal(rng, BEFORE_COUNT), sd_m)):
                    test = DriftTest()  # a false alarm before the change tells nothing of its delay
                after = normal(rng, AFTER_COUNT) * ratio
                after[:, 0] += shift_m / sd_m
                drift = first_drift(test, after, sd_m)
                found.append(np.inf if drift is None else drift.alarm_count - BEFORE_COUNT)
                if drift is not None:
                    late.append(drift.change_count - BEFORE_COUNT)
            seen = np.array(found)
            rows.append(
                row(
                    DELAY_REPEATS,
                    {"what": what, "misses": "normal", "spread_m": sd_m},
                    {
                        "throws_count": percentile(np.minimum(seen, AFTER_COUNT), 50),
                        "p90_throws_count": percentile(np.minimum(seen, AFTER_COUNT), 90),
                        "found_ratio": float(np.isfinite(seen).mean()),
                        "p95_late_count": percentile(late, 95),
                    },
                )
            )
    return rows


def main(months: int = 2000, json: Path = RESULTS / "drift.json") -> None:
    """Measure and write the result.

    Args:
        months: simulated machine-months without a change.
        json: where the result is written.
    """
    rows = [*false_alarms(months), *delays()]
    result = describe(
        "drift",
        "Throws to a false alarm (mean), and from a change to its alarm (median)",
        rows,
        seed=SEED,
        notes=(
            f"stated rate: 1 in {FALSE_ALARM_THROWS:.0f} throws; {BEFORE_COUNT} throws before a change; "
            "p95_late_count: throws by which the estimated change point lies after the change"
        ),
    )
    for line in rows:
        print(line.n, *line.labels.values(), *(v.value for v in line.values.values()))
    print(write_result(result, json))


if __name__ == "__main__":
    tyro.cli(main)
