"""The drive envelope: silent for every drive within its bounds, loud for motion that no command explains."""

import numpy as np

from machine.kinematics import cylinder_arm_m
from machine.spec import load_spec
from runtime.guard import drive_envelope
from runtime.guard.drive_envelope import DriveBounds
from tests.cases import each

SPEC = load_spec()
MIDDLE = np.array([[0.0, 0.5, 0.0, 0.5]])
DRIVES = (
    DriveBounds((0.08, 0.20), (0.05, 0.30), (0.65, 1.25), (0.65, 1.25), 0.022),
    DriveBounds((0.04, 0.14), (0.03, 0.06), (0.7, 1.25), (0.7, 1.3), 0.036),
    DriveBounds((0.04, 0.14), (0.03, 0.13), (0.15, 1.3), (0.4, 1.6), 0.024),
    DriveBounds((0.04, 0.14), (0.03, 0.06), (0.7, 1.25), (0.7, 1.25), 0.018),
)
"""Drives that machines have, and motion that may go uncommanded: what the envelope must bear and see."""
DEAD_BANDS = (0.01, 0.10)
JOINT_SIGNS = [(joint, sign) for joint in range(4) for sign in (1, -1)]


class Envelope:
    """One machine at rest, tick by tick."""

    def __init__(self):
        self.memory = drive_envelope.initial_drives(np.zeros((1, 4)), np.zeros((2, 1, 4)))
        self.way = np.zeros(4)
        self.before = np.zeros((1, 4))

    def tick(self, joint, valve=0.0, speed=0.0, position=MIDDLE, count=1):
        valves, speeds = np.zeros((1, 4)), np.zeros((1, 4))
        valves[0, joint], speeds[0, joint] = valve, speed
        steady = drive_envelope.speed_bounds(SPEC, valves, position)
        self.memory, over = drive_envelope.follow(
            SPEC, self.memory, steady, position, speeds, self.before, count
        )
        self.before = speeds
        self.way += 0.01 * speeds[0] * count
        assert not np.delete(over[0], joint).any()
        return bool(over[0, joint])

    def ticks_until_over(self, joint, limit=200, **tick):
        return next((n for n in range(1, limit + 1) if self.tick(joint, **tick)), None)


def steady_speed(joint, valve, gain=1.0, dead_band=0.04):
    """Of a drive at the middle of its range: band, curve, gain, the spec's speed limit."""
    share = max(abs(valve) - dead_band, 0.0) / (1.0 - dead_band)
    speeds = SPEC.limits.speed_positive_rad_m_per_s, SPEC.limits.speed_negative_rad_m_per_s
    return np.sign(valve) * gain * share * (0.8 + 0.2 * share) * speeds[int(valve < 0.0)][joint]


def drive(rng, joint, bounds):
    """A drive with a dead time, a lag, a dead band and gains within the bounds; valve -> speed."""
    dead = int(
        rng.integers(*np.rint(np.array(bounds.dead_time_s) * 100).astype(int), endpoint=True)
    )
    share = 1.0 - np.exp(-0.01 / rng.uniform(*bounds.lag_s))
    gains = rng.uniform(*bounds.gain_positive), rng.uniform(*bounds.gain_negative)
    band = rng.uniform(*DEAD_BANDS)
    line, speed = [0.0] * (dead + 1), 0.0

    def step(valve):
        nonlocal speed
        line.insert(0, valve)
        line.pop()
        gain = gains[int(line[-1] < 0.0)]
        speed += share * (steady_speed(joint, line[-1], gain, band) - speed)
        return speed

    return step


@each("joint", range(4))
def test_drives_within_the_bounds_accumulate_nothing(joint):
    rng = np.random.default_rng(joint)
    for _ in range(40):
        envelope, answer = Envelope(), drive(rng, joint, DRIVES[joint])
        valve = speed = 0.0
        for tick in range(250):
            if tick % 25 == 0:
                valve = rng.uniform(-1.0, 1.0) * (rng.random() < 0.7)
            assert not envelope.tick(joint, valve, speed)
            speed = answer(valve)
        assert not envelope.memory.motion.any()


@each("joint, sign", JOINT_SIGNS)
def test_a_joint_that_moves_by_itself(joint, sign):
    for speed in (0.05, 0.2, 0.5):
        envelope = Envelope()
        assert envelope.ticks_until_over(joint, speed=sign * speed)
        assert abs(envelope.way[joint]) < 0.1
    slow = Envelope()
    assert slow.ticks_until_over(joint, limit=500, speed=0.01 * sign) is None


