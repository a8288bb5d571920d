"""Drives alone against the whole twin: the same joint motion for a fraction of the time."""

import numpy as np
import pytest

from sim_twin.effects.effect import Effect
from sim_twin.replay.drives import replay_drives
from sim_twin.replay.replay import ReplayElement, replay
from tests.sim_twin.twin_throw import CALIBRATION, PROFILE, TICKS, Recorded, record

LAG = Effect(effect="valve_lag", joint="boom", parameters={"extra_lag_s": 0.1})
GAP = Effect(effect="backlash", joint="telescope", parameters={"gap_rad_m": 0.02})
STUCK = Effect(effect="stiction", joint="dipper", parameters={"breakaway_rad_m_per_s": 0.1})
BIAS = Effect(effect="joint_sensor_bias", joint="boom", parameters={"bias_rad_m": 0.05})
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
