import numpy as np
import pytest

from machine.conventions import CONTROL_PERIOD_S
from machine.spec import load_spec
from machine.starts import SAFE_ACTIVE_RAD_M, safe_pose
from runtime.control import swing_control as sc
from runtime.control.arm_motion import ArmMotion
from runtime.control.imu_estimator import ImuEstimate, swing_frequency_rad_per_s
from tests.cases import each
from tests.runtime.samples import at_rest

SPEC = load_spec()
PERIOD_S = 4.0 * np.pi / sum(swing_frequency_rad_per_s(SPEC))
TIMES = np.arange(0.0, 30.0, CONTROL_PERIOD_S)


def profile(turn, times=TIMES):
    return sc.turn_profile(times, np.full_like(times, turn), PERIOD_S)


@each("turn", [0.005, -0.03, 0.049, 0.051, -0.5, 1.57, np.pi])
def test_a_turn_arrives_and_its_rate_is_the_derivative_of_its_angle(turn):
    angle, rate, length = profile(turn)
    lost = 2.0 * sc.BREAKAWAY_S * sc.SMALL_TURN_RAD_PER_S if abs(turn) < sc.SMALL_TURN_RAD else 0.0
    assert angle[-1] == pytest.approx(turn + np.sign(turn) * lost)
    assert rate[-1] == pytest.approx(0.0, abs=1e-12)
    integral = np.cumsum(rate) * CONTROL_PERIOD_S
    assert np.allclose(integral, angle, atol=0.006)
    assert (np.abs(rate[length + 1e-9 < TIMES]) < 1e-12).all()
    assert (np.abs(rate) <= sc.ALIGN_SPEED_RAD_PER_S + 1e-9).all()
    assert angle[0] == 0.0


def test_no_turn_takes_no_time():
    angle, rate, length = profile(0.0)
    assert not angle.any() and not rate.any() and not length.any()


def swing_left(turn):
    """Amplitude that an undamped pendulum of the mean period keeps after a turn, per metre of radius."""
    w = 2.0 * np.pi / PERIOD_S
    _, rate, _ = profile(turn)
    acceleration = np.diff(rate, prepend=0.0) / CONTROL_PERIOD_S
    phase = np.exp(-1j * w * TIMES)
    return abs(np.sum(acceleration * phase) * CONTROL_PERIOD_S / w) / 0.92


@each("turn", [0.03, 0.3, 1.57, np.pi])
def test_a_turn_leaves_next_to_no_swing(turn):
    # At once, a turn would leave about 6 m x rate / (L omega); planned, a hundredth of a radian at most.
    assert 6.0 * swing_left(turn) < 0.02


def machines(count, slew=0.0):
    pose = np.tile(safe_pose(slew), (count, 1))
    return pose[:, :4]


def run_align(turn, *, seconds=25.0, response_s=0.25, loss=1.0, homing=False, start=None):
    """Slew (and arm) follow the request with a delay and a gain; returns the whole run."""
    count = 1
    position = machines(count) if start is None else np.array([start], dtype=float)
    state = sc.begin(
        sc.initial_swing(position[:, 0]),
        np.ones(count, dtype=np.bool_),
        position[:, 0],
        np.full(count, float(turn)),
        np.full(count, homing),
    )
    delay = [np.zeros((1, 4))] * round(response_s / CONTROL_PERIOD_S)
    speed = np.zeros((1, 4))
    for tick in range(round(seconds / CONTROL_PERIOD_S)):
        state, out = sc.align(SPEC, state, position, speed, np.zeros(1))
        if out.done[0]:
            return position[0], tick * CONTROL_PERIOD_S
        delay.append(out.request_rad_m_per_s * loss)
        speed = delay.pop(0)
        position = position + speed * CONTROL_PERIOD_S
    return position[0], np.inf


