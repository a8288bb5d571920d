"""Each cross-check at its bound, in both directions, and silent on what healthy sensors say."""

from dataclasses import replace

import numpy as np

from machine.spec import load_spec
from runtime.guard import plausibility
from runtime.guard.plausibility import Contradiction, initial_guard
from tests.cases import each
from tests.runtime.samples import NOW_NS, at_rest

SPEC = load_spec()
TICK_NS = 10_000_000
MIDDLE = np.array([0.0, 0.5, 0.0, 0.5])


class Guard:
    """One machine, tick by tick; joints move as they are told, sensors say so unless changed."""

    def __init__(self, count=1):
        self.memory = initial_guard(count)
        self.count = count
        self.now_ns = NOW_NS
        self.position = np.tile(MIDDLE, (count, 1))
        self.noise = np.random.default_rng(0)
        self.bits = np.zeros(count, dtype=np.int64)

    def tick(self, velocity=(0.0, 0.0, 0.0, 0.0), valve=(0.0, 0.0, 0.0, 0.0), *, gap=1, **sample):
        self.now_ns += gap * TICK_NS
        speed = np.tile(np.asarray(velocity, dtype=float), (self.count, 1))
        self.position = self.position + speed * 0.01 * gap
        given = at_rest(
            self.count,
            self.now_ns,
            joint_position_rad_m=self.position + self.noise.normal(0.0, 1e-4, (self.count, 4)),
            joint_velocity_rad_m_per_s=speed,
            imu_t_mono_ns=np.full(self.count, self.now_ns),
            imu_gyro_rad_per_s=self.noise.normal(0.0, 1e-3, (self.count, 3)),
        )
        given = replace(given, **sample)
        valves = np.tile(np.asarray(valve, dtype=float), (self.count, 1))
        self.memory, self.bits = plausibility.check(SPEC, self.memory, given, valves, self.now_ns)
        return int(self.bits[0])

    def ticks_until(self, bit, limit=200, **tick):
        for number in range(1, limit + 1):
            if self.tick(**tick) & int(bit):
                return number
        return None


def numbers(memory):
    """All arrays of a memory and of the memories in it."""
    for value in memory:
        if isinstance(value, tuple):
            yield from numbers(value)
        else:
            yield value


def rest(guard, count=5):
    for _ in range(count):
        assert guard.tick() == 0


def test_a_machine_at_rest_contradicts_nothing():
    guard = Guard(3)
    for _ in range(500):
        assert guard.tick() == 0
        assert not guard.bits.any()


@each("joint", range(4))
def test_a_jump_of_an_encoder_is_seen_in_its_first_tick(joint):
    for size in (0.03, -0.03, 0.5, np.pi / 2):
        guard = Guard()
        rest(guard)
        guard.position[0, joint] += size
        assert guard.tick() == Contradiction.JUMP
    guard = Guard()
    rest(guard)
    guard.position[0, joint] += 0.02
    assert guard.tick() == 0


def test_a_slip_is_forgotten_within_a_second():
    # With a time constant of 0.8 s: 0.02 rad count 0.0074 after 0.8 s, 0.012 after 0.4 s.
    for ticks, is_jump in ((80, False), (40, True)):
        guard = Guard()
        rest(guard)
        guard.position[0, 1] += 0.02
        assert guard.tick() == 0
        rest(guard, ticks)
        guard.position[0, 1] += 0.016
        assert bool(guard.tick() & Contradiction.JUMP) == is_jump


@each("joint", range(4))
def test_positions_that_stand_while_the_velocity_goes_on(joint):
    for speed in (0.2, -0.2):
        guard = Guard()
        rest(guard)
        velocity = np.zeros(4)
        velocity[joint] = speed
        moving = guard.position.copy()
        ticks = 0
        while not guard.tick(velocity, joint_position_rad_m=moving + 1e-4 * ticks) & 1:
            ticks += 1
        assert 11 <= ticks <= 15  # 0.025 rad at 0.2 rad/s


def test_a_frozen_position_beside_a_living_velocity():
    for speed in (0.2, -0.2, 0.04):
        guard = Guard()
        rest(guard)
        frozen = guard.position.copy()

        def found(guard=guard, frozen=frozen, speed=speed):
            velocity = np.array([[0.0, 0.0, speed + guard.noise.normal(0.0, 0.002), 0.0]])
            return guard.tick(joint_position_rad_m=frozen, joint_velocity_rad_m_per_s=velocity)

        ticks = next(n for n in range(1, 20) if found() & Contradiction.FROZEN)
        assert ticks == 11  # the first sample differs from the one before, then 100 ms