@each("joint, sign", JOINT_SIGNS)
def test_a_joint_that_goes_on_after_its_valve_was_closed(joint, sign):
    envelope, valve = Envelope(), 0.7 * sign
    speed = steady_speed(joint, valve)
    for tick in range(100):
        assert not envelope.tick(joint, valve, speed if tick > 12 else 0.0)
    begin = envelope.way[joint]
    ticks = envelope.ticks_until_over(joint, speed=speed)
    # Dead time, lag and limit: what a closed valve explains, and no more.
    bounds = DRIVES[joint]
    assert bounds.dead_time_s[1] * 100 < ticks
    reach = abs(speed) * (bounds.dead_time_s[1] + 1.2 * bounds.lag_s[1]) + bounds.limit_rad_or_m
    assert abs(envelope.way[joint] - begin) < reach + 0.03


@each("joint, sign", JOINT_SIGNS)
def test_a_joint_that_does_not_follow(joint, sign):
    # It stands, or it moves the other way.
    for speed, slowest in ((0.0, 90), (-0.3 * sign, 20)):
        ticks = Envelope().ticks_until_over(joint, valve=0.8 * sign, speed=speed)
        assert ticks is not None and ticks < slowest


@each("joint, sign", JOINT_SIGNS)
def test_a_joint_that_is_faster_or_slower_than_any_drive(joint, sign):
    bounds, steady = DRIVES[joint], steady_speed(joint, 0.8 * sign)
    slowest, fastest = bounds.gain_positive if sign > 0 else bounds.gain_negative
    for gain, is_over in (
        (fastest, False),
        (fastest + 0.25, True),
        (slowest, False),
        (slowest - 0.3, True),
    ):
        envelope = Envelope()
        # It follows in time, until it has the speed of a nominal machine.
        for tick in range(60):
            assert not envelope.tick(joint, 0.8 * sign, steady if tick > 12 else 0.0)
        ticks = envelope.ticks_until_over(joint, valve=0.8 * sign, speed=gain * steady)
        assert (ticks is not None) == is_over, gain


@each("joint, sign", [(j, s) for j in range(1, 4) for s in (1, -1)])
def test_a_joint_at_its_end_need_not_follow(joint, sign):
    low, high = SPEC.position_range_rad_m
    position = MIDDLE.copy()
    position[0, joint] = (high if sign > 0 else low)[joint] - 0.059 * sign
    assert Envelope().ticks_until_over(joint, valve=0.8 * sign, position=position) is None
    # There, too, it may not move without a command.
    assert Envelope().ticks_until_over(joint, speed=0.3 * sign, position=position)
    position[0, joint] -= 0.002 * sign
    assert Envelope().ticks_until_over(joint, valve=0.8 * sign, position=position)


def test_several_ticks_at_once_are_those_one_after_the_other():
    single, several = Envelope(), Envelope()
    for number in range(1, 37):
        single.tick(1, 0.5, 0.003 * number)
        if number % 3 == 0:
            several.tick(1, 0.5, 0.003 * number, count=3)
    for one, other in zip(single.memory, several.memory, strict=True):
        assert np.allclose(one, other)


def test_uncommanded_motion_is_forgotten():
    envelope = Envelope()
    limit = DRIVES[1].limit_rad_or_m
    while (ratio := drive_envelope.motion_ratio(SPEC, envelope.memory)[0, 1]) < 0.9:
        assert not envelope.tick(1, speed=0.1)
    assert np.isclose(envelope.memory.motion[0, 0, 1], ratio * limit)
    for _ in range(200):
        envelope.tick(1)
    after = drive_envelope.motion_ratio(SPEC, envelope.memory)[0, 1]
    assert after < 0.4 * ratio


def test_the_bounds_are_those_of_the_speed_limits_at_a_full_valve():
    speeds = SPEC.limits.speed_positive_rad_m_per_s, SPEC.limits.speed_negative_rad_m_per_s
    for way, sign in ((0, 1.0), (1, -1.0)):
        high, low = drive_envelope.speed_bounds(SPEC, np.full((1, 4), sign), MIDDLE)[[way, 1 - way]]
        gains = np.array([drive[2 + way] for drive in DRIVES])
        assert np.allclose(high, gains[:, 1] * speeds[way])
        assert np.allclose(-low, gains[:, 0] * speeds[way])
    small = drive_envelope.speed_bounds(SPEC, np.full((1, 4), DEAD_BANDS[1]), MIDDLE)
    assert (small[0] > 0.0).all() and not small[1].any()


def test_the_cylinder_s_moment_arm_is_that_of_the_machine():
    for cylinder in (SPEC.hydraulics.boom_cylinder, SPEC.hydraulics.dipper_cylinder):
        angle = np.linspace(-1.0, 1.0, 50)
        found = drive_envelope.moment_arm_m(cylinder, angle)
        assert np.allclose(found, np.abs(cylinder_arm_m(cylinder, angle)))
