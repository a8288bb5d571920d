import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from machine.conventions import Motion
from runtime.control import safety
from runtime.control.safety import Intervention
from tests.cases import each
from tests.runtime.control.safety_bench import (
    ACCELERATION,
    HIGH,
    LOW,
    MIDDLE,
    NEGATIVE,
    POSITIVE,
    SPEC,
    gate,
    remember,
)
from tests.runtime.samples import NOW_NS, at_rest


def test_an_ordinary_request_passes_unchanged():
    valve, opened, bits, memory = gate((0.3, -0.2, 0.1, 0.0))
    assert valve.tolist() == [0.3, -0.2, 0.1, 0.0]
    assert (opened, bits) == (False, 0)
    assert memory.valve_ratio.tolist() == [[0.3, -0.2, 0.1, 0.0]]


def test_memory_starts_closed():
    memory = safety.closed_memory(3)
    assert memory.valve_ratio.tolist() == [[0.0] * 4] * 3
    assert memory.gripper_open.tolist() == [False] * 3


@each("age_ms, closed", [(-1, True), (0, False), (50, False), (51, True)])
def test_sensors_may_be_50_ms_old(age_ms, closed):
    valve, _, bits, memory = gate(now_ns=NOW_NS + age_ms * 1_000_000)
    assert (bits == Intervention.STALE_SENSORS) is closed
    assert (valve == 0.0).all() == closed
    assert (memory.valve_ratio == 0.0).all() == closed


def test_one_nanosecond_too_old_is_too_old():
    assert gate(now_ns=NOW_NS + 50_000_001)[2] == Intervention.STALE_SENSORS
    assert gate(now_ns=NOW_NS - 1)[2] == Intervention.STALE_SENSORS


@each("field", ["joint_position_rad_m", "joint_velocity_rad_m_per_s"])
@each("bad", [np.nan, np.inf, -np.inf])
@each("joint", range(4))
def test_a_sensor_that_is_no_number_closes_everything(field, bad, joint):
    values = MIDDLE.copy() if field == "joint_position_rad_m" else np.zeros(4)
    values[joint] = bad
    valve, _, bits, _ = gate(**{field: values})
    assert bits & Intervention.NOT_FINITE
    assert valve.tolist() == [0.0] * 4


@each("joint", range(4))
@each("bad", [np.nan, np.inf])
def test_a_request_or_memory_that_is_no_number_closes_everything(joint, bad):
    request = [0.1] * 4
    request[joint] = bad
    valve, _, bits, _ = gate(request, last=[0.0] * 4)
    assert bits == Intervention.NOT_FINITE
    assert valve.tolist() == [0.0] * 4
    valve, _, bits, memory = gate(last=request)
    assert bits == Intervention.NOT_FINITE
    assert memory.valve_ratio.tolist() == [[0.0] * 4]


@each("field", ["joint_position_rad_m", "joint_velocity_rad_m_per_s"])
def test_no_joint_that_is_a_number_closes_everything(field):
    valve, _, bits, _ = gate((0.3, 0.0, 0.0, 0.0), **{field: np.full(4, np.nan)})
    assert bits & Intervention.NOT_FINITE
    assert valve.tolist() == [0.0] * 4


def test_each_reason_is_a_bit_of_its_own():
    """Logs keep the bits for years."""
    assert [reason.value for reason in Intervention] == [2**n for n in range(len(Intervention))]


def test_opposite_infinities_do_not_cancel():
    valve, _, bits, _ = gate(
        (np.inf, 0, 0, 0), last=[0.0] * 4, joint_velocity_rad_m_per_s=[-np.inf, 0, 0, 0]
    )
    assert bits & Intervention.NOT_FINITE
    assert valve.tolist() == [0.0] * 4


def test_switches_close():
    assert gate(local_enable=False)[2] == Intervention.LOCAL_DISABLED
    assert gate(local_enable=False)[0].tolist() == [0.0] * 4
    assert gate(emergency_stop=True)[2] == Intervention.EMERGENCY_STOP
    assert gate(emergency_stop=True)[0].tolist() == [0.0] * 4


@each(
    "motion, stopped",
    [(-1, True), (0, False), (1, False), (2, False), (3, False), (4, True), (5, True)],
)
def test_stop_and_unknown_motions_close(motion, stopped):
    valve, _, bits, _ = gate(motion=motion)
    assert (bits == Intervention.STOPPED) is stopped
    assert (valve == 0.0).all() == stopped