def test_frozen_values_under_fresh_stamps():
    guard = Guard()
    rest(guard)
    frozen = {
        "joint_position_rad_m": guard.position.copy(),
        "joint_velocity_rad_m_per_s": np.array([[0.0, 0.031, 0.0, 0.0]]),
    }
    number = guard.ticks_until(Contradiction.FROZEN, **frozen)
    assert number == 6  # the first sample differs from the one before, then 50 ms
    # Below the noise of the velocity nothing moves: a machine that stands may repeat itself.
    guard = Guard()
    still = frozen | {"joint_velocity_rad_m_per_s": np.array([[0.0, 0.03, 0.0, 0.0]])}
    for _ in range(60):
        assert not guard.tick(**still) & Contradiction.FROZEN


@each("joint, limit", [(0, 21), (1, 14), (2, 14), (3, 14)])
def test_frozen_values_while_a_valve_is_open(joint, limit):
    guard = Guard()
    rest(guard)
    frozen = {
        "joint_position_rad_m": guard.position.copy(),
        "joint_velocity_rad_m_per_s": np.zeros((1, 4)),
    }
    for _ in range(30):
        assert guard.tick(**frozen) == 0
    valve = np.zeros(4)
    valve[joint] = 0.13
    assert guard.ticks_until(Contradiction.FROZEN, valve=valve, **frozen) == limit
    guard = Guard()
    valve[joint] = 0.12
    assert guard.ticks_until(Contradiction.FROZEN, limit=30, valve=valve, **frozen) is None


def test_time_that_goes_back():
    guard = Guard()
    rest(guard)
    assert guard.tick(t_mono_ns=guard.now_ns - 30_000_000) == Contradiction.CLOCK
    guard = Guard()
    rest(guard)
    assert guard.tick(imu_t_mono_ns=np.array([guard.now_ns - 1])) == Contradiction.IMU
    guard = Guard()
    rest(guard)
    assert guard.tick(imu_t_mono_ns=np.array([0])) == 0  # never heard of, not gone back
    # The machine's clock and its sensors' together.
    assert guard.tick(gap=-3) == Contradiction.CLOCK


def test_a_loop_that_is_always_late_is_checked_all_the_same():
    """Gaps up to the one after which the throw is aborted and the valves are closed by the machine."""
    for gap in (2, 4, 10, 11):
        guard = Guard()
        rest(guard)
        ticks = guard.ticks_until(Contradiction.FOLLOWING, gap=gap, velocity=(0.0, 0.3, 0.0, 0.0))
        assert ticks is not None and 0.003 * ticks * gap < 0.1


def test_repeated_stamps_are_no_new_samples():
    guard = Guard()
    rest(guard)
    old_ns = guard.now_ns
    for _ in range(4):
        far = guard.position + 1.0
        assert guard.tick(t_mono_ns=old_ns, joint_position_rad_m=far) == 0
    assert guard.tick() == 0


def test_a_gap_begins_anew():
    guard = Guard()
    rest(guard)
    guard.position += 1.0
    assert guard.tick(gap=12) == 0
    assert guard.tick() == 0
    guard.position += 1.0
    assert guard.tick(gap=11) & Contradiction.JUMP
    # A second call within the same tick changes nothing and contradicts nothing.
    guard.now_ns -= TICK_NS
    assert guard.tick() == 0


def test_numbers_that_are_none_leave_the_memory_clean():
    guard = Guard()
    rest(guard)
    for bad in (np.nan, np.inf, -1e300):
        position = guard.position.copy()
        position[0, 1] = bad
        guard.tick(joint_position_rad_m=position, valve=(np.nan, 5.0, -7.0, 0.0))
        for values in numbers(guard.memory):
            assert np.isfinite(np.asarray(values, dtype=float)).all()
    fresh = Guard()
    fresh.tick(joint_position_rad_m=np.full((1, 4), np.nan))
    assert np.isfinite(fresh.memory.position).all()


def test_machines_of_a_batch_do_not_see_each_other():
    guard = Guard(3)
    rest(guard)
    guard.position[1, 2] += 0.5
    guard.tick()
    assert guard.bits.tolist() == [0, 1, 0]
