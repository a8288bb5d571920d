import copy
from dataclasses import fields, is_dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from machine.calibration import nominal_calibration
from machine.conventions import CONTROL_PERIOD_NS, Mode, Motion
from machine.errors import PolicyError
from machine.spec import load_spec
from machine.starts import safe_pose, sample_starts
from machine.telemetry import CONTROL_ROW, POLICY_ROW
from runtime.control import control_loop, safety
from runtime.control.control_loop import ControlInputs, ControlParams, Violation, next_motion
from runtime.control.policy import PolicyRunner
from sim_twin.twin.twin import Twin
from tests.cases import each
from tests.runtime.samples import NOW_NS, at_rest

SPEC = load_spec()
CALIBRATION = nominal_calibration(SPEC)
TARGET = np.array([[8.5, 0.0, 0.0]])


def params(mode=Mode.PLANAR, policy=None):
    return ControlParams(SPEC, CALIBRATION, mode, policy)


class Scripted:
    """Steady action; the last action asks for the release."""

    action_scale_rad_m_per_s = np.array([0.5, 0.7, 0.5])
    is_paced = is_late = False

    card = SimpleNamespace(mode=Mode.PLANAR, policy_id="scripted", policy_sha256="0" * 64)

    def __init__(self, action=(0.3, 0.0, 0.0, -1.0)):
        self.action = action

    def infer(self, observation):
        return np.tile(np.asarray(self.action, dtype=float), (len(observation), 1))


class Loop:
    """Machines whose sensors give the chosen values."""

    def __init__(self, count=1, policy=None, mode=Mode.PLANAR, target=TARGET):
        self.params = params(mode, policy)
        self.target = np.tile(target, (count, 1))
        self.count, self.now_ns = count, NOW_NS
        self.state = control_loop.initial_state(
            self.params, at_rest(count), self.target, self.now_ns
        )

    def step(self, *motion, **sample):
        motion = np.array([int(m) for m in motion] * (self.count if len(motion) == 1 else 1))
        given = replace(at_rest(self.count, self.now_ns), **sample)
        inputs = ControlInputs(given, motion, self.target)
        self.state, self.out = control_loop.step(self.params, self.state, inputs, self.now_ns)
        self.now_ns += CONTROL_PERIOD_NS
        return self.out


@each("motion", [Motion.HOLD, Motion.STOP])
def test_a_standing_machine_keeps_its_valves_closed(motion):
    loop = Loop(3)
    rng = np.random.default_rng(0)
    for _ in range(50):
        noise = rng.normal(0.0, 0.008, (3, 4))
        out = loop.step(motion, joint_velocity_rad_m_per_s=noise)
        assert not out.command.valve_ratio.any() and not out.command.gripper_open.any()


def test_stop_closes_at_once_and_the_way_back_starts_from_rest():
    loop = Loop(policy=Scripted())
    for _ in range(40):
        loop.step(Motion.THROW)
    assert loop.out.command.valve_ratio[0, 1] > 0.1
    loop.step(Motion.STOP)
    assert not loop.out.command.valve_ratio.any()
    assert loop.out.row["safety_code_count"][0] & safety.Intervention.STOPPED
    assert loop.out.violation_count[0] == 0
    loop.step(Motion.HOLD)
    assert not loop.out.command.valve_ratio.any()
    assert not loop.out.row["velocity_reference_rad_m_per_s"].any()


def test_hold_ramps_down():
    loop = Loop(policy=Scripted())
    for _ in range(40):
        loop.step(Motion.THROW)
    before = loop.out.row["velocity_reference_rad_m_per_s"][0, 1]
    loop.step(Motion.HOLD)
    after = loop.out.row["velocity_reference_rad_m_per_s"][0, 1]
    assert before - after == pytest.approx(SPEC.limits.acceleration_rad_m_per_s2[1] * 0.01)
    assert loop.out.row["velocity_request_rad_m_per_s"][0].tolist() == [0.0] * 4


