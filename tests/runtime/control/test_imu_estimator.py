import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from machine.calibration import nominal_calibration
from machine.conventions import CONTROL_PERIOD_NS, Mode, Motion
from machine.spec import MJCF_PATH, load_spec
from machine.starts import sample_starts
from runtime.control import control_loop, imu_estimator
from runtime.control.arm_motion import ArmMotion
from runtime.control.control_loop import ControlInputs, ControlParams
from runtime.control.imu_estimator import ImuState
from sim_twin.twin.twin import Twin
from tests.cases import each
from tests.runtime.samples import NOW_NS, at_rest

SPEC = load_spec()


def feed(state, sample, now_ns):
    arm = ArmMotion.of(SPEC, sample)
    return imu_estimator.update(SPEC, state, sample, arm.velocity_rad_m_per_s, arm.radius_m, now_ns)


def test_the_imu_sits_where_the_model_says():
    tree = ElementTree.parse(MJCF_PATH)
    (site,) = [s for s in tree.iter("site") if s.get("name") == "imu"]
    assert [float(v) for v in site.get("pos").split()] == list(imu_estimator.IMU_POSITION_M)


def test_the_pendulum_of_the_facts():
    pitch, roll = imu_estimator.swing_frequency_rad_per_s(SPEC)
    assert 2.0 * np.pi / pitch == pytest.approx(1.92, abs=0.01)
    assert 2.0 * np.pi / roll == pytest.approx(1.80, abs=0.01)


def test_before_the_first_sample_the_gripper_hangs():
    sample = at_rest(2, imu_t_mono_ns=np.zeros(2, dtype=np.int64))
    _, estimate = feed(imu_estimator.initial_imu(sample), sample, NOW_NS)
    assert np.array_equal(estimate.swing_rad, np.zeros(2))
    assert np.isinf(estimate.age_s).all()


class LateImu:
    """Delivers a twin's IMU samples late, with a bias, some never."""

    def __init__(self, count, latency_ticks=1, bias=0.0, loss=0.0):
        self.rng = np.random.default_rng(8)
        self.latency, self.bias, self.loss = latency_ticks, bias, loss
        self.waiting, self.newest = [], None
        self.count = count

    def __call__(self, sample):
        self.waiting.append(
            (sample.imu_t_mono_ns, sample.imu_gyro_rad_per_s + self.bias, sample.imu_accel_m_per_s2)
        )
        if len(self.waiting) > self.latency:
            arrived = self.waiting.pop(0)
            if self.newest is None or self.rng.random() >= self.loss:
                self.newest = arrived
        if self.newest is None:
            return replace(sample, imu_t_mono_ns=np.zeros(self.count, dtype=np.int64))
        t_ns, gyro, accel = self.newest
        return replace(
            sample, imu_t_mono_ns=t_ns, imu_gyro_rad_per_s=gyro, imu_accel_m_per_s2=accel
        )


class Wandering:
    """A stand-in for a policy: smooth random velocities, never a release."""

    action_scale_rad_m_per_s = np.array([0.6, 0.35, 0.5, 0.35])
    is_paced = False

    is_late = False
    card = SimpleNamespace(mode=Mode.SPATIAL, policy_id="wandering", policy_sha256="0" * 64)

    def __init__(self, count):
        self.rng = np.random.default_rng(3)
        self.level = np.zeros((count, 4))

    def infer(self, observation):
        self.level = np.clip(self.level + self.rng.normal(0, 0.35, self.level.shape), -1, 1)
        return np.concatenate([self.level, -np.ones((len(observation), 1))], axis=1)


