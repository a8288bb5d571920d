import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from machine.calibration import ValveCalibration, ValveTable, actuator_ratio, nominal_calibration
from machine.spec import load_spec
from machine.starts import safe_pose
from runtime.control import velocity_controller
from runtime.control.velocity_controller import (
    VelocityController,
    flow_demand_m3_per_s,
    shape_reference,
)
from tests.cases import each

SPEC = load_spec()
POSITIVE = np.asarray(SPEC.limits.speed_positive_rad_m_per_s)
NEGATIVE = np.asarray(SPEC.limits.speed_negative_rad_m_per_s)
ACCELERATION = np.asarray(SPEC.limits.acceleration_rad_m_per_s2)
LOW, HIGH = SPEC.position_range_rad_m
POSE = safe_pose()[None, :4]
TICK_S = 0.01


def magnitude(position):
    return np.abs(actuator_ratio(SPEC, position))


def run(request, ticks=400, position=POSE, reference=None):
    """References of a steady request at a fixed pose (ticks, N, 4)."""
    request = np.atleast_2d(np.asarray(request, dtype=np.float64))
    reference = np.zeros_like(request) if reference is None else reference
    seen = []
    for _ in range(ticks):
        reference = shape_reference(SPEC, request, reference, position, TICK_S)
        seen.append(reference)
    return np.array(seen)


def test_a_slow_request_is_reached_and_kept():
    seen = run([0.1, -0.05, 0.05, 0.03])
    assert np.allclose(seen[-1], [0.1, -0.05, 0.05, 0.03])
    assert np.allclose(seen[0], np.sign([1, -1, 1, 1]) * ACCELERATION * TICK_S)


@each("joint", range(4))
@each("sign", [1.0, -1.0])
def test_one_fast_joint_reaches_its_speed_limit_or_the_pump_s(joint, sign):
    request = np.zeros(4)
    request[joint] = sign * 5.0
    reference = run(request)[-1, 0]
    limit = (POSITIVE if sign > 0 else NEGATIVE)[joint]
    demand = flow_demand_m3_per_s(SPEC, reference[None], magnitude(POSE))[0]
    at_limit = abs(reference[joint]) == pytest.approx(limit)
    at_flow = demand == pytest.approx(0.9 * SPEC.hydraulics.pump_flow_m3_per_s)
    assert at_limit or at_flow
    assert abs(reference[joint]) <= limit + 1e-12
    assert np.delete(reference, joint).tolist() == [0.0] * 3


def test_flow_of_one_joint_by_hand():
    ratio = magnitude(POSE)[0]
    boom, dipper = SPEC.hydraulics.boom_cylinder, SPEC.hydraulics.dipper_cylinder
    bore = np.pi / 4 * boom.bore_m**2
    ring = bore - np.pi / 4 * boom.rod_m**2
    dipper_bore = np.pi / 4 * dipper.bore_m**2
    dipper_ring = dipper_bore - np.pi / 4 * dipper.rod_m**2
    tele = np.pi / 4 * SPEC.hydraulics.telescope_bore_m**2
    cases = {
        (0.5, 0, 0, 0): 0.5 * SPEC.hydraulics.slew_displacement_m3_per_rad,
        (-0.5, 0, 0, 0): 0.5 * SPEC.hydraulics.slew_displacement_m3_per_rad,
        (0, 0.2, 0, 0): 0.2 * ratio[1] * bore,
        (0, -0.2, 0, 0): 0.2 * ratio[1] * ring,
        (0, 0, 0.2, 0): 0.2 * ratio[2] * dipper_ring,
        (0, 0, -0.2, 0): 0.2 * ratio[2] * dipper_bore,
        (0, 0, 0, 0.2): 0.2 * tele,
    }
    for velocity, flow in cases.items():
        found = flow_demand_m3_per_s(SPEC, np.array([velocity], dtype=float), magnitude(POSE))[0]
        assert found == pytest.approx(flow)


def test_all_joints_at_once_share_the_pump_in_the_proportion_they_asked_for():
    reference = run([0.9, 0.4, 0.6, 0.4])[-1, 0]
    assert np.allclose(reference / reference[0], np.array([0.9, 0.4, 0.6, 0.4]) / 0.9)
    demand = flow_demand_m3_per_s(SPEC, reference[None], magnitude(POSE))[0]
    assert demand == pytest.approx(0.9 * SPEC.hydraulics.pump_flow_m3_per_s)


