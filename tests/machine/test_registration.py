"""Registration: aiming by the mean miss hits; odd throws move little; faults are not aimed away."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from machine.calibration import nominal_calibration
from machine.kinematics import to_throw_frame
from machine.registration import MAX_CORRECTION_M, Registration, register
from machine.spec import load_spec


def miss(range_m):
    return -0.2 * np.exp(-(((range_m - 9.0) / 0.8) ** 2)), 0.05 * np.ones_like(range_m)


def landing(aim_m):
    """Where a machine with that miss throws to when it aims at points (N, 3)."""
    range_m = np.hypot(aim_m[:, 0], aim_m[:, 1])
    forward = aim_m[:, :2] / range_m[:, None]
    down, cross = miss(range_m)
    return aim_m[:, :2] + down[:, None] * forward + cross[:, None] * forward[:, ::-1] * (-1.0, 1.0)


def registered():
    aimed = np.repeat(np.arange(6.0, 11.0, 0.25), 20)
    return register("sha", aimed, *miss(aimed))


@given(range_m=st.floats(6.5, 10.3), azimuth_rad=st.floats(-3.1, 3.1))
def test_aiming_by_the_mean_miss_hits(range_m, azimuth_rad):
    target = np.array([[range_m * np.cos(azimuth_rad), range_m * np.sin(azimuth_rad), 0.4]])
    aim = registered().aim(target)
    left = to_throw_frame(np.column_stack([landing(aim), [0.0]]), target)[0]
    assert abs(left[0] - range_m) < 0.03
    assert abs(left[1]) < 0.01
    assert aim[0, 2] == 0.4


def test_without_throws_at_a_range_the_ends_of_the_table_hold():
    target = np.array([[3.0, 0.0, 0.0], [20.0, 0.0, 0.0]])
    moved = registered().aim(target) - target
    assert np.abs(moved).max() < 0.1


def test_one_odd_throw_moves_the_aim_by_half_of_its_miss_at_most():
    found = register("sha", np.array([9.0]), np.array([0.3]), np.array([0.0]))
    assert max(found.downrange_m) <= 0.15 + 1e-12


def test_a_miss_too_large_to_aim_away_is_refused_with_its_size():
    aimed = np.full(50, 9.0)
    with pytest.raises(ValidationError, match=rf"0\.9\d m is more than the {MAX_CORRECTION_M} m"):
        register("sha", aimed, np.full(50, -1.0), np.zeros(50))


def test_no_throws_is_no_registration():
    with pytest.raises(ValueError, match="at least one throw"):
        register("sha", np.zeros(0), np.zeros(0), np.zeros(0))


@pytest.mark.parametrize("ranges", [(9.0, 8.0), (8.0,), (8.0, 8.0)])
def test_a_table_out_of_order_is_refused(ranges):
    with pytest.raises(ValidationError):
        Registration(
            policy_sha256="sha",
            throw_count=1,
            range_m=ranges,
            downrange_m=(0.1, 0.1),
            crossrange_m=(0.0, 0.0),
        )


def test_only_the_policy_that_threw_is_corrected():
    plain = nominal_calibration(load_spec())
    calibration = plain.model_copy(update={"registrations": (registered(),)})
    target = np.array([[9.0, 0.0, 0.0]])
    assert calibration.aim("sha", target)[0, 0] > 9.1
    assert np.array_equal(calibration.aim("another", target), target)
    assert calibration.without_registrations() == plain
