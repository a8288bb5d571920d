from typing import Any

import numpy as np
import pytest

from machine.errors import UsageError
from sim_twin.throws.accuracy import AccuracyReport, TargetAccuracy
from sim_twin.throws.accuracy_comparison import (
    Verdict,
    compare_accuracy,
    comparison_table,
    deviation_ratio,
    mean_difference,
    share_difference,
)
from tests.cases import each

TRIALS = 400


def target(
    rng: np.random.Generator,
    *,
    mean_m: float = 0.02,
    sd_m: float = 0.05,
    landed_ratio: float = 0.98,
    throws: int = 60,
    range_m: float = 9.0,
) -> TargetAccuracy:
    landed = int(rng.binomial(throws, landed_ratio))
    down, cross = rng.normal(mean_m, sd_m, landed), rng.normal(0.01, 0.03, landed)
    return TargetAccuracy(
        range_m=range_m,
        height_m=0.0,
        throws=throws,
        landed=landed,
        success_ratio=landed / throws,
        mean_downrange_error_m=float(down.mean()),
        sd_downrange_m=float(down.std(ddof=1)),
        mean_crossrange_error_m=float(cross.mean()),
        sd_crossrange_m=float(cross.std(ddof=1)),
    )


def report(*targets: TargetAccuracy, **about: Any) -> AccuracyReport:
    fields: dict[str, Any] = {
        "mode": "2d", "plant": "virtual", "policy": "p", "is_registered": True, "seed": 0,
        "seconds": 1.0, "real_time_factor": 1.0, "targets": list(targets),
    }  # fmt: skip
    return AccuracyReport(**{**fields, **about})


def verdicts(first: TargetAccuracy, second: TargetAccuracy) -> dict[str, Verdict]:
    return {row.quantity: row.verdict for row in compare_accuracy(report(first), report(second))}


def test_intervals_cover_the_truth_as_often_as_they_say() -> None:
    rng = np.random.default_rng(1)
    covered = np.zeros(3)
    for _ in range(TRIALS):
        a, b = rng.normal(0.02, 0.05, 40), rng.normal(0.05, 0.08, 25)
        sds = float(a.std(ddof=1)), float(b.std(ddof=1))
        hits = int(rng.binomial(80, 0.9)), int(rng.binomial(60, 0.7))
        low_high = (
            mean_difference((float(a.mean()), float(b.mean())), sds, (40, 25), 0.9),
            deviation_ratio(sds, (40, 25), 0.9),
            share_difference(hits, (80, 60), 0.9),
        )
        covered += [
            low <= truth <= high
            for (low, high), truth in zip(low_high, (0.03, 1.6, -0.2), strict=True)
        ]
    # 0.9 with four standard errors of 400 trials.
    assert np.all(np.abs(covered / TRIALS - 0.9) < 0.06)


def test_equal_policies_seldom_get_a_verdict() -> None:
    rng = np.random.default_rng(2)
    claims = 0
    for _ in range(TRIALS):
        first, second = (report(*(target(rng, range_m=r) for r in (8.0, 9.0))) for _ in range(2))
        rows = compare_accuracy(first, second)
        claims += any(row.verdict is not Verdict.CANNOT_TELL for row in rows)
    assert claims / TRIALS <= 0.05 + 0.044


def test_clear_differences_have_the_direction_of_the_second() -> None:
    rng = np.random.default_rng(3)
    good = target(rng, throws=200)
    wide = target(rng, throws=200, sd_m=0.1)
    assert verdicts(good, wide)["sd down"] is Verdict.WORSE
    assert verdicts(wide, good)["sd down"] is Verdict.BETTER
    rare = target(rng, throws=200, landed_ratio=0.6)
    assert verdicts(good, rare)["landed"] is Verdict.WORSE
    assert verdicts(rare, good)["landed"] is Verdict.BETTER


@each("sign", [-1.0, 1.0])
def test_a_mean_is_better_when_it_is_nearer_to_the_target(sign: float) -> None:
    rng = np.random.default_rng(4)
    near, far = target(rng, throws=200), target(rng, throws=200, mean_m=sign * 0.2)
    assert verdicts(near, far)["mean down"] is Verdict.WORSE
    assert verdicts(far, near)["mean down"] is Verdict.BETTER


def test_equal_misses_on_both_sides_of_the_target_have_no_verdict() -> None:
    rng = np.random.default_rng(5)
    short, long = target(rng, throws=200, mean_m=-0.2), target(rng, throws=200, mean_m=0.2)
    assert verdicts(short, long)["mean down"] is Verdict.CANNOT_TELL


def test_too_few_landed_throws_cannot_tell() -> None:
    rng = np.random.default_rng(6)
    few = TargetAccuracy(
        range_m=9.0, height_m=0.0, throws=1, landed=1, success_ratio=1.0,
        mean_downrange_error_m=5.0, sd_downrange_m=None,
        mean_crossrange_error_m=5.0, sd_crossrange_m=None,
    )  # fmt: skip
    first, second = report(target(rng)), report(few)
    rows = compare_accuracy(first, second)
    assert {row.verdict for row in rows} == {Verdict.CANNOT_TELL}
    assert "cannot tell from 60 and 1 throws" in comparison_table(first, second, rows)


@each(
    ("about", "words"),
    [
        ({"mode": "3d"}, "mode is 2d in the first, 3d in the second"),
        ({"plant": "twin"}, "plant is virtual"),
        ({"is_registered": False}, "is_registered is True"),
        ({"targets": []}, "no target in common"),
    ],
)
def test_results_that_do_not_fit_are_refused(about: dict[str, Any], words: str) -> None:
    row = target(np.random.default_rng(7))
    with pytest.raises(UsageError, match=words):
        compare_accuracy(report(row), report(row, **about))