@each("turn", [0.0, 0.004, -0.02, 0.2, -1.57, 3.1])
@each("loss", [0.9, 1.0, 1.1])
def test_align_arrives_on_the_line(turn, loss):
    position, took_s = run_align(turn, loss=loss)
    assert position[0] == pytest.approx(turn, abs=sc.ALIGN_TOLERANCE_RAD + 5e-4)
    assert took_s < 16.0
    assert np.array_equal(position[1:], machines(1)[0, 1:])


def test_align_without_a_turn_takes_only_the_dwell():
    assert run_align(0.0)[1] == pytest.approx(sc.DWELL_S, abs=0.02)


def test_a_swing_or_motion_keeps_align_waiting():
    state = sc.initial_swing(np.zeros(1))
    still, moving = np.zeros((1, 4)), np.full((1, 4), sc.STILL_RAD_M_PER_S + 1e-6)
    for speed, amplitude in ((still, sc.ALIGNED_SWING_RAD), (moving, 0.0)):
        now = state
        for _ in range(100):
            now, out = sc.align(SPEC, now, machines(1), speed, np.array([amplitude]))
            assert not out.done[0]
    for _ in range(40):
        state, out = sc.align(
            SPEC, state, machines(1), still, np.array([sc.ALIGNED_SWING_RAD - 1e-6])
        )
    assert out.done[0]


def test_homing_brings_the_arm_to_the_safe_pose_while_the_cabin_turns():
    position, took_s = run_align(0.5, homing=True, start=[0.0, 0.1, 0.9, 1.5])
    assert np.allclose(position[1:], SAFE_ACTIVE_RAD_M[1:], atol=sc.HOMED_RAD_M + 0.005)
    assert position[0] == pytest.approx(0.5, abs=0.003)
    assert took_s < 20.0


def test_begin_touches_only_the_machines_that_begin():
    state = sc.initial_swing(np.zeros(2))
    state = state._replace(time_s=np.array([5.0, 5.0]), quiet_s=np.array([1.0, 1.0]))
    after = sc.begin(
        state,
        np.array([True, False]),
        np.array([0.3, 0.3]),
        np.array([1.0, 1.0]),
        np.array([True, True]),
    )
    assert after.time_s.tolist() == [0.0, 5.0]
    assert after.quiet_s.tolist() == [0.0, 1.0]
    assert after.start_slew_rad.tolist() == [0.3, 0.0]
    assert after.turn_rad.tolist() == [1.0, 0.0]
    assert after.homing.tolist() == [True, False]


def test_choose_takes_each_machine_from_its_side():
    one, two = sc.initial_swing(np.zeros(2)), sc.initial_swing(np.ones(2))
    mixed = sc.choose(np.array([True, False]), one, two)
    assert mixed.slew_rad.tolist() == [0.0, 1.0]


def imu(swing=0.0, roll=0.0, swing_rate=0.0, roll_rate=0.0):
    values = [np.array([v], dtype=float) for v in (swing, roll, swing_rate, roll_rate, 0.02)]
    return ImuEstimate(*values)


def test_amplitude_is_kept_by_a_free_swing():
    pitch, roll = swing_frequency_rad_per_s(SPEC)
    for phase in np.linspace(0.0, 6.0, 7):
        estimate = imu(
            0.3 * np.cos(phase),
            0.4 * np.cos(phase),
            -0.3 * pitch * np.sin(phase),
            -0.4 * roll * np.sin(phase),
        )
        assert sc.swing_amplitude_rad(SPEC, estimate)[0] == pytest.approx(0.5)


def settle_once(position, estimate, speed=None):
    sample = at_rest(1, joint_position_rad_m=position)
    return sc.settle(
        SPEC,
        # The follow-through of the first seconds has tests of its own.
        sc.initial_swing(position[:, 0])._replace(time_s=np.array([10.0])),
        position,
        np.zeros((1, 4)) if speed is None else speed,
        ArmMotion.of(SPEC, sample),
        estimate,
        sc.swing_amplitude_rad(SPEC, estimate),
    )