SPEEDS = arrays(np.float64, (6, 4), elements=st.floats(-3.0, 3.0))


@settings(max_examples=100, deadline=None)
@given(request=SPEEDS, seed=st.integers(0, 1000))
def test_a_reference_is_always_one_the_machine_can_follow(request, seed):
    rng = np.random.default_rng(seed)
    low, high = np.maximum(LOW, -9.0), np.minimum(HIGH, 9.0)
    position = rng.uniform(low, high, (6, 4))
    reference = np.zeros((6, 4))
    for tick in range(60):
        wish = request if tick < 30 else -request[::-1]
        before, reference = reference, shape_reference(SPEC, wish, reference, position, TICK_S)
        assert (reference <= POSITIVE + 1e-12).all() and (reference >= -NEGATIVE - 1e-12).all()
        demand = flow_demand_m3_per_s(SPEC, reference, magnitude(position))
        assert (demand <= 0.9 * SPEC.hydraulics.pump_flow_m3_per_s + 1e-12).all()
        # Speeding up never exceeds the acceleration; slowing down may, when another joint takes the flow.
        gain = np.abs(reference) - np.abs(before)
        assert (gain <= ACCELERATION * TICK_S + 1e-12).all()


@each("joint", [1, 2, 3])
@each("sign", [1.0, -1.0])
def test_references_stop_before_position_limits(joint, sign):
    """A joint that follows its reference late, by dead time and lag, never reaches the limit."""
    position = POSE.copy()
    position[0, joint] = 0.5 * (LOW[joint] + HIGH[joint])
    request, reference = np.zeros((1, 4)), np.zeros((1, 4))
    request[0, joint] = sign * 5.0
    pipeline, speed = [0.0] * 8, 0.0
    for _ in range(1500):
        reference = shape_reference(SPEC, request, reference, position, TICK_S)
        pipeline.append(reference[0, joint])
        speed += 0.1 * (pipeline.pop(0) - speed)
        position[0, joint] += speed * TICK_S
    left = (HIGH[joint] - position[0, joint]) if sign > 0 else (position[0, joint] - LOW[joint])
    assert 0.0 < left < 0.05
    back = shape_reference(SPEC, -request, reference, position, TICK_S)
    assert np.sign(back[0, joint]) != np.sign(request[0, joint])


def test_beyond_a_limit_only_the_way_back_is_open():
    position = POSE.copy()
    position[0, 1] = HIGH[1] + 0.01
    assert run([0, 0.4, 0, 0], 50, position)[-1, 0, 1] == 0.0
    assert run([0, -0.2, 0, 0], 50, position)[-1, 0, 1] == pytest.approx(-0.2)


def test_the_trainer_gets_the_same_reference():
    rng = np.random.default_rng(2)
    request, previous = rng.normal(0, 0.5, (2, 40, 4))
    position = np.tile(POSE, (40, 1)) + rng.normal(0, 0.3, (40, 4))
    given_32 = [x.astype(np.float32) for x in (request, previous, position)]
    compiled = jax.jit(lambda r, p, q: shape_reference(SPEC, r, p, q, TICK_S))(*given_32)
    plain = shape_reference(SPEC, *(x.astype(np.float64) for x in given_32), TICK_S)
    assert compiled.dtype == np.float32
    assert np.allclose(np.asarray(compiled), plain, atol=2e-6)


# The controller


def wrong_by(factor: float) -> ValveCalibration:
    """Tables of a machine whose speeds are `factor` times the nominal ones."""
    nominal = nominal_calibration(SPEC)
    tables = [
        ValveTable(
            valve_ratio=t.valve_ratio,
            actuator_speed_rad_m_per_s=tuple(factor * s for s in t.actuator_speed_rad_m_per_s),
        )
        for t in nominal.tables
    ]
    return nominal.model_copy(update={"tables": tuple(tables)})


class Plant:
    """Dead time and first-order lag around a valve table in actuator space."""

    def __init__(self, calibration, count=1):
        self.tables = calibration.tables
        self.pipeline = [np.zeros((count, 4))] * 9
        self.speed = np.zeros((count, 4))
        self.ratio = np.tile(magnitude(POSE), (count, 1))

    def step(self, valve):
        self.pipeline = [valve, *self.pipeline[:-1]]
        late = self.pipeline[-1]
        steady = np.stack(
            [
                np.interp(late[:, j], t.valve_ratio, t.actuator_speed_rad_m_per_s)
                for j, t in enumerate(self.tables)
            ],
            axis=1,
        )
        self.speed = self.speed + 0.1 * (steady / self.ratio - self.speed)


