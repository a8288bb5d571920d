"""The checks of the gripper IMU, each at its bound, on a gripper that swings under a turning cabin."""

import numpy as np

from machine.spec import load_spec
from runtime.guard import imu_plausibility as imu
from tests.cases import each
from tests.runtime.samples import NOW_NS, at_rest

SPEC = load_spec()
TICK_NS = 10_000_000


def initial_imu(sample):
    return imu.initial_imu(sample.imu_t_mono_ns, imu.imu_numbers(sample))


class Gripper:
    """One gripper; `tick` says whether its IMU was found wrong."""

    def __init__(self):
        self.noise = np.random.default_rng(0)
        self.now_ns = NOW_NS
        self.memory = initial_imu(self.sample(np.zeros(3), 9.81))

    def sample(self, gyro, force, **changes):
        given = {
            "imu_t_mono_ns": np.array([self.now_ns]),
            "imu_gyro_rad_per_s": (gyro + self.noise.normal(0.0, 1e-3, 3))[None],
            "imu_accel_m_per_s2": np.array([[0.0, 0.0, force + self.noise.normal(0.0, 1e-3)]]),
        }
        return at_rest(1, self.now_ns, **(given | changes))

    def tick(
        self,
        *,
        slew=0.0,
        boom=0.0,
        swing=0.0,
        roll=0.0,
        rates=(0.0, 0.0),
        turn=None,
        force=9.81,
        **changes,
    ):
        """One tick; angles and rates of the two free joints, `turn` is what the gyro sees of slew."""
        self.now_ns += TICK_NS
        turn = slew if turn is None else turn
        pitch_rate, roll_rate = rates
        sin, cos = np.sin(roll), np.cos(roll)
        gyro = np.array(
            [
                roll_rate - turn * np.sin(swing),
                pitch_rate * cos + turn * np.cos(swing) * sin,
                turn * np.cos(swing) * cos - pitch_rate * sin,
            ]
        )
        velocity = np.array([[slew, boom, 0.0, 0.0]])
        sample = self.sample(gyro, force, **changes)
        self.memory, wrong = imu.check_imu(
            self.memory, sample, velocity, np.array([swing]), np.array([roll])
        )
        return bool(wrong[0])

    def ticks_until_wrong(self, limit=200, **tick):
        return next((n for n in range(1, limit + 1) if self.tick(**tick)), None)


def test_a_swinging_gripper_under_a_turning_cabin_is_fine():
    gripper = Gripper()
    for tick in range(600):
        phase = 0.033 * tick
        assert not gripper.tick(
            slew=0.9 * np.sin(0.5 * phase),
            boom=0.3,
            swing=1.2 * np.sin(phase),
            roll=0.5 * np.cos(phase),
            rates=(4.0 * np.cos(phase), -1.6 * np.sin(phase)),
            force=9.81 + 6.0 * np.cos(2.0 * phase),
        )


def test_the_gyro_turns_with_the_slew_joint():
    # 0.35 rad/s as a mean over 0.2 s: an IMU that says nothing, one mounted the wrong way.
    for turn, slowest in ((0.0, 20), (-0.8, 9)):
        ticks = Gripper().ticks_until_wrong(slew=0.8, swing=0.3, roll=0.2, turn=turn)
        assert 2 < ticks < slowest
    assert Gripper().ticks_until_wrong(slew=0.34, turn=0.0) is None
    assert Gripper().ticks_until_wrong(slew=0.0, turn=-0.4)


def test_an_imu_that_repeats_itself():
    still = {"imu_gyro_rad_per_s": np.array([[0.04, 0.0, 0.0]])}
    turning = {"imu_gyro_rad_per_s": np.array([[0.06, 0.0, 0.0]])}
    assert Gripper().ticks_until_wrong(boom=0.11, **still) == 9
    assert Gripper().ticks_until_wrong(**turning) == 9
    assert Gripper().ticks_until_wrong(boom=0.1, **still) is None
    barely = {"imu_gyro_rad_per_s": np.array([[0.05, 0.0, 0.0]])}
    assert Gripper().ticks_until_wrong(**barely) is None
    # Each half for itself; one number of it that changes is life.
    force = {"imu_accel_m_per_s2": np.array([[0.0, 0.0, 9.81]])}
    assert Gripper().ticks_until_wrong(boom=0.11, **force) == 9
    gripper = Gripper()
    for tick in range(100):
        gyro = np.array([[1e-6 * tick, 0.0, 0.0]])
        assert not gripper.tick(boom=0.2, imu_gyro_rad_per_s=gyro)


def test_time_that_goes_back():
    gripper = Gripper()
    gripper.tick()
    assert gripper.tick(imu_t_mono_ns=np.array([gripper.now_ns - 1]))
    gripper = Gripper()
    assert not gripper.tick(imu_t_mono_ns=np.array([0]))  # never heard of, not gone back


def test_samples_that_come_too_seldom():
    def run(period, **tick):
        gripper = Gripper()
        found = False
        for number in range(200):
            stamp = gripper.now_ns + TICK_NS
            if number % period:
                stamp = int(gripper.memory.t_ns[0])
            found |= gripper.tick(imu_t_mono_ns=np.array([stamp]), **tick)
        return found

    assert run(10, boom=0.2)
    assert not run(10)  # nothing moves
    assert not run(4, boom=0.2)  # 25 Hz


@each("axis", range(3))
def test_a_rate_that_no_gripper_reaches(axis):
    for rate, wrong in ((8.8, True), (-8.8, True)):
        gyro = np.zeros((1, 3))
        gyro[0, axis] = rate
        assert Gripper().tick(imu_gyro_rad_per_s=gyro) == wrong
    if axis == 0:
        gyro[0, axis] = 8.7  # the end of the gyro's range is a rate
        assert not Gripper().tick(imu_gyro_rad_per_s=gyro)
    gyro[0, axis] = 8.6
    assert Gripper().tick(imu_gyro_rad_per_s=gyro) == (axis == 2)  # the slew joint does not turn


def test_a_specific_force_that_no_gripper_has():
    assert Gripper().ticks_until_wrong(force=0.0) is not None
    assert Gripper().ticks_until_wrong(limit=500, force=30.2) is not None
    assert Gripper().ticks_until_wrong(limit=500, force=2.8) is not None
    assert Gripper().ticks_until_wrong(force=29.0) is None
    assert Gripper().ticks_until_wrong(force=3.1) is None
    gripper = Gripper()
    assert not any(gripper.tick(force=80.0) for _ in range(5))  # a shock


def test_an_absent_imu_is_not_judged_here():
    never = {
        "imu_t_mono_ns": np.array([0]),
        "imu_gyro_rad_per_s": np.full((1, 3), np.nan),
        "imu_accel_m_per_s2": np.full((1, 3), np.nan),
    }
    gripper = Gripper()
    gripper.memory = initial_imu(gripper.sample(np.zeros(3), 9.81, **never))
    for _ in range(100):
        assert not gripper.tick(slew=0.8, boom=0.3, **never)
    assert np.isfinite([gripper.memory.slew_error, gripper.memory.force]).all()
    # Numbers without a time are none.
    for _ in range(100):
        assert not gripper.tick(force=0.0, imu_t_mono_ns=np.array([0]))
