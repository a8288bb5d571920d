"""After the release the arm leads the back swing away from itself, and only then."""

import numpy as np

from machine.kinematics import pin_in_plane
from machine.spec import load_spec
from runtime.control.follow_through import (
    FOLD_RAD_PER_S,
    LARGE_SWING_RAD,
    LASTS_S,
    OUTWARD_M_PER_S,
    PIN_HEIGHT_M,
    follow_through,
)
from tests.cases import each

SPEC = load_spec()
LEVEL_TUBE = np.array([[0.0, 0.55, 0.90, 0.8]])
STANDING_TUBE = np.array([[0.0, 0.80, 0.00, 0.0]])


def motion(active, *, ahead, amplitude=0.8, time_s=0.5):
    return follow_through(
        SPEC, np.array([time_s]), active, np.array([ahead]), np.array([amplitude])
    )


def test_the_pin_follows_the_swing_out_and_folds_on_its_way_back():
    out = motion(LEVEL_TUBE, ahead=0.4).request_rad_m_per_s[0]
    assert out[2] == 0.0
    assert out[3] == OUTWARD_M_PER_S
    back = motion(LEVEL_TUBE, ahead=-0.4).request_rad_m_per_s[0]
    assert back[2] == -FOLD_RAD_PER_S
    assert back[3] == 0.0


def test_a_standing_tube_does_not_fold():
    assert motion(STANDING_TUBE, ahead=-0.4).request_rad_m_per_s[0, 2] == 0.0


def test_a_low_pin_is_lifted_and_a_high_one_is_not():
    low = np.array([[0.0, 0.30, 0.50, 0.8]])
    assert pin_in_plane(SPEC, low)[0, 1] < PIN_HEIGHT_M < pin_in_plane(SPEC, LEVEL_TUBE)[0, 1]
    assert motion(low, ahead=0.4).request_rad_m_per_s[0, 1] > 0.0
    assert motion(LEVEL_TUBE, ahead=0.4).request_rad_m_per_s[0, 1] == 0.0


@each(
    ("amplitude", "time_s", "runs"),
    [
        (LARGE_SWING_RAD + 0.01, LASTS_S - 0.01, True),
        (LARGE_SWING_RAD - 0.01, LASTS_S - 0.01, False),
        (LARGE_SWING_RAD + 0.01, LASTS_S + 0.01, False),
    ],
)
def test_it_ends_with_the_large_swing_or_the_time(amplitude, time_s, runs):
    assert motion(LEVEL_TUBE, ahead=0.4, amplitude=amplitude, time_s=time_s).runs[0] == runs


def test_the_slew_is_left_alone():
    for ahead in (-0.5, 0.5):
        assert motion(LEVEL_TUBE, ahead=ahead).request_rad_m_per_s[0, 0] == 0.0