@each("joint", range(4))
@each("sign", [1.0, -1.0])
def test_over_speed_from_one_and_a_half_times_the_limit(joint, sign):
    limit = 1.5 * (POSITIVE if sign > 0 else NEGATIVE)[joint]
    # Move away from the limit that this speed approaches, so that only the speed counts.
    position = np.where(sign > 0, np.maximum(LOW, -9.0), np.minimum(HIGH, 9.0)) + sign * 0.02
    velocity = np.zeros(4)
    velocity[joint] = sign * limit
    assert (
        gate((0, 0, 0, 0), joint_velocity_rad_m_per_s=velocity, joint_position_rad_m=position)[2]
        == 0
    )
    velocity[joint] = sign * (limit + 1e-6)
    valve, _, bits, _ = gate(
        (0.1,) * 4, joint_velocity_rad_m_per_s=velocity, joint_position_rad_m=position
    )
    assert bits == Intervention.OVER_SPEED
    assert valve.tolist() == [0.0] * 4


@each("joint", range(4))
def test_range(joint):
    request = np.zeros(4)
    for value, expected in ((1.0, 1.0), (1.0 + 1e-9, 1.0), (-1.0, -1.0), (-1.0 - 1e-9, -1.0)):
        request[joint] = value
        last = np.zeros(4)
        last[joint] = np.clip(value, -1, 1)
        valve, _, bits, _ = gate(request, last=last)
        assert valve[joint] == expected
        assert bits == (Intervention.RANGE_CLIPPED if abs(value) > 1.0 else 0)


@each("joint", range(4))
@each("sign", [1.0, -1.0])
def test_rate(joint, sign):
    last, request = np.zeros(4), np.zeros(4)
    last[joint] = sign * 0.3
    request[joint] = sign * 0.5
    assert gate(request, last=last)[2] == 0
    request[joint] = sign * 0.51
    valve, _, bits, _ = gate(request, last=last)
    assert bits == Intervention.RATE_CLIPPED
    assert valve[joint] == pytest.approx(sign * 0.5)
    request[joint] = sign * 0.05
    valve, _, bits, _ = gate(request, last=last)
    assert bits == Intervention.RATE_CLIPPED
    assert valve[joint] == pytest.approx(sign * 0.1)


@each("joint", [1, 2, 3])
@each("sign", [1.0, -1.0])
@each("speed_share", [0.0, 0.5, 1.0, 1.4])
@each("recent", [0.0, 0.3, 1.0])
def test_a_joint_about_to_hit_its_limit(joint, sign, speed_share, recent):
    speed = speed_share * (POSITIVE if sign > 0 else NEGATIVE)[joint]
    fastest = 1.5 * (POSITIVE if sign > 0 else NEGATIVE)[joint]
    later = min(speed + safety.STOP_DELAY_S * ACCELERATION[joint], recent * fastest)
    later = max(speed, later)
    stop = later * safety.STOP_DELAY_S + later**2 / (2.0 * ACCELERATION[joint])
    edge = (HIGH if sign > 0 else LOW)[joint] - sign * (safety.LIMIT_MARGIN_RAD_M + stop)
    velocity, request = np.zeros(4), np.zeros(4)
    velocity[joint], request[joint] = sign * speed, sign * 0.5
    for offset, stops in ((-1e-6, False), (1e-6, True)):
        position = MIDDLE.copy()
        position[joint] = edge + sign * offset
        known = {
            "joint_position_rad_m": position,
            "joint_velocity_rad_m_per_s": velocity,
            "recent": recent,
        }
        valve, _, bits, _ = gate(request, **known)
        assert (bits == Intervention.POSITION_LIMIT) is stops
        assert valve[joint] == (0.0 if stops else sign * 0.5)
        # Away from the limit is always allowed.
        assert gate(-request, **known)[2] == 0
        # A closed valve needs no intervention.
        assert gate(0.0 * request, **known)[2] == 0