def test_release_load_gone_and_the_end_of_a_throw():
    loop = Loop(2, policy=Scripted((0.0, 0.0, 0.0, 1.0)))
    held = np.array([True, True])
    out = loop.step(Motion.THROW, payload_held=held)
    assert out.release_commanded.all() and out.command.gripper_open.all()
    assert not out.load_gone.any() and not out.throw_done.any()
    for _ in range(24):
        out = loop.step(Motion.THROW, payload_held=held)
    out = loop.step(Motion.THROW, payload_held=np.array([False, True]))
    assert out.load_gone.tolist() == out.throw_done.tolist() == [True, False]
    for tick in range(26, 61):
        out = loop.step(Motion.THROW, payload_held=np.array([False, True]))
        assert out.throw_done[1] == (tick >= 60)
    assert not out.load_gone[1]
    out = loop.step(Motion.SETTLE, payload_held=np.array([False, True]))
    assert out.command.gripper_open.all()
    out = loop.step(Motion.HOLD, payload_held=np.array([False, True]))
    assert not out.command.gripper_open.any() and out.release_commanded.all()
    out = loop.step(Motion.ALIGN, payload_held=held)
    assert not out.release_commanded.any()


def test_a_load_that_falls_before_the_release_is_not_gone_by_it():
    loop = Loop(policy=Scripted())
    out = loop.step(Motion.THROW, payload_held=np.array([False]))
    assert not out.load_gone.any() and not out.throw_done.any()


def test_next_motion():
    loop = Loop(6)
    out = loop.step(Motion.HOLD)
    flags = np.array([True, False, True, False, True, True])
    out = replace(out, aligned=flags, throw_done=flags)
    motion = np.array([1, 1, 2, 2, 3, 0])
    quiet = np.zeros(6, dtype=np.bool_)
    assert next_motion(motion, replace(out, aligned=quiet, throw_done=quiet)) is motion
    assert next_motion(motion, out).tolist() == [2, 1, 3, 2, 3, 0]
    out = replace(out, aligned=flags, throw_done=~flags)
    assert next_motion(motion, out).tolist() == [2, 1, 2, 3, 3, 0]


@each(
    "change, violation",
    [
        ({"local_enable": np.array([False])}, Violation.SAFETY),
        ({"emergency_stop": np.array([True])}, Violation.SAFETY),
        ({"joint_velocity_rad_m_per_s": np.array([[2.0, 0, 0, 0]])}, Violation.SAFETY),
        ({"imu_t_mono_ns": np.array([0])}, Violation.IMU),
        ({"imu_t_mono_ns": np.array([NOW_NS - 150_001_000])}, Violation.IMU),
    ],
)
def test_violations(change, violation):
    loop = Loop(policy=Scripted())
    loop.state = replace(loop.state, imu=loop.state.imu._replace(t_ns=np.array([0])))
    assert loop.step(Motion.THROW, **change).violation_count[0] == int(violation)


def test_an_imu_of_150_ms_will_do_and_an_idle_machine_needs_none():
    loop = Loop(policy=Scripted())
    loop.state = replace(loop.state, imu=loop.state.imu._replace(t_ns=np.array([0])))
    old = {"imu_t_mono_ns": np.array([NOW_NS - 149_999_000])}
    assert loop.step(Motion.THROW, **old).violation_count[0] == 0
    loop = Loop()
    loop.state = replace(loop.state, imu=loop.state.imu._replace(t_ns=np.array([0])))
    assert loop.step(Motion.HOLD, imu_t_mono_ns=np.array([0])).violation_count[0] == 0
    for motion in (Motion.ALIGN, Motion.SETTLE):
        found = loop.step(motion, imu_t_mono_ns=np.array([0])).violation_count[0]
        assert found == Violation.IMU


@each("axis", [0, 1])
@each("sign", [1.0, -1.0])
@each("beyond, violates", [(-0.02, False), (0.02, True)])
def test_too_much_swing(axis, sign, beyond, violates):
    loop = Loop(policy=Scripted())
    angle = np.zeros((2, 1))
    angle[axis] = sign * (SPEC.limits.swing_rad + beyond)
    imu = loop.state.imu._replace(t_ns=np.array([NOW_NS - 1]), angle_rad=angle)
    loop.state = replace(loop.state, imu=imu)
    # The hand-made sample is not newer, so the angle stays.
    out = loop.step(Motion.THROW, imu_t_mono_ns=np.array([NOW_NS - 1]))
    assert out.violation_count[0] == (int(Violation.SWING) if violates else 0)


