"""A swing measured by an IMU that is mounted askew, and the hypothesis that it is."""

import numpy as np

from machine.conventions import CONTROL_PERIOD_S
from runtime.control.imu_estimator import start_angle
from sim_twin.effects.effect import Effect
from sim_twin.replay.replay import ReplayElement, ReplayInput, replay
from sim_twin.replay.turned_imu import swing_from_gyro
from tests.cases import each
from tests.sim_twin.twin_throw import CALIBRATION, PROFILE, Recorded, record

ALL = (True, True, True, True)
ASKEW = Effect(
    effect="imu_misalignment", parameters={"roll_rad": -0.09, "pitch_rad": 0.12, "yaw_rad": 0.1}
)


def as_measured(recorded: Recorded) -> ReplayInput:
    """The throw as a machine knows it that has nothing but this IMU for its swing."""
    given = recorded.replay_input
    force = recorded.accel[0]
    angle, rate = swing_from_gyro(
        recorded.gyro[:, None], given.velocity_rad_m_per_s[:, :1], start_angle(force)[None]
    )
    swing, swing_rate = angle[:, 0], rate[:, 0]
    swing[:, 0] -= given.position_rad_m[:, 1:3].sum(axis=1)
    swing_rate[:, 0] -= given.velocity_rad_m_per_s[:, 1:3].sum(axis=1)
    return given._replace(
        swing_rad=swing,
        swing_rate_rad_per_s=swing_rate,
        swing_start_rad=swing[0],
        gyro_rad_per_s=recorded.gyro,
        start_force_m_per_s2=force,
    )


def test_the_gyro_of_a_level_imu_gives_the_swing():
    recorded = record()
    given, seen = recorded.replay_input, as_measured(recorded)
    assert given.swing_rad is not None and seen.swing_rad is not None
    # The twin moves a joint in a tick by its speed at the tick's end; half a tick of that is between them.
    moved = CONTROL_PERIOD_S * np.abs(given.swing_rate_rad_per_s).max()
    np.testing.assert_allclose(seen.swing_rad, given.swing_rad, atol=moved, rtol=0.0)
    np.testing.assert_allclose(
        seen.swing_rate_rad_per_s, given.swing_rate_rad_per_s, atol=5e-3, rtol=0.0
    )


@each("swing_is_measured", [False, True])
def test_the_true_mounting_explains_what_a_turned_imu_saw(swing_is_measured: bool):
    recorded = record([ASKEW])
    elements = [
        ReplayElement(0, effects, ALL, swing_is_measured, swing_is_measured)
        for effects in ((ASKEW,), ())
    ]
    out = replay([as_measured(recorded)], elements, PROFILE, CALIBRATION)
    truth = recorded.twin.payload.impact_m[0]
    assert np.linalg.norm(out.impact_m[0] - truth) < 0.04
    assert np.linalg.norm(out.impact_m[1] - truth) > 0.1, "without the effect it is not explained"


def test_a_start_that_the_machine_knew_otherwise_is_kept():
    """A gripper that hung at rest is known to hang plumb, whatever its IMU feels."""
    recorded = record([ASKEW])
    known = recorded.replay_input._replace(gyro_rad_per_s=recorded.gyro)
    out = replay([known], [ReplayElement(0, (ASKEW,), ALL)], PROFILE, CALIBRATION)
    np.testing.assert_allclose(
        out.passive_position_rad[0, 0], recorded.replay_input.swing_start_rad
    )
    np.testing.assert_allclose(out.impact_m[0], recorded.twin.payload.impact_m[0], atol=0.01)


def test_a_small_tilt_at_the_start_is_taken_for_plumb():
    force = 9.81 * np.array([[0.02, -0.02, 1.0], [0.1, 0.0, 1.0]])
    found = start_angle(force.T)
    np.testing.assert_array_equal(found[:, 0], 0.0)
    np.testing.assert_allclose(found[:, 1], [np.arctan(0.1) - 0.03, 0.0])