@each("joint", [1, 2, 3])
@each("sign", [1.0, -1.0])
def test_speed_away_from_a_limit_does_not_count(joint, sign):
    position, velocity, request = MIDDLE.copy(), np.zeros(4), np.zeros(4)
    limit = (HIGH if sign > 0 else LOW)[joint]
    position[joint] = limit - sign * (safety.LIMIT_MARGIN_RAD_M + 1e-6)
    velocity[joint], request[joint] = -sign * 0.3, sign * 0.5
    assert gate(request, joint_position_rad_m=position, joint_velocity_rad_m_per_s=velocity)[2] == 0


@each("value", [0.7, -0.7])
def test_what_was_let_through_is_remembered_for_a_tenth_of_a_second(value):
    _, _, _, memory = gate((value, 0, 0, 0))
    up = max(memory.recent_up_ratio[0, 0], 0.0)
    down = max(memory.recent_down_ratio[0, 0], 0.0)
    assert (up, down) == ((0.7, 0.0) if value > 0 else (0.0, 0.7))
    for tick in range(1, 9):
        memory, _ = safety.apply(
            SPEC, np.zeros((1, 4)), np.array([False]), memory, at_rest(1), np.array([2]), NOW_NS
        )
        left = max(memory.recent_up_ratio[0, 0], memory.recent_down_ratio[0, 0])
        assert left == pytest.approx(max(0.7 - 0.1 * tick, abs(memory.valve_ratio[0, 0])))


def test_a_position_limit_closes_faster_than_the_rate():
    position = MIDDLE.copy()
    position[1] = HIGH[1]
    valve, _, bits, _ = gate((0, 0.9, 0, 0), joint_position_rad_m=position)
    assert bits == Intervention.POSITION_LIMIT
    assert valve[1] == 0.0


def test_slew_has_no_position_limit():
    valve, _, bits, _ = gate((0.5, 0, 0, 0), joint_position_rad_m=[400.0, *MIDDLE[1:]])
    assert (valve[0], bits) == (0.5, 0)


@each("motion", list(Motion))
@each("was_open", [False, True])
def test_gripper_opens_in_a_throw_and_stays_open_while_settling(motion, was_open):
    _, opened, bits, memory = gate(opens=True, motion=motion, was_open=was_open)
    allowed = motion is Motion.THROW or (motion is Motion.SETTLE and was_open)
    assert opened is allowed
    assert memory.gripper_open.tolist() == [allowed]
    assert bool(bits & Intervention.GRIPPER_KEPT_CLOSED) is not allowed


def test_gripper_closes_when_not_asked_to_open_and_when_anything_closes():
    assert gate(opens=False, was_open=True)[1] is False
    _, opened, bits, _ = gate(opens=True, local_enable=False)
    assert not opened
    assert bits == Intervention.LOCAL_DISABLED | Intervention.GRIPPER_KEPT_CLOSED


def test_after_closing_the_valves_open_only_through_the_rate():
    _, _, _, memory = gate((0.8, 0, 0, 0), emergency_stop=True)
    valve, _, bits, _ = gate((0.8, 0, 0, 0), last=memory.valve_ratio[0])
    assert valve[0] == pytest.approx(safety.VALVE_STEP_RATIO)
    assert bits == Intervention.RATE_CLIPPED


def test_a_closed_machine_reports_no_clipping():
    _, _, bits, _ = gate((3.0, 0, 0, 0), last=[0.0] * 4, local_enable=False)
    assert bits == Intervention.LOCAL_DISABLED


def test_machines_of_a_batch_do_not_see_each_other():
    sample = at_rest(3)
    enable = np.array([True, False, True])
    sample = dataclasses.replace(
        sample, local_enable=enable, joint_position_rad_m=np.tile(MIDDLE, (3, 1))
    )
    request = np.full((3, 4), 0.1)
    request[2, 0] = np.nan
    memory = remember(np.full((3, 4), 0.1), np.zeros(3, dtype=np.bool_))
    _, out = safety.apply(
        SPEC, request, np.ones(3, dtype=np.bool_), memory, sample, np.full(3, 2), NOW_NS
    )
    assert out.valve_ratio.tolist() == [[0.1] * 4, [0.0] * 4, [0.0] * 4]
    assert out.gripper_open.tolist() == [True, False, False]
    assert out.intervention_count[0] == 0


