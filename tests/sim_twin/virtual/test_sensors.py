import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from machine.spec import load_spec
from sim_twin.virtual.sensors import (
    IMU_LATENCY_S,
    IMU_LOSS_RATIO,
    NEVER_NS,
    POSITION_SD_RAD_M,
    POSITION_STEP_RAD_M,
    SURVEY_SD_M,
    VELOCITY_SD_RAD_M_PER_S,
    BallTracker,
    DelayedSamples,
    GripperImu,
    ImpactSurveyor,
    JointSensors,
)
from sim_twin.virtual.units import make_unit, nominal_unit

SPEC = load_spec()
UNIT = nominal_unit(SPEC)
MS = 1_000_000


@given(
    st.lists(st.tuples(st.integers(1, 40), st.booleans()), min_size=1, max_size=6),
    st.integers(0, 120),
)
def test_readers_get_the_newest_sample_that_has_arrived(sent, now_ms):
    samples = DelayedSamples(1, 1, depth=6)
    expected = 0
    for k, (late_ms, lost) in enumerate(sent):
        time_ms = 10 * (k + 1)
        arrival = NEVER_NS if lost else (time_ms + late_ms) * MS
        samples.push(time_ms * MS, np.array([arrival]), np.array([[float(time_ms)]]))
        if not lost and time_ms + late_ms <= now_ms:
            expected = max(expected, time_ms)
    time_ns, values = samples.newest(now_ms * MS)
    assert time_ns[0] == expected * MS
    assert np.isnan(values[0, 0]) if expected == 0 else values[0, 0] == expected


def test_joint_sensors_have_noise_bias_and_steps():
    unit = make_unit(SPEC, 3)
    sensors, rng = JointSensors(unit, 5000, 0.002), np.random.default_rng(0)
    true = np.tile([0.3, 0.5, -0.2, 0.7], (5000, 1))
    sensors.sample(MS, true, np.full(5000, 3e7), rng)
    error = sensors.position_rad_m - true
    np.testing.assert_allclose(error.mean(0), unit.joint_bias_rad_m, atol=1e-4)
    spread = np.hypot(POSITION_SD_RAD_M, POSITION_STEP_RAD_M / np.sqrt(12.0))
    np.testing.assert_allclose(error.std(0), spread, rtol=0.05)
    counts = sensors.position_rad_m / POSITION_STEP_RAD_M
    np.testing.assert_allclose(counts, np.rint(counts), atol=1e-6)
    np.testing.assert_allclose(
        sensors.velocity_rad_m_per_s.std(0), VELOCITY_SD_RAD_M_PER_S, rtol=0.05
    )
    assert (VELOCITY_SD_RAD_M_PER_S >= 5e-3).all() and (VELOCITY_SD_RAD_M_PER_S <= 10e-3).all()


def test_velocity_lags_by_its_filter():
    sensors, rng = JointSensors(UNIT, 2000, 0.002), np.random.default_rng(0)
    for k in range(200):
        sensors.follow(np.full((2000, 4), 0.002 * k))  # 1 rad/s2
    sensors.sample(0, np.zeros((2000, 4)), np.zeros(2000), rng)
    lag_s = 0.002 * 199 - sensors.velocity_rad_m_per_s.mean(0)
    np.testing.assert_allclose(lag_s, 0.008, atol=0.0015)


def test_imu_latency_loss_noise_and_mounting():
    unit = make_unit(SPEC, 5)
    count = 20_000
    imu, rng = GripperImu(unit, count), np.random.default_rng(0)
    gyro, accel = np.tile([0.1, -0.2, 0.3], (count, 1)), np.tile([0.0, 0.0, 9.81], (count, 1))
    imu.sample(100 * MS, gyro, accel, rng)
    early, _, _ = imu.newest(100 * MS + int(IMU_LATENCY_S[0] * 1e9) - MS)
    assert (early == 0).all()
    time_ns, seen_gyro, seen_accel = imu.newest(100 * MS + int(IMU_LATENCY_S[1] * 1e9))
    lost = time_ns == 0
    assert lost.mean() == pytest.approx(IMU_LOSS_RATIO, rel=0.3)
    assert np.isnan(seen_gyro[lost]).all()
    half, _, _ = imu.newest(100 * MS + 22_500_000)
    assert (half > 0).mean() == pytest.approx(0.5, abs=0.02)
    assert seen_gyro[~lost].std(0) == pytest.approx(6.2e-4, rel=0.05)
    assert seen_accel[~lost].std(0) == pytest.approx(4.2e-3, rel=0.05)
    # Seen from a mounting turned by m, a vector v appears as v - m x v.
    turn = np.asarray(unit.imu_misalignment_rad)
    for seen, true, bias in (
        (seen_gyro, gyro[0], unit.gyro_bias_rad_per_s),
        (seen_accel, accel[0], unit.accel_bias_m_per_s2),
    ):
        expected = true - np.cross(turn, true) + np.asarray(bias)
        np.testing.assert_allclose(seen[~lost].mean(0), expected, atol=3e-4)


def test_tracker_sees_only_visible_loads_and_forgets_on_clear():
    tracker, rng = BallTracker(2), np.random.default_rng(0)
    tracker.sample(20 * MS, np.ones((2, 3)), np.array([True, False]), rng)
    time_ns, ball = tracker.newest(20 * MS + 50 * MS)
    assert time_ns.tolist() == [20 * MS, 0]
    assert np.abs(ball[0] - 1.0).max() < 0.1
    assert np.isnan(ball[1]).all()
    tracker.clear(np.array([True, False]))
    assert tracker.newest(100 * MS)[0].tolist() == [0, 0]


def test_survey_arrives_half_a_second_later_with_two_centimetres():
    survey, rng = ImpactSurveyor(3001), np.random.default_rng(0)
    which = np.arange(3000)
    true = np.tile([9.0, 1.0, 0.25], (3000, 1))
    survey.note(which, np.full(3000, 1000 * MS), true, rng)
    assert (survey.read(1499 * MS)[0] == 0).all()
    time_ns, point, sd = survey.read(1500 * MS)
    assert (time_ns[:3000] == 1000 * MS).all() and time_ns[3000] == 0
    error = point[:3000] - true
    np.testing.assert_allclose(error[:, :2].std(0), SURVEY_SD_M, rtol=0.05)
    np.testing.assert_array_equal(error[:, 2], 0.0)
    assert sd[0] == SURVEY_SD_M and np.isnan(sd[3000]) and np.isnan(point[3000]).all()