def test_a_late_policy_is_a_violation_and_moves_and_releases_nothing():
    policy = Scripted((1.0, 1.0, 1.0, 1.0))
    policy.is_late = True
    out = Loop(policy=policy).step(Motion.THROW)
    assert out.violation_count[0] == int(Violation.LATE)
    assert not out.release_commanded.any() and not out.command.gripper_open.any()
    assert not out.row["velocity_request_rad_m_per_s"].any()


def test_a_broken_policy_is_a_violation_and_moves_nothing():
    loop = Loop(policy=Scripted((np.nan, 1.0, 1.0, 1.0)))
    out = loop.step(Motion.THROW)
    assert out.violation_count[0] == int(Violation.POLICY)
    assert not out.release_commanded.any()
    assert not out.row["velocity_request_rad_m_per_s"].any()


def test_the_row_of_a_tick():
    loop = Loop(2, policy=Scripted())
    loop.step(Motion.HOLD)
    out = loop.step(Motion.THROW, Motion.HOLD)
    row = out.row
    assert row.dtype == CONTROL_ROW and row.shape == (2,)
    assert row["t_mono_ns"].tolist() == [loop.now_ns - CONTROL_PERIOD_NS] * 2
    assert row["sensor_t_mono_ns"].tolist() == row["t_mono_ns"].tolist()
    assert row["tick_count"].tolist() == [1, 1]
    assert row["motion_code_count"].tolist() == [2, 0]
    assert np.allclose(row["sensor_position_rad_m"], safe_pose()[:4])
    assert np.allclose(row["joint_position_rad_m"], safe_pose(), atol=1e-6)
    assert row["velocity_request_rad_m_per_s"][0].tolist() == [0.0, 0.15, 0.0, 0.0]
    assert row["velocity_reference_rad_m_per_s"][0, 1] == pytest.approx(0.015)
    assert (row["valve_requested_ratio"][0, 1] > 0.0) and not row["valve_requested_ratio"][1].any()
    assert np.array_equal(row["valve_applied_ratio"], out.command.valve_ratio)
    assert row["payload_held"].all() and (row["supply_pressure_pa"] == 35e6).all()
    assert out.policy_row.dtype == POLICY_ROW
    assert out.motion_time_s.tolist() == [0.0, 0.02]


def test_a_policy_of_the_other_mode_is_refused(swing_policies):
    with pytest.raises(PolicyError, match="mode 3d"):
        params(Mode.PLANAR, PolicyRunner(swing_policies / "swing-3d", SPEC))


def test_align_turns_the_short_way():
    for bearing, sign in ((3.0, 1.0), (-3.0, -1.0), (0.5, 1.0)):
        target = np.array([[8.0 * np.cos(bearing), 8.0 * np.sin(bearing), 0.0]])
        loop = Loop(target=target)
        for _ in range(60):
            loop.step(Motion.ALIGN)
        assert np.sign(loop.out.row["velocity_request_rad_m_per_s"][0, 0]) == sign


def test_align_in_3d_only_waits_for_the_swing_to_die():
    loop = Loop(mode=Mode.SPATIAL, target=np.array([[0.0, 9.0, 0.0]]))
    for tick in range(40):
        out = loop.step(Motion.ALIGN)
        assert not out.row["velocity_request_rad_m_per_s"].any()
        assert bool(out.aligned[0]) == (tick >= 29)


def test_align_brings_an_arm_home_that_no_throw_may_start_from():
    loop = Loop(target=np.array([[8.5, -0.3, 0.0]]))
    low = np.tile([0.0, 0.0, 0.9, 0.1], (1, 1))
    out = loop.step(Motion.ALIGN, joint_position_rad_m=low)
    request = out.row["velocity_request_rad_m_per_s"][0]
    assert request[1] > 0.0 and request[2] < 0.0
    assert not out.aligned[0]


def test_nan_targets_hurt_nobody_who_does_not_need_one():
    loop = Loop(2)
    loop.target = np.array([[np.nan] * 3, [8.0, 0.0, 0.0]])
    for _ in range(5):
        out = loop.step(Motion.SETTLE, Motion.ALIGN)
    assert np.isfinite(out.row["velocity_request_rad_m_per_s"]).all()
    assert np.isfinite(out.command.valve_ratio).all()