def errors(count=12, rest=60, throw=150, **imu):
    """Errors of angle and rate (T, N, 2) while the arm wanders about; and the twin's final bias."""
    plant = Twin.for_plant(count=count, unit_seed=0)
    target = np.tile([9.0, 0.0, 0.0], (count, 1))
    starts = sample_starts(SPEC, Mode.SPATIAL, target, np.random.default_rng(1))
    starts[:, 1:4] = 0.5 * starts[:, 1:4] + 0.5 * np.array([0.6, 0.0, 0.8])
    starts[:, 4] = -(starts[:, 1] + starts[:, 2])
    plant.reset(starts, 2)
    params = ControlParams(SPEC, nominal_calibration(SPEC), Mode.SPATIAL, Wandering(count))
    late = LateImu(count, **imu)
    sample = late(plant.read())
    state = control_loop.initial_state(params, sample, target, plant.now_ns())
    found = []
    for tick in range(rest + throw):
        motion = np.full(count, int(Motion.THROW if tick >= rest else Motion.HOLD))
        now_ns = plant.now_ns()
        state, out = control_loop.step(params, state, ControlInputs(sample, motion, target), now_ns)
        if tick >= rest:
            q, v = plant.joint_position_rad_m, plant.joint_velocity_rad_m_per_s
            swing = q[:, 1] + q[:, 2] + q[:, 4], v[:, 1] + v[:, 2] + v[:, 4]
            row_q, row_v = out.row["joint_position_rad_m"], out.row["joint_velocity_rad_m_per_s"]
            seen = (
                out.row["joint_position_rad_m"][:, 4]
                + out.row["sensor_position_rad_m"][:, 1]
                + out.row["sensor_position_rad_m"][:, 2]
            )
            seen_rate = (
                out.row["joint_velocity_rad_m_per_s"][:, 4]
                + out.row["sensor_velocity_rad_m_per_s"][:, 1]
                + out.row["sensor_velocity_rad_m_per_s"][:, 2]
            )
            found.append(
                [
                    [seen - swing[0], row_q[:, 5] - q[:, 5]],
                    [seen_rate - swing[1], row_v[:, 5] - v[:, 5]],
                ]
            )
        plant.write(out.command)
        plant.advance(now_ns + CONTROL_PERIOD_NS)
        sample = late(plant.read())
    assert np.ptp(q[:, 4] + q[:, 1] + q[:, 2]) > 0.1, "nothing swings"
    return np.array(found), state


def rms(values, what):
    return np.sqrt((values[:, what] ** 2).mean())


def test_angles_and_rates_of_a_swinging_gripper():
    found, _ = errors(latency_ticks=1)
    assert rms(found, 0) < 0.010
    assert rms(found, 1) < 0.020


def test_a_gyro_bias_is_learned_at_rest():
    bias = np.array([0.015, -0.012, 0.01])
    found, state = errors(rest=120, latency_ticks=1, bias=bias)
    assert np.allclose(state.imu.gyro_bias_rad_per_s.T, bias, atol=2e-3)
    assert rms(found, 0) < 0.012
    assert rms(found, 1) < 0.022


def test_lost_samples_cost_little():
    found, _ = errors(latency_ticks=1, loss=0.3)
    assert rms(found, 0) < 0.012
    assert rms(found, 1) < 0.06


def swinging(t_s, amplitude=0.2):
    """A free pitch swing about a standing arm: angle, rate, gyro, accelerometer at the IMU."""
    w = imu_estimator.swing_frequency_rad_per_s(SPEC)[0]
    angle, rate = amplitude * np.cos(w * t_s), -amplitude * w * np.sin(w * t_s)
    acceleration = -w * w * angle
    x, _, z = imu_estimator.IMU_POSITION_M
    below = z - SPEC.geometry.pitch_to_roll_m
    # In the gripper: gravity turned by the swing, plus angular and centripetal acceleration at the IMU.
    accel = [
        9.81 * np.sin(angle) - acceleration * below - rate**2 * x,
        0.0,
        9.81 * np.cos(angle) + acceleration * x - rate**2 * below,
    ]
    return angle, rate, [0.0, -rate, 0.0], accel


def run_swing(ticks, change=lambda sample, tick: sample, amplitude=0.2, error_rad=0.0):
    """Follow a free swing from its turning point on, the angle there known up to an error."""
    state = imu_estimator.initial_imu(at_rest(1))._replace(
        t_ns=np.array([NOW_NS - 30_000_000]),
        angle_rad=np.array([[amplitude + error_rad], [0.0]]),
    )
    for tick in range(ticks):
        now_ns = NOW_NS + tick * CONTROL_PERIOD_NS
        t_imu_ns = now_ns - 20_000_000
        _, _, gyro, accel = swinging((t_imu_ns - NOW_NS) * 1e-9, amplitude)
        sample = at_rest(
            1,
            now_ns,
            imu_t_mono_ns=np.array([t_imu_ns]),
            imu_gyro_rad_per_s=np.array([gyro]),
            imu_accel_m_per_s2=np.array([accel]),
        )
        state, estimate = feed(state, change(sample, tick), now_ns)
    angle, rate, _, _ = swinging((now_ns - NOW_NS) * 1e-9, amplitude)
    return estimate, angle, rate, state


