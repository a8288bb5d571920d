import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from server.drift.drift_test import (
    ALLOWANCES,
    REFERENCE_COUNT,
    Change,
    Drift,
    DriftTest,
    Reference,
    ThrowMiss,
    allowance,
)
from tests.cases import each

SD_M = 0.1


def misses(
    rng: np.random.Generator, count: int, along=0.0, across=0.0, ratio=1.0
) -> list[ThrowMiss]:
    """Throws of a spread of 0.1 m, moved and widened; in units of a predicted spread of 0.1 m."""
    scatter = rng.standard_normal((count, 2)) * ratio * SD_M
    return [
        ThrowMiss(
            float(x + along) / SD_M, float(y + across) / SD_M, float(x + along), float(y + across)
        )
        for x, y in scatter
    ]


def first_drift(test: DriftTest, throws: list[ThrowMiss]) -> Drift | None:
    for miss in throws:
        if (found := test.add(miss)) is not None:
            return found
    return None


def healthy(seed: int, count: int = 300) -> tuple[np.random.Generator, DriftTest]:
    """A test after healthy throws; a seed whose throws raise a false alarm is of no use here."""
    rng, test = np.random.default_rng(seed), DriftTest()
    for miss in misses(rng, count):
        test.add(miss)
    assert test.drift is None
    return rng, test


@each(
    ("change", "shift"),
    [
        (Change.LONG, {"along": 0.1}),
        (Change.SHORT, {"along": -0.1}),
        (Change.LEFT, {"across": 0.1}),
        (Change.RIGHT, {"across": -0.1}),
    ],
)
def test_a_bias_is_found_and_named(change: Change, shift: dict[str, float]):
    rng, test = healthy(3)
    found = first_drift(test, misses(rng, 120, **shift))
    assert found is not None
    assert found.change is change
    # The sum may have risen by chance before: the estimate is early rather than late.
    assert 200 < found.change_count < 320
    assert found.alarm_count > found.change_count


def test_a_wider_spread_is_found():
    rng, test = healthy(3)
    found = first_drift(test, misses(rng, 200, ratio=2.0))
    assert found is not None
    assert found.change in (Change.SPREAD_ALONG, Change.SPREAD_ACROSS)


def test_an_alarm_lasts_until_the_machine_throws_as_before():
    rng, test = healthy(3)
    assert first_drift(test, misses(rng, 120, along=0.15)) is not None
    for miss in misses(rng, 200, along=0.15):
        assert test.add(miss) is not None
    after = [test.add(miss) for miss in misses(rng, 200)]
    assert after[0] is not None
    assert after[-1] is None
    # The reference was kept free of the shifted throws: the same change is found again.
    assert first_drift(test, misses(rng, 120, along=0.15)) is not None


def test_nothing_is_claimed_before_there_is_a_reference():
    rng, test = np.random.default_rng(1), DriftTest()
    assert first_drift(test, misses(rng, 5)) is None
    assert first_drift(test, misses(rng, REFERENCE_COUNT - 5, along=5.0)) is None


@settings(max_examples=25)
@given(st.sampled_from(["normal", "student", "lognormal", "steps"]), st.integers(0, 10_000))
def test_scores_do_not_depend_on_the_distribution(kind: str, seed: int):
    """Ranks alone count: any increasing function of the misses leaves every score as it is."""
    rng = np.random.default_rng(seed)
    values = rng.standard_normal(60)
    changed = {
        "normal": values * 3.0 + 1.0,
        "student": np.sinh(2.0 * values),
        "lognormal": np.exp(values),
        "steps": values**3,
    }[kind]
    one, other = Reference(), Reference()
    for value, image in zip(values, changed, strict=True):
        assert one.score(float(value)) == other.score(float(image))
        one.add(float(value))
        other.add(float(image))


def test_equal_values_share_a_middle_score():
    reference = Reference()
    for value in (0.0, 0.0, 0.0):
        reference.add(value)
    assert reference.score(0.0) == 0.0
    assert reference.score(1.0) == -reference.score(-1.0) > 0.0
    reference.remove([0.0, 0.0])
    assert reference.score(1.0) == pytest.approx(0.6745, abs=1e-4)


def test_the_allowance_follows_the_spread():
    rng = np.random.default_rng(2)
    wide = allowance(list(rng.standard_normal(500) * 0.25))
    narrow = allowance(list(rng.standard_normal(500) * 0.05))
    assert (wide, narrow) == (0.1, 0.5)
    assert allowance([0.1, 0.1, 0.1]) == max(ALLOWANCES)


def test_false_alarms_are_as_rare_as_stated():
    """40 000 throws: 20 alarms are expected at 1 in 2 000; 36 or more have a chance below 0.1 %."""
    rng, alarms = np.random.default_rng(7), 0
    for _ in range(20):
        test, was = DriftTest(), False
        for miss in misses(rng, 2000):
            found = test.add(miss) is not None
            alarms += found and not was
            was = found
    assert alarms < 36