def closed_loop(factor, reference, ticks=600):
    controller = VelocityController(SPEC, nominal_calibration(SPEC))
    plant, state = Plant(wrong_by(factor)), controller.initial(1)
    speeds, valves = [], []
    for tick in range(ticks):
        wish = np.asarray(reference(tick * TICK_S), dtype=float)[None]
        state, valve = controller.update(state, wish, plant.speed, plant.ratio)
        plant.step(valve)
        speeds.append(plant.speed[0])
        valves.append(valve[0])
    return np.array(speeds), np.array(valves), state


WISH = np.array([0.3, 0.15, -0.2, 0.2])


def test_with_the_right_table_the_feed_forward_alone_is_right():
    speeds, _, state = closed_loop(1.0, lambda t: WISH)
    assert np.allclose(speeds[-1], WISH, atol=2e-3)
    assert np.abs(state.integral).max() < 0.02


@each("factor", [0.85, 1.15])
def test_feedback_takes_a_wrong_table_s_error_away(factor):
    first, _, _ = closed_loop(factor, lambda t: WISH, 60)
    last, _, _ = closed_loop(factor, lambda t: WISH, 1500)
    assert np.abs(first[-1] - WISH).max() > 0.02
    assert np.allclose(last[-1], WISH, atol=0.006)


def test_a_standing_machine_s_valves_are_closed_whatever_the_sensors_whisper():
    controller = VelocityController(SPEC, nominal_calibration(SPEC))
    state, rng = controller.initial(1), np.random.default_rng(0)
    for _ in range(300):
        noise = rng.normal(0.0, 0.01, (1, 4))
        state, valve = controller.update(state, np.zeros((1, 4)), noise, magnitude(POSE))
        assert valve.tolist() == [[0.0] * 4]


def test_the_valve_does_not_jump_across_its_dead_band_at_zero():
    controller = VelocityController(SPEC, nominal_calibration(SPEC))
    before = None
    for speed in np.linspace(-0.02, 0.02, 161):
        reference = np.full((1, 4), speed)
        _, valve = controller.update(controller.initial(1), reference, reference, np.ones((1, 4)))
        if before is not None:
            assert (np.abs(valve - before) < 0.03).all()
        before = valve
    _, valve = controller.update(
        controller.initial(1), np.full((1, 4), 0.03), np.zeros((1, 4)), np.ones((1, 4))
    )
    assert (valve > SPEC.hydraulics.valve_dead_band_ratio * 0.8).all()


def test_the_integrator_does_not_wind_up_at_a_full_valve():
    fast = np.array([1.4, 0.7, 1.0, 0.7])
    _, valves, state = closed_loop(0.6, lambda t: fast, 500)
    assert valves[-1].max() == 1.0
    limit = velocity_controller.INTEGRAL_LIMIT_RATIO * np.minimum(POSITIVE, NEGATIVE)
    assert (np.abs(state.integral) <= limit + 1e-12).all()
    assert np.abs(state.integral[0]).max() < 0.05


def test_forgetting_leaves_other_machines_alone():
    controller = VelocityController(SPEC, nominal_calibration(SPEC))
    state = controller.initial(2)
    for _ in range(30):
        state, _ = controller.update(
            state, np.full((2, 4), 0.1), np.zeros((2, 4)), np.tile(magnitude(POSE), (2, 1))
        )
    after = state.forget(np.array([True, False]))
    for now, then in zip(after, state, strict=True):
        machine = now.ndim - 2
        assert not np.take(now, 0, axis=machine).any()
        assert np.array_equal(np.take(now, 1, axis=machine), np.take(then, 1, axis=machine))


def test_machines_of_a_batch_do_not_see_each_other():
    controller = VelocityController(SPEC, nominal_calibration(SPEC))
    rng = np.random.default_rng(5)
    both, one = controller.initial(2), controller.initial(1)
    for _ in range(40):
        reference, speed = rng.normal(0, 0.2, (2, 2, 4))
        ratio = np.tile(magnitude(POSE), (2, 1))
        both, valves = controller.update(both, reference, speed, ratio)
        one, alone = controller.update(one, reference[1:], speed[1:], ratio[1:])
        assert np.array_equal(valves[1:], alone)