def leaves(value):
    if is_dataclass(value):
        return [leaf for f in fields(value) for leaf in leaves(getattr(value, f.name))]
    if isinstance(value, tuple):
        return [leaf for item in value for leaf in leaves(item)]
    return [value]


@pytest.fixture(scope="module")
def throw(swing_policies):
    """A batch in mixed motions on the twin: (params, states before, inputs, now, outputs)."""
    runner = PolicyRunner(swing_policies / "swing-2d", SPEC)
    constants = ControlParams(SPEC, CALIBRATION, Mode.PLANAR, runner)
    count = 4
    target = np.tile([8.5, 1.0, 0.0], (count, 1))
    plant = Twin.for_plant(count=count, unit_seed=0)
    plant.reset(sample_starts(SPEC, Mode.PLANAR, target, np.random.default_rng(3)), 1)
    sample = plant.read()
    state = control_loop.initial_state(constants, sample, target, plant.now_ns())
    history = []
    for tick in range(120):
        motion = np.array([2, 2 if tick > 3 else 0, 1, 3])
        now_ns = plant.now_ns()
        inputs = ControlInputs(sample, motion, target)
        before = copy.deepcopy(state)
        after, out = control_loop.step(constants, state, inputs, now_ns)
        assert all(
            np.array_equal(a, b, equal_nan=True)
            for a, b in zip(leaves(before), leaves(state), strict=True)
        ), "the step wrote into its own past"
        history.append((state, inputs, now_ns, out))
        state = after
        plant.write(out.command)
        plant.advance(now_ns + CONTROL_PERIOD_NS)
        sample = plant.read()
    return constants, history


def test_the_step_is_pure(throw):
    constants, history = throw
    for state, inputs, now_ns, out in history[::7]:
        _, again = control_loop.step(constants, state, inputs, now_ns)
        assert np.array_equal(again.row, out.row)


def one(sample, index):
    values = {}
    for f in fields(sample):
        value = getattr(sample, f.name)
        is_array = not (value is None or isinstance(value, int))
        values[f.name] = value[index : index + 1] if is_array else value
    return type(sample)(**values)


def test_a_machine_of_a_batch_does_what_it_does_alone(throw):
    constants, history = throw
    for index in range(4):
        _, inputs, now_ns, _ = history[0]
        target = inputs.target_m[:1]
        state = control_loop.initial_state(constants, one(inputs.sample, index), target, now_ns)
        for _, inputs, now_ns, out in history:
            alone = ControlInputs(
                one(inputs.sample, index), inputs.motion[index : index + 1], target
            )
            state, mine = control_loop.step(constants, state, alone, now_ns)
            assert np.allclose(
                mine.row["valve_applied_ratio"], out.row["valve_applied_ratio"][index], atol=1e-6
            )
            assert mine.release_commanded[0] == out.release_commanded[index]
            assert mine.aligned[0] == out.aligned[index]


def test_a_throw_of_the_twin_moves_the_arm_within_its_limits(throw):
    _, history = throw
    rows = np.array([out.row for *_, out in history])
    assert (rows["safety_code_count"] & int(safety.CLOSING) == 0).all()
    tracking = rows["joint_velocity_rad_m_per_s"][20:, :2, 1:4]
    assert np.abs(tracking).max() > 0.05


def test_a_refused_release_is_no_release():
    loop = Loop(2, policy=Scripted((0.0, 0.0, 0.0, 1.0)), target=np.array([[30.0, 0.0, 0.0]]))
    sample = at_rest(2, loop.now_ns)
    inputs = ControlInputs(sample, np.array([2, 2]), loop.target, allowed_radius_m=2.5)
    _, out = control_loop.step(loop.params, loop.state, inputs, loop.now_ns)
    assert not out.release_commanded.any() and not out.command.gripper_open.any()
    assert (out.violation_count == int(Violation.RELEASE)).all()
    assert (out.row["safety_code_count"] & safety.Intervention.RELEASE_REFUSED).all()