@each("bit", list(Intervention))
def test_which_bits_close_and_which_are_faults(bit):
    closing = {1, 2, 4, 8, 16, 32, 1024, 2048, 4096, 8192, 16384, 32768, 262144}
    assert bool(bit & safety.CLOSING) is (int(bit) in closing)
    assert bool(bit & safety.LATCHING) is (int(bit) in closing - {4, 8, 32})


WILD = st.floats(allow_nan=True, allow_infinity=True, width=64)


@settings(max_examples=120, deadline=None)
@given(
    request=arrays(np.float64, (5, 4), elements=WILD),
    last=arrays(np.float64, (5, 4), elements=WILD),
    position=arrays(np.float64, (5, 4), elements=WILD),
    velocity=arrays(np.float64, (5, 4), elements=st.floats(-2, 2) | WILD),
    motion=arrays(np.int64, 5, elements=st.integers(-2, 6)),
    enable=arrays(np.bool_, 5),
    stop=arrays(np.bool_, 5),
    opens=arrays(np.bool_, 5),
    was_open=arrays(np.bool_, 5),
    recent=st.floats(0.0, 1.0) | WILD,
    age_ns=st.integers(-100, 200_000_000),
)
def test_whatever_comes_the_output_is_allowed(
    request, last, position, velocity, motion, enable, stop, opens, was_open, recent, age_ns
):
    sample = dataclasses.replace(
        at_rest(5),
        joint_position_rad_m=position,
        joint_velocity_rad_m_per_s=velocity,
        local_enable=enable,
        emergency_stop=stop,
    )
    memory, out = safety.apply(
        SPEC, request, opens, remember(last, was_open, recent), sample, motion, NOW_NS + age_ns
    )
    valve, bits = out.valve_ratio, out.intervention_count
    assert np.isfinite(valve).all() and (np.abs(valve) <= 1.0).all()
    finite = (
        np.isfinite(request) & np.isfinite(last) & np.isfinite(position) & np.isfinite(velocity)
    )
    moving = (motion >= 0) & (motion < 4)
    must_close = ~finite.all(axis=1) | ~enable | stop | ~moving | (not 0 <= age_ns <= 50_000_000)
    assert (valve[must_close] == 0.0).all() and not out.gripper_open[must_close].any()
    closing = (bits & int(safety.CLOSING)) != 0
    assert (closing | ~must_close).all()
    assert (valve[closing] == 0.0).all()
    # Never another sign than asked for, except while the rate limit still lets go of the last output.
    eased = np.abs(last) > 0.0
    assert ((np.sign(valve) == np.sign(request)) | (valve == 0.0) | eased)[~closing].all()
    assert (
        ~out.gripper_open | (motion == Motion.THROW) | ((motion == Motion.SETTLE) & was_open)
    ).all()
    assert (memory.valve_ratio == valve).all()


@each("joint", [1, 2, 3])
@each("sign", [1.0, -1.0])
def test_a_gated_joint_stops_before_its_limit(joint, sign):
    """Joints that obey their acceleration and a dead time of 80 ms, pushed at a limit by a mad request."""
    count, top = 40, (POSITIVE if sign > 0 else NEGATIVE)[joint]
    low, high = LOW[joint], HIGH[joint]
    q = np.linspace(low + 0.35, high - 0.35, count)
    v = sign * top * np.linspace(0.0, 1.0, count)[np.random.default_rng(1).permutation(count)]
    pipeline = [np.zeros(count)] * 8
    memory = safety.closed_memory(count)
    request = np.zeros((count, 4))
    request[:, joint] = sign
    sample = at_rest(count)
    pose, rate = np.tile(MIDDLE, (count, 1)), np.zeros((count, 4))
    closest = np.inf
    for _ in range(700):
        pose[:, joint], rate[:, joint] = q, v
        sample = dataclasses.replace(
            sample, joint_position_rad_m=pose, joint_velocity_rad_m_per_s=rate
        )
        memory, out = safety.apply(
            SPEC, request, np.zeros(count, np.bool_), memory, sample, np.full(count, 2), NOW_NS
        )
        pipeline.append(out.valve_ratio[:, joint])
        change = ACCELERATION[joint] * 0.01
        v = v + np.clip(pipeline.pop(0) * top - v, -change, change)
        q = q + v * 0.01
        closest = min(closest, float(np.min(high - q if sign > 0 else q - low)))
    assert 0.0 <= closest < 0.1
