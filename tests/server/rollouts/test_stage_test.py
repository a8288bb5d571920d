"""The test that ends a stage: rates, invariances, and each way of being worse."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from evaluation.validation.gates import DEFAULT_GATES
from server.rollouts.stage_test import LOOKS, SHARES, Regression, StageThrow, looks, stage_test
from tests.cases import each

GATES = DEFAULT_GATES["2d"]
SD_M = (0.05, 0.03)


def throws(seed, count, ratio=1.0, mean_m=(0.0, 0.0), scale=1.0):
    scatter = np.random.default_rng(seed).standard_normal((count, 2)) * SD_M * ratio + mean_m
    return [StageThrow(a * scale, b * scale, scale, scale) for a, b in scatter.tolist()]


def judge(before, since, machine_count=20, throws_count=12):
    return stage_test(before, since, GATES, machine_count=machine_count, throws_count=throws_count)


def test_the_shares_add_up():
    assert sum(SHARES.values()) == pytest.approx(1.0)
    assert sum(spent for _, spent in LOOKS) == pytest.approx(1.0)
    assert [count for count, _ in looks(12)] == [6, 9, 12]


@each(
    ("since", "regression"),
    [
        (throws(1, 12, ratio=5.0), Regression.SPREAD),
        (throws(2, 12, mean_m=(0.3, 0.0)), Regression.MEAN_ALONG),
        (throws(3, 12, mean_m=(0.0, -0.3)), Regression.MEAN_ACROSS),
        ([None] * 12, Regression.FAILED),
    ],
)
def test_each_way_of_being_worse_is_found_and_named(since, regression):
    found = judge(throws(0, 100), since)
    assert (found.verdict, found.regression) == ("worse", regression)
    assert found.p_ratio < 1e-3


@each(
    ("since", "regression"),
    [
        (throws(1, 12, ratio=12.0), Regression.GATE_SPREAD_ALONG),
        (throws(2, 12, mean_m=(0.3, 0.0)), Regression.GATE_MEAN_ALONG),
    ],
)
def test_without_throws_of_before_the_gates_still_judge(since, regression):
    found = judge([], since)
    assert (found.verdict, found.regression) == ("worse", regression)


def test_a_mean_that_comes_closer_to_the_target_is_no_regression():
    found = judge(throws(0, 100, mean_m=(0.07, 0.0)), throws(1, 12))
    assert found.verdict == "passed"


def test_few_throws_leave_it_open():
    assert judge(throws(0, 100), throws(1, 11)).verdict == "testing"
    assert judge(throws(0, 100), []).throw_count == 0


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.floats(0.3, 1.5), st.sampled_from([1.0, 4.0]))
def test_the_expected_spread_at_a_target_changes_nothing_but_the_gates(seed, scale, ratio):
    before, since = throws(seed, 60), throws(seed + 1, 12, ratio)
    far_before, far = throws(seed, 60, scale=scale), throws(seed + 1, 12, ratio, scale=scale)
    near, other = judge(before, since), judge(far_before, far)
    if Regression.SPREAD in (near.regression, other.regression):
        assert near.verdict == other.verdict == "worse"


def test_equal_throws_rarely_alarm_and_doubled_ones_mostly():
    """Of 300 machines of rollouts of twenty each; the rates themselves stand in benchmarks/rollout.py."""
    equal = [judge(throws([1, n], 100), throws([2, n], 12)).verdict for n in range(300)]
    wide = [judge(throws([1, n], 300), throws([3, n], 12, 2.0)).verdict for n in range(100)]
    assert equal.count("worse") <= 2
    assert wide.count("worse") >= 80