@each("sign", [1.0, -1.0])
def test_the_pin_goes_after_the_load(sign):
    _, out = settle_once(machines(1), imu(swing=0.3 * sign))
    assert np.sign(out.request_rad_m_per_s[0, 2]) == sign
    assert out.request_rad_m_per_s[0, 0] == 0.0
    _, out = settle_once(machines(1), imu(roll=0.3 * sign))
    assert np.sign(out.request_rad_m_per_s[0, 0]) == sign


def test_a_lying_tube_damps_with_its_telescope():
    position = machines(1)
    position[0, 1:3] = [0.7, np.pi / 2 - 0.75]
    _, out = settle_once(position, imu(swing=0.3))
    wanted = ArmMotion.of(
        SPEC,
        at_rest(
            1, joint_position_rad_m=position, joint_velocity_rad_m_per_s=out.request_rad_m_per_s
        ),
    )
    assert out.request_rad_m_per_s[0, 3] > 0.1
    assert wanted.velocity_rad_m_per_s[0, 0] > 0.1


def test_what_friction_holds_is_left_alone():
    _, out = settle_once(machines(1), imu(swing=1.9 * sc.DAMPING_DEAD_ZONE_RAD))
    assert not out.request_rad_m_per_s.any()


def test_a_calm_machine_goes_home_and_a_swinging_one_waits():
    away = machines(1) + np.array([[0.4, -0.2, 0.3, 0.4]])
    _, calm = settle_once(away, imu())
    assert np.sign(calm.request_rad_m_per_s[0]).tolist() == [0.0, 1.0, -1.0, -1.0]
    _, wild = settle_once(away, imu(roll=0.9))
    assert (
        np.abs(wild.request_rad_m_per_s[0, 1:]) < 0.1 * np.abs(calm.request_rad_m_per_s[0, 1:])
    ).all()


@each(
    "change, done",
    [
        ({}, True),
        ({"gap": sc.SETTLED_POSITION_RAD_M - 1e-6}, True),
        ({"gap": sc.SETTLED_POSITION_RAD_M}, False),
        ({"speed": sc.STILL_RAD_M_PER_S}, False),
        ({"swing": sc.SETTLED_SWING_RAD}, False),
        ({"swing": sc.SETTLED_SWING_RAD - 1e-6}, True),
    ],
)
def test_settled_means_at_home_still_and_calm_for_a_while(change, done):
    position = machines(1)
    position[0, 1] += change.get("gap", 0.0)
    estimate = imu(swing=change.get("swing", 0.0))
    speed = np.full((1, 4), change.get("speed", 0.0))
    state, arm = sc.initial_swing(position[:, 0]), ArmMotion.of(SPEC, at_rest(1))
    amplitude = sc.swing_amplitude_rad(SPEC, estimate)
    for tick in range(40):
        state, out = sc.settle(SPEC, state, position, speed, arm, estimate, amplitude)
        if tick < 25:
            assert not out.done[0]
    assert bool(out.done[0]) is done


def swing_after(damped, seconds=6.0):
    """A pendulum on a pin that follows the damping request through 0.2 s of delay; amplitude left."""
    w = swing_frequency_rad_per_s(SPEC)[0]
    angle, rate, speeds = 0.5, 0.0, [0.0] * 20
    position = machines(1)
    for _ in range(round(seconds / CONTROL_PERIOD_S)):
        _, out = settle_once(position, imu(swing=angle, swing_rate=rate))
        arm = ArmMotion.of(
            SPEC,
            at_rest(
                1, joint_position_rad_m=position, joint_velocity_rad_m_per_s=out.request_rad_m_per_s
            ),
        )
        speeds.append(float(arm.velocity_rad_m_per_s[0, 0]) if damped else 0.0)
        push = (speeds[-20] - speeds[-21]) / CONTROL_PERIOD_S
        rate += (-w * w * np.sin(angle) - w * w / 9.81 * push) * CONTROL_PERIOD_S
        angle += rate * CONTROL_PERIOD_S
    return np.hypot(angle, rate / w)


def test_damping_damps():
    assert swing_after(False) > 0.45
    assert swing_after(True) < 0.1
