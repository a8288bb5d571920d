"""Registration: aiming by the mean miss hits, over range, height and turn; old files are read as before."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from machine.calibration import nominal_calibration
from machine.kinematics import to_throw_frame
from machine.registration import MAX_CORRECTION_M, Registration, Term, TermKind
from machine.spec import load_spec
from tests.cases import each

RANGES_M = tuple(np.arange(5.5, 12.01, 0.25).tolist())


def table(value_m):
    return tuple(value_m + 0.05 * np.sin(np.asarray(RANGES_M)))


FULL = Registration(
    policy_sha256="sha",
    throw_count=240,
    range_m=RANGES_M,
    downrange_m=table(-0.15),
    crossrange_m=table(0.04),
    range_per_height_ratio=0.4,
    terms=(
        Term(kind=TermKind.NEAR, downrange_m=table(0.03), crossrange_m=table(0.08)),
        Term(kind=TermKind.TURN, downrange_m=table(0.0), crossrange_m=table(-0.1)),
        Term(kind=TermKind.HEIGHT, downrange_m=table(-0.1), crossrange_m=table(0.02)),
        Term(kind=TermKind.HEIGHT_SQUARED, downrange_m=table(0.05), crossrange_m=table(0.0)),
    ),
)
OLD = {
    "policy_sha256": "sha",
    "throw_count": 160,
    "range_m": [8.0, 9.0, 10.0],
    "downrange_m": [-0.1, -0.2, -0.1],
    "crossrange_m": [0.0, 0.05, 0.0],
}
"""A registration as files held it before heights and turns were registered."""


def landing(aim_m, turn_rad):
    """Where a machine that misses by `FULL` throws to when it aims at points (N, 3), turning first."""
    range_m = np.hypot(aim_m[:, 0], aim_m[:, 1])
    forward = aim_m[:, :2] / range_m[:, None]
    down, cross = FULL.miss(range_m, aim_m[:, 2], np.atleast_1d(turn_rad))
    return aim_m[:, :2] + down[:, None] * forward + cross[:, None] * forward[:, ::-1] * (-1.0, 1.0)


@given(
    range_m=st.floats(6.5, 10.3),
    azimuth_rad=st.floats(-3.1, 3.1),
    height_m=st.floats(-1.0, 3.0),
    turn_rad=st.floats(-3.0, 3.0),
)
def test_aiming_by_the_mean_miss_hits(range_m, azimuth_rad, height_m, turn_rad):
    target = np.array([[range_m * np.cos(azimuth_rad), range_m * np.sin(azimuth_rad), height_m]])
    aim = FULL.aim(target, np.array([azimuth_rad - turn_rad]))
    left = to_throw_frame(np.column_stack([landing(aim, turn_rad), [height_m]]), target)[0]
    assert abs(left[0] - range_m) < 0.03
    assert abs(left[1]) < 0.02
    assert aim[0, 2] == height_m


def test_whole_turns_of_the_cabin_do_not_matter():
    target = np.array([[9.0, 1.0, 0.0]])
    once = FULL.aim(target, np.array([0.4]))
    assert np.allclose(FULL.aim(target, np.array([0.4 + 4.0 * np.pi])), once)


def test_a_file_from_before_is_read_and_aims_by_range_alone():
    old = Registration.model_validate(OLD)
    low, high = np.array([[9.0, 0.0, 0.0]]), np.array([[9.0, 0.0, 2.5]])
    moved = old.aim(low, np.zeros(1)) - low
    assert moved[0, 0] == pytest.approx(0.18, abs=0.02)
    assert np.array_equal(old.aim(high, np.array([2.0])) - high, moved)


def test_without_throws_at_a_range_the_ends_of_the_table_hold():
    target = np.array([[3.0, 0.0, 0.0], [20.0, 0.0, 0.0]])
    moved = Registration.model_validate(OLD).aim(target, np.zeros(2)) - target
    assert np.abs(moved).max() < 0.15


def test_no_aim_is_moved_by_more_than_the_limit():
    term = Term(kind=TermKind.HEIGHT, downrange_m=(-0.5, -0.5), crossrange_m=(0.0, 0.0))
    far = Registration(
        policy_sha256="sha",
        throw_count=1,
        range_m=(6.0, 10.0),
        downrange_m=(-0.5, -0.5),
        crossrange_m=(0.0, 0.0),
        terms=(term,),
    )
    target = np.array([[8.0, 0.0, 3.0]])
    assert far.aim(target, np.zeros(1))[0, 0] == pytest.approx(8.0 + MAX_CORRECTION_M)


@each("ranges", [(9.0, 8.0), (8.0,), (8.0, 8.0)])
def test_a_table_out_of_order_is_refused(ranges):
    with pytest.raises(ValidationError):
        Registration.model_validate(
            {**OLD, "range_m": ranges, "downrange_m": (0.1, 0.1), "crossrange_m": (0.0, 0.0)}
        )


def test_a_table_beyond_the_limit_a_short_term_and_a_term_twice_are_refused():
    term = {"kind": "turn", "downrange_m": [0.0] * 3, "crossrange_m": [0.0] * 3}
    for change, words in (
        ({"downrange_m": [-0.7, 0.0, 0.0]}, r"0\.70 m is more than the 0\.6 m"),
        ({"terms": [{**term, "downrange_m": [0.0]}]}, "as many misses as ranges"),
        ({"terms": [term, term]}, "each of its terms once"),
    ):
        with pytest.raises(ValidationError, match=words):
            Registration.model_validate({**OLD, **change})


def test_only_the_policy_that_threw_is_corrected():
    plain = nominal_calibration(load_spec())
    calibration = plain.model_copy(update={"registrations": (FULL,)})
    target = np.array([[9.0, 0.0, 0.0]])
    assert calibration.aim("sha", target, np.zeros(1))[0, 0] > 9.05
    assert np.array_equal(calibration.aim("another", target, np.zeros(1)), target)
    assert calibration.without_registrations() == plain


def test_the_twin_aims_by_its_own_registration_or_not_at_all():
    plain = nominal_calibration(load_spec())
    machine = plain.model_copy(update={"registrations": (FULL,)})
    assert machine.for_twin() == plain
    own = Registration.model_validate(OLD)
    both = machine.model_copy(update={"twin_registrations": (own,)})
    assert both.for_twin() == plain.model_copy(update={"registrations": (own,)})
