"""Drives alone against the whole twin: the same joint motion for a fraction of the time."""

import numpy as np
import pytest

from machine.spec import load_spec
from sim_twin.effects.effect import Effect
from sim_twin.replay.drives import replay_drives
from sim_twin.replay.replay import ReplayElement, replay
from tests.sim_twin.twin_throw import CALIBRATION, PROFILE, TICKS, Recorded, record

LAG = Effect(effect="valve_lag", joint="boom", parameters={"extra_lag_s": 0.1})
GAP = Effect(effect="backlash", joint="telescope", parameters={"gap_rad_m": 0.02})
STUCK = Effect(effect="stiction", joint="dipper", parameters={"breakaway_rad_m_per_s": 0.1})
BIAS = Effect(effect="joint_sensor_bias", joint="boom", parameters={"bias_rad_m": 0.05})
TELESCOPE_BIAS = Effect(
    effect="joint_sensor_bias", joint="telescope", parameters={"bias_rad_m": -0.06}
)
SLOW = Effect(
    effect="valve_gain",
    joint="dipper",
    parameters={"positive_ratio": -0.3, "negative_ratio": -0.3},
)
LATE = Effect(effect="joint_sensor_latency", joint="boom", parameters={"extra_latency_s": 0.05})


@pytest.fixture(scope="module")
def plain() -> Recorded:
    return record()


def test_drives_move_as_in_the_whole_twin(plain: Recorded) -> None:
    elements = [ReplayElement(0, effects) for effects in ((), (LAG,), (GAP, STUCK), (BIAS,))]
    whole = replay([plain.replay_input], elements, PROFILE, CALIBRATION)
    alone = replay_drives([plain.replay_input], elements, PROFILE, CALIBRATION)
    assert alone.shape == (4, TICKS, 4)
    np.testing.assert_allclose(alone, whole.joint_velocity_rad_m_per_s, atol=1e-3)
    assert np.abs(alone[1] - alone[0]).max() > 0.02, "an effect must act"


def test_velocities_are_true_ones_whatever_the_sensor_s_latency(plain: Recorded) -> None:
    elements = [ReplayElement(0), ReplayElement(0, (LATE,))]
    alone = replay_drives([plain.replay_input], elements, PROFILE, CALIBRATION)
    np.testing.assert_array_equal(alone[1], alone[0])


def test_a_healthy_machine_s_own_recording_changes_nothing(plain: Recorded) -> None:
    one, element = [plain.replay_input], [ReplayElement(0)]
    np.testing.assert_allclose(
        replay_drives(one, element, PROFILE, CALIBRATION, as_measured=True),
        replay_drives(one, element, PROFILE, CALIBRATION),
        atol=1e-4,
    )


def test_levers_are_where_the_recorded_joint_was(plain: Recorded) -> None:
    """What an effect does to a speed now does not depend on what it did to the way so far."""
    elements = [ReplayElement(0), ReplayElement(0, (SLOW,))]
    fast, slow = replay_drives(
        [plain.replay_input], elements, PROFILE, CALIBRATION, as_measured=True
    )[:, :, 2]
    assert np.abs(fast).max() > 0.2
    np.testing.assert_allclose(slow, 0.7 * fast, atol=1e-12)
    own = replay_drives([plain.replay_input], elements, PROFILE, CALIBRATION)[:, :, 2]
    assert np.abs(own[1] - 0.7 * own[0]).max() > 1e-3


def test_end_stops_are_where_the_recorded_joint_meets_them(plain: Recorded) -> None:
    start = plain.replay_input.position_rad_m.copy()
    ticks = 900
    valve = np.zeros((ticks, 4))
    valve[:, 3] = 0.8
    held = plain.replay_input._replace(
        valve_ratio=valve,
        gripper_open=np.zeros(ticks, dtype=np.bool_),
        position_rad_m=np.repeat(start[:1], ticks, axis=0),
        velocity_rad_m_per_s=np.zeros((ticks, 4)),
    )
    element = [ReplayElement(0)]
    own = replay_drives([held], element, PROFILE, CALIBRATION)[0, :, 3]
    seen = replay_drives([held], element, PROFILE, CALIBRATION, as_measured=True)[0, :, 3]
    assert own[-1] == 0.0, "its own motion has taken it to the stop"
    assert seen[-1] > 0.2
    near = held.position_rad_m.copy()
    near[:, 3] = load_spec().position_range_rad_m[1][3] - 0.04
    close = [held._replace(position_rad_m=near)]
    biased = [ReplayElement(0), ReplayElement(0, (TELESCOPE_BIAS,))]
    out = replay_drives(close, biased, PROFILE, CALIBRATION, as_measured=True)[:, -1, 3]
    assert out[0] > 0.2
    assert out[1] == 0.0, "the sensor reads short of the stop that the joint is at"


def test_a_joint_that_sticks_rests_where_the_recorded_one_did(plain: Recorded) -> None:
    stuck = record((STUCK,))
    one, element = [stuck.replay_input], [ReplayElement(0, (STUCK,))]
    seen = replay_drives(one, element, PROFILE, CALIBRATION, as_measured=True)[0, :, 2]
    true = replay_drives(one, element, PROFILE, CALIBRATION)[0, :, 2]
    assert (true == 0.0).any() and (true != 0.0).any()
    assert ((seen == 0.0) != (true == 0.0)).sum() <= 4, "smoothing moves a stop by a tick or two"


def test_a_longer_throw_that_no_element_asks_for_is_left_alone(plain: Recorded) -> None:
    given = plain.replay_input
    rows = ("valve_ratio", "gripper_open", "position_rad_m", "velocity_rad_m_per_s")
    short = given._replace(**{name: getattr(given, name)[:100] for name in rows})
    both = replay_drives([given, short], [ReplayElement(1)], PROFILE, CALIBRATION, as_measured=True)
    alone = replay_drives([short], [ReplayElement(0)], PROFILE, CALIBRATION, as_measured=True)
    np.testing.assert_array_equal(both, alone)
