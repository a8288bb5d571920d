from statistics import NormalDist

import numpy as np
import pytest

from server.drift.cusum import (
    Cusum,
    mean_evidence,
    mean_run_length,
    mean_threshold,
    spread_evidence,
    spread_threshold,
)
from tests.cases import each


@each(("threshold", "length"), [(4.0, 168.0), (5.0, 465.0)])
def test_run_lengths_are_those_of_the_literature(threshold: float, length: float):
    """One-sided lengths are twice the two-sided ones of Montgomery, table for an allowance of 0.5."""
    cdf = NormalDist().cdf
    assert mean_run_length(lambda x: cdf(x + 0.5), threshold) == pytest.approx(2 * length, rel=0.02)


def run_lengths(evidence, threshold: float, count: int) -> list[int]:
    rng = np.random.default_rng(1)
    lengths: list[int] = []
    total, since = Cusum(threshold), 0
    for score in rng.standard_normal(count):
        since += 1
        if total.add(evidence(float(score)), since):
            lengths.append(since)
            total, since = Cusum(threshold), 0
    return lengths


def test_thresholds_give_the_stated_rate_in_simulation():
    mean = run_lengths(lambda x: mean_evidence(x, 0.5), mean_threshold(0.5, 200.0), 100_000)
    spread = run_lengths(lambda x: spread_evidence(x, 1.5), spread_threshold(1.5, 200.0), 100_000)
    for lengths in (mean, spread):
        error = np.std(lengths) / np.sqrt(len(lengths))
        assert abs(np.mean(lengths) - 200.0) < 4.0 * error + 4.0


def test_spread_evidence_is_the_log_likelihood_ratio():
    wide, usual = NormalDist(0.0, 1.5), NormalDist()
    for score in (-2.0, 0.0, 0.7, 3.0):
        expected = np.log(wide.pdf(score) / usual.pdf(score))
        assert spread_evidence(score, 1.5) == pytest.approx(expected)


def test_a_sum_stays_between_zero_and_its_threshold_and_knows_its_last_zero():
    total = Cusum(3.0)
    assert not total.add(-1.0, 1)
    assert (total.value, total.zero_count) == (0.0, 1)
    assert not total.add(2.0, 2)
    assert total.add(5.0, 3)
    assert (total.value, total.zero_count) == (3.0, 1)
    total.add(-3.5, 4)
    assert (total.value, total.zero_count) == (0.0, 4)
