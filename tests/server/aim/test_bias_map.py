"""The map of the mean miss: what it finds, what it leaves alone, and what it says that it is worth."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from server.aim.bias_map import Misses, bias_map, correction_at, expected_gain
from tests.cases import each

SD_M = 0.08


def misses(rng: np.random.Generator, count: int, along=0.0, slope=0.0, across=0.0) -> Misses:
    """Throws at 7 to 10 m that miss by this much on average, by more per metre beyond 8.5 m with a slope."""
    range_m = rng.uniform(7.0, 10.0, count)
    zero, sd = np.zeros(count), np.full(count, SD_M)
    noise = rng.standard_normal((2, count)) * SD_M
    return Misses(
        range_m,
        zero,
        along + slope * (range_m - 8.5) + noise[0],
        across + noise[1],
        sd,
        sd,
        zero,
        zero,
    )


@settings(max_examples=20, deadline=None)
@given(
    st.integers(0, 10_000),
    st.floats(0.1, 0.4),
    st.floats(-0.08, 0.08),
    st.sampled_from([-1.0, 1.0]),
)
def test_a_bias_is_at_least_halved_on_other_throws(seed, along, slope, sign):
    rng = np.random.default_rng(seed)
    table = bias_map(misses(rng, 80, sign * along, slope, -sign * along)).registration("", 80)
    test = misses(rng, 2000, sign * along, slope, -sign * along)
    found = correction_at(table, test)
    for miss, correction in zip((test.along_m, test.across_m), found, strict=True):
        assert abs(np.mean(miss - correction)) < 0.5 * abs(np.mean(miss))
        assert abs(np.mean(miss - correction)) < 0.05


@each("seed", range(5))
def test_throws_without_a_bias_are_left_alone(seed):
    found = bias_map(misses(np.random.default_rng(seed), 60))
    assert np.abs(found.along_m).max() < 0.04
    assert np.abs(found.across_m).max() < 0.04


def test_intervals_hold_the_mean_miss_and_shrink_with_throws():
    rng = np.random.default_rng(1)
    few, many = (bias_map(misses(rng, count, along=0.2)) for count in (20, 400))
    for found in (few, many):
        off = np.abs(found.along_m - 0.2) / np.maximum(found.along_sd_m, 1e-6)
        assert np.mean(off < 1.645) > 0.7
    assert many.along_sd_m.mean() < 0.6 * few.along_sd_m.mean()


def test_a_stray_load_is_no_bias():
    rng = np.random.default_rng(2)
    thrown = misses(rng, 60)
    thrown.along_m[7] = 5.0
    assert np.abs(bias_map(thrown).along_m).max() < 0.06


def test_the_gain_is_that_of_throws_which_the_map_has_not_seen():
    rng = np.random.default_rng(3)
    biased = misses(rng, 100, along=0.3)
    gain = expected_gain(biased, None)
    assert gain.low_m > 0.1
    assert gain.after_m == pytest.approx(SD_M * np.sqrt(np.pi / 2), rel=0.25)
    # Against itself in force a correction gains nothing.
    own = bias_map(biased).registration("", 100)
    assert expected_gain(biased, own).low_m < 0.0
    assert expected_gain(misses(rng, 100), None).low_m <= 0.0