def test_a_free_swing_is_followed_in_phase():
    estimate, angle, rate, _ = run_swing(400)
    assert estimate.swing_rad[0] == pytest.approx(angle, abs=0.02)
    assert estimate.swing_rate_rad_per_s[0] == pytest.approx(rate, abs=0.01)
    assert estimate.roll_rad[0] == pytest.approx(0.0, abs=1e-6)
    assert estimate.age_s[0] == pytest.approx(0.02)


def test_the_specific_force_corrects_a_wrong_angle_while_swinging():
    """Naive tilt would read next to nothing on a pendulum; the pin's specific force reads the truth."""
    early, late = (run_swing(ticks, error_rad=0.06) for ticks in (20, 1800))
    assert early[0].swing_rad[0] - early[1] == pytest.approx(0.06, abs=0.01)
    assert late[0].swing_rad[0] - late[1] == pytest.approx(0.0, abs=0.012)


@each("what", ["repeat", "nan", "future"])
def test_samples_that_are_no_news_are_passed_over(what):
    frozen = {}

    def change(sample, tick):
        if tick < 60:
            frozen["last"] = sample
            return sample
        if what == "repeat":
            return replace(
                sample,
                imu_t_mono_ns=frozen["last"].imu_t_mono_ns,
                imu_gyro_rad_per_s=frozen["last"].imu_gyro_rad_per_s,
                imu_accel_m_per_s2=frozen["last"].imu_accel_m_per_s2,
            )
        if what == "nan":
            return replace(sample, imu_gyro_rad_per_s=np.full((1, 3), np.nan))
        return replace(sample, imu_t_mono_ns=sample.imu_t_mono_ns + 1_000_000_000)

    estimate, angle, rate, _ = run_swing(70, change)
    assert estimate.age_s[0] == pytest.approx(0.12)
    # The free pendulum goes on by itself.
    assert estimate.swing_rad[0] == pytest.approx(angle, abs=0.04)
    assert estimate.swing_rate_rad_per_s[0] == pytest.approx(rate, abs=0.08)


def test_after_a_long_gap_the_rates_start_afresh():
    gap = range(60, 120)

    def change(sample, tick):
        return replace(sample, imu_t_mono_ns=np.zeros(1, dtype=np.int64)) if tick in gap else sample

    estimate, _, rate, state = run_swing(122, change)
    assert estimate.swing_rate_rad_per_s[0] == pytest.approx(rate, abs=0.05)
    assert np.isfinite(state.angle_rad).all()


def test_a_tilted_accelerometer_does_not_tilt_a_hanging_gripper():
    tilt = 0.015
    accel = np.array([[9.81 * np.sin(tilt), 0.0, 9.81 * np.cos(tilt)]])
    sample = at_rest(1, imu_accel_m_per_s2=accel)
    state = imu_estimator.initial_imu(sample)
    for tick in range(400):
        now_ns = NOW_NS + tick * CONTROL_PERIOD_NS
        sample = replace(sample, t_mono_ns=now_ns, imu_t_mono_ns=np.array([now_ns - 20_000_000]))
        state, estimate = feed(state, sample, now_ns)
    assert abs(estimate.swing_rad[0]) < 1e-3
    assert state.tilt_offset_rad[0, 0] == pytest.approx(tilt, abs=1e-3)
    assert isinstance(state, ImuState)


def test_a_gripper_held_off_plumb_by_a_rope_is_seen():
    accel = np.array([[9.81 * np.sin(0.2), 0.0, 9.81 * np.cos(0.2)]])
    sample = at_rest(1, imu_accel_m_per_s2=accel)
    _, estimate = feed(imu_estimator.initial_imu(sample), sample, NOW_NS)
    assert estimate.swing_rad[0] == pytest.approx(
        0.2 - imu_estimator.START_ANGLE_ZONE_RAD, abs=1e-3
    )


def test_roll_comes_from_the_other_axes():
    sample = at_rest(1)
    state = imu_estimator.initial_imu(sample)
    for tick in range(30):
        now_ns = NOW_NS + tick * CONTROL_PERIOD_NS
        sample = at_rest(
            1,
            now_ns,
            imu_t_mono_ns=np.array([now_ns]),
            imu_gyro_rad_per_s=np.array([[0.0 if tick == 0 else 0.5, 0.0, 0.0]]),
        )
        state, estimate = feed(state, sample, now_ns)
    assert estimate.roll_rate_rad_per_s[0] == pytest.approx(0.5, abs=1e-6)
    assert estimate.roll_rad[0] == pytest.approx(0.5 * 0.285, abs=0.01)
    assert abs(estimate.swing_rad[0]) < 0.01
