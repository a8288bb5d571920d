"""What the safety gate permits in each motion, contradictions of the sensors, and the release."""

import dataclasses

import numpy as np
import pytest

from machine.conventions import Motion
from machine.kinematics import grip_centre
from machine.starts import safe_pose
from runtime.control import safety
from runtime.control.safety import Intervention
from runtime.guard.plausibility import Contradiction
from tests.cases import each
from tests.runtime.control.safety_bench import MIDDLE, SPEC, gate, remember
from tests.runtime.samples import NOW_NS, at_rest


def hold(valve, start, ticks, last=None):
    """One machine in HOLD that began with these valves open, `ticks` ago; `last` is open now."""
    now = np.array([start if last is None else last], dtype=float)
    memory = remember(now, np.array([False]))
    memory = memory._replace(
        hold_start_ratio=np.abs(np.array([start], dtype=float)),
        hold_tick_count=np.array([ticks - 1]),
    )
    sample = dataclasses.replace(at_rest(1), joint_position_rad_m=np.array([MIDDLE]))
    after, out = safety.apply(
        SPEC,
        np.array([valve], dtype=float),
        np.array([False]),
        memory,
        sample,
        np.array([int(Motion.HOLD)]),
        NOW_NS,
    )
    return out.valve_ratio[0], int(out.intervention_count[0]), after


def test_a_machine_that_stands_may_not_be_moved_by_a_hold():
    valve, bits, _ = hold((1.0, 1.0, 1.0, 1.0), (0.0,) * 4, 5)
    assert bits == Intervention.NOT_PERMITTED
    assert valve.tolist() == [0.0] * 4
    assert hold((0.0,) * 4, (0.0,) * 4, 5)[1] == 0


@each("sign", [1.0, -1.0])
def test_a_hold_may_brake_for_two_seconds_ever_less(sign):
    start = (0.5, 0.0, 0.0, 0.0)
    for ticks in (2, 50, 100, 199):
        valve = (sign * 0.6 * (1.0 - ticks / 200) * 0.999, 0.0, 0.0, 0.0)
        assert hold(valve, start, ticks, last=valve)[1] == 0
    valve, bits, _ = hold((sign * 0.6, 0, 0, 0), (sign * 0.5, 0, 0, 0), 100)
    assert bits & Intervention.HOLD_CLIPPED
    assert valve[0] == pytest.approx(sign * 0.3)
    valve, bits, _ = hold((sign * 0.01, 0, 0, 0), (sign * 0.5, 0, 0, 0), 200)
    assert bits == Intervention.NOT_PERMITTED and valve[0] == 0.0


def test_every_hold_begins_with_what_was_open():
    memory = safety.closed_memory(1)._replace(valve_ratio=np.array([[0.4, -0.2, 0.0, 0.0]]))
    sample = dataclasses.replace(at_rest(1), joint_position_rad_m=np.array([MIDDLE]))

    def tick(motion, memory):
        return safety.apply(
            SPEC, memory.valve_ratio, np.array([False]), memory, sample, np.array([int(motion)]), NOW_NS
        )  # fmt: skip

    memory, _ = tick(Motion.HOLD, memory)
    assert memory.hold_start_ratio.tolist() == [[0.4, 0.2, 0.0, 0.0]]
    assert memory.hold_tick_count.tolist() == [1]
    memory, _ = tick(Motion.HOLD, memory)
    assert memory.hold_start_ratio.tolist() == [[0.4, 0.2, 0.0, 0.0]]
    assert memory.hold_tick_count.tolist() == [2]
    for motion in (Motion.ALIGN, Motion.THROW, Motion.SETTLE, Motion.STOP):
        assert tick(motion, memory)[0].hold_tick_count.tolist() == [0]


# Cross-checks and the release


def test_contradictions_close_with_a_bit_each(monkeypatch):
    pairs = {
        Contradiction.JUMP: Intervention.SENSOR_JUMP,
        Contradiction.CLOCK: Intervention.SENSOR_JUMP,
        Contradiction.FROZEN: Intervention.SENSOR_FROZEN,
        Contradiction.FOLLOWING: Intervention.VALVE_CONTRADICTED,
        Contradiction.IMU: Intervention.IMU_CONTRADICTED,
        Contradiction.JUMP | Contradiction.CLOCK: Intervention.SENSOR_JUMP,
    }
    for cause, bit in pairs.items():
        monkeypatch.setattr(
            safety, "check", lambda spec, memory, *_, c=cause: (memory, np.array([int(c)]))
        )
        valve, opened, bits, _ = gate(opens=True)
        assert bits & ~Intervention.GRIPPER_KEPT_CLOSED == bit
        assert valve.tolist() == [0.0] * 4 and not opened


def release(target_m, radius_m, *, was_open=False, motion=Motion.THROW, rate=0.0):
    pose = np.array([safe_pose()])
    velocity = np.zeros((1, 6))
    velocity[0, 4] = rate
    tool = safety.ToolEstimate(pose, velocity, np.array([target_m]), radius_m)
    memory = remember(np.zeros((1, 4)), np.array([was_open]))
    sample = dataclasses.replace(at_rest(1), joint_position_rad_m=pose[:, :4])
    _, out = safety.apply(
        SPEC, np.zeros((1, 4)), np.array([True]), memory, sample, np.array([int(motion)]), NOW_NS, tool
    )  # fmt: skip
    return bool(out.gripper_open[0]), int(out.intervention_count[0])


def test_the_gripper_opens_only_where_the_load_lands_in_the_region():
    below = [*grip_centre(SPEC, np.array([safe_pose()]), np.zeros((1, 6))).position_m[0, :2], 0.0]
    far = [below[0] + 3.0, below[1], 0.0]
    refused = Intervention.GRIPPER_KEPT_CLOSED | Intervention.RELEASE_REFUSED
    assert release(below, 2.5) == (True, 0)
    assert release(far, 2.5) == (False, refused)
    assert release(far, 3.1) == (True, 0)
    assert release(far, np.inf) == (True, 0)
    assert release([np.nan] * 3, 2.5) == (False, refused)
    # What is open stays open: the load is on its way.
    assert release(far, 2.5, was_open=True) == (True, 0)
    assert release(far, 2.5, was_open=True, motion=Motion.SETTLE) == (True, 0)
    assert release(below, 2.5, motion=Motion.HOLD) == (False, Intervention.GRIPPER_KEPT_CLOSED)


def test_limits_of_the_tool_close():
    below = [6.0, 0.0, 0.0]
    assert not release(below, np.inf, rate=1.0)[1] & Intervention.TOOL_LIMIT
    assert release(below, np.inf, rate=9.0)[1] & Intervention.TOOL_LIMIT
