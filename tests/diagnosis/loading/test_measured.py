"""The initial swing of a throw."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from diagnosis.loading.measured import CALM_S, hung_at_rest, measured_motion
from diagnosis.loading.throw_data import ThrowData
from machine.conventions import ACTIVE_COUNT
from tests.cases import each
from tests.diagnosis.loading.test_throw_csv import both, make_log, throw_csv

PROMPT = np.zeros(ACTIVE_COUNT)
"""No lag of the velocity sensors."""


@pytest.fixture
def throw(tmp_path: Path) -> ThrowData:
    _, loaded = both(tmp_path, throw_csv(make_log()))
    return loaded.throws[0]


def began_at(throw: ThrowData, swing_rad: float, tilt_rad: float) -> ThrowData:
    """The machine's estimate begins at a swing, its IMU at rest feels another tilt."""
    estimate = throw.joint_position_rad_m.copy()
    rows = throw.t_s >= -1e-9
    estimate[rows, ACTIVE_COUNT] = swing_rad - estimate[rows, 1] - estimate[rows, 2]
    estimate[rows, ACTIVE_COUNT + 1] = 0.0
    gyro, accel = throw.gyro_rad_per_s.copy(), throw.accel_m_per_s2.copy()
    early = throw.imu_t_s <= 0.1
    gyro[early] *= 0.01
    accel[early] = 9.81 * np.array([np.sin(tilt_rad), 0.0, np.cos(tilt_rad)])
    return replace(throw, joint_position_rad_m=estimate, gyro_rad_per_s=gyro, accel_m_per_s2=accel)


def test_a_start_from_the_specific_force_shares_its_error(throw: ThrowData):
    found = measured_motion(began_at(throw, swing_rad=0.07, tilt_rad=0.1), PROMPT)
    assert found.start_force_m_per_s2 is not None
    np.testing.assert_allclose(
        found.start_force_m_per_s2, 9.81 * np.array([np.sin(0.1), 0.0, np.cos(0.1)])
    )
    knew = measured_motion(began_at(throw, swing_rad=0.0, tilt_rad=0.1), PROMPT)
    assert knew.start_force_m_per_s2 is None


def test_a_gripper_that_moves_at_the_start_gives_no_bias_and_no_tilt(throw: ThrowData):
    moving = began_at(throw, swing_rad=0.07, tilt_rad=0.1)
    moving = replace(moving, gyro_rad_per_s=moving.gyro_rad_per_s + 0.5)
    motion = measured_motion(moving, PROMPT)
    assert motion.start_force_m_per_s2 is None
    assert motion.gyro_rad_per_s is not None
    assert motion.gyro_rad_per_s[0].min() > 0.4


@each(
    ("before_s", "rate_rad_per_s", "hung"),
    [(0.2, 0.0, True), (0.2, 0.06, False), (0.05, 0.0, True), (0.0, 0.0, True), (0.0, 0.06, False)],
)
def test_a_calm_gripper_hung_at_rest(
    throw: ThrowData, before_s: float, rate_rad_per_s: float, hung: bool
):
    at_s = np.arange(-before_s, 0.3, 0.01)
    gyro = np.zeros((at_s.size, 3))
    gyro[:, 1] = rate_rad_per_s * np.sin(np.pi * at_s / CALM_S)
    begun = throw.t_s >= -before_s
    kept = {
        field: getattr(throw, field)[begun]
        for field in ("t_s", "sensor_t_s", "joint_position_rad_m")
    }
    begun_throw = replace(throw, imu_t_s=at_s, gyro_rad_per_s=gyro, **kept)
    assert hung_at_rest([begun_throw] * 3) is hung


def test_most_throws_decide_whether_grippers_hung_at_rest(throw: ThrowData):
    at_s, begun = np.arange(0.0, 0.3, 0.01), throw.t_s >= 0.0
    calm = replace(
        throw, t_s=throw.t_s[begun], imu_t_s=at_s, gyro_rad_per_s=np.zeros((at_s.size, 3))
    )
    placed = replace(calm, gyro_rad_per_s=np.outer(at_s, [0.0, 0.5, 0.0]))
    assert hung_at_rest([calm, placed, calm])
    assert not hung_at_rest([placed, placed, calm])
