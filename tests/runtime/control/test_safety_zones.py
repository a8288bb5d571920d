"""The gate and exclusion zones: the arm is stopped before it enters, no load flies through."""

import dataclasses
import math

import numpy as np

from machine.conventions import Motion
from machine.spec import load_spec
from machine.starts import safe_pose
from runtime.control import control_loop, safety
from runtime.control.control_loop import ControlInputs, Violation
from runtime.control.safety import Intervention
from runtime.guard.zones import arm_points, prisms_of
from runtime.throw.facts import abort_reason, fault_reason
from tests.runtime.control.test_control_loop import Loop, Scripted
from tests.runtime.guard.test_guard_zones import box
from tests.runtime.samples import NOW_NS, at_rest

SPEC = load_spec()
POSE = np.array([safe_pose()])
TIP_M = arm_points(SPEC, POSE).position_m[0, -1]


def gate(zones, motion=Motion.THROW, slew_rate=0.0, opens=False):
    velocity = np.zeros((1, 6))
    velocity[0, 0] = slew_rate
    target = np.array([[*TIP_M[:2], 0.0]])
    tool = safety.ToolEstimate(POSE, velocity, target, 2.5, prisms_of(zones) if zones else None)
    sample = dataclasses.replace(at_rest(1), joint_position_rad_m=POSE[:, :4])
    _, out = safety.apply(
        SPEC,
        np.full((1, 4), 0.05),
        np.array([opens]),
        safety.closed_memory(1),
        sample,
        np.array([int(motion)]),
        NOW_NS,
        tool,
    )
    return out.valve_ratio[0], bool(out.gripper_open[0]), int(out.intervention_count[0])


def beside(away_m):
    """A zone to the left of the gripper."""
    side = math.atan2(TIP_M[1], TIP_M[0]) + math.pi / 2
    gap = 0.4 + 0.5 * math.sqrt(2.0) + away_m
    return box(TIP_M[0] + gap * math.cos(side), TIP_M[1] + gap * math.sin(side), top_m=6.0)


def test_an_arm_in_a_zone_closes_all_valves():
    valve, _, bits = gate((box(TIP_M[0], TIP_M[1], top_m=6.0),))
    assert bits == Intervention.ARM_IN_ZONE
    assert not valve.any()
    valve, _, bits = gate((beside(0.3),))
    assert bits == 0 and valve.all()


def test_an_arm_that_could_no_longer_stop_is_stopped_now():
    free = (beside(0.9),)
    assert gate(free)[2] == 0
    assert gate(free, slew_rate=0.9)[2] & Intervention.ARM_IN_ZONE
    assert gate(free, slew_rate=-0.9)[2] == 0
    for motion in (Motion.ALIGN, Motion.SETTLE):
        assert gate(free, motion, slew_rate=0.9)[2] & Intervention.ARM_IN_ZONE


def test_no_load_is_released_through_a_zone():
    assert gate((), opens=True)[1:] == (True, 0)
    under = (box(TIP_M[0], TIP_M[1], half_m=0.2, top_m=0.3),)
    assert gate(under)[2] == 0
    refused = (
        Intervention.GRIPPER_KEPT_CLOSED
        | Intervention.RELEASE_REFUSED
        | Intervention.FLIGHT_IN_ZONE
    )
    assert gate(under, opens=True)[1:] == (False, refused)
    aside = (box(TIP_M[0] + 3.0, TIP_M[1], half_m=0.2, top_m=0.3),)
    assert gate(aside, opens=True)[1:] == (True, 0)


def test_the_control_step_says_what_the_zones_did():
    loop = Loop(2, policy=Scripted((0.0, 0.0, 0.0, 1.0)), target=np.array([[30.0, 0.0, 0.0]]))
    sample = at_rest(2, loop.now_ns)
    reach = float(np.hypot(*TIP_M[:2]))
    ring = tuple(
        (r * reach * math.cos(a), r * reach * math.sin(a))
        for r, turn in ((1.3, 1), (0.7, -1))
        for a in np.linspace(math.pi, math.pi + 6.2, 11)[::turn]
    )
    low = prisms_of((box(0.0, 0.0).model_copy(update={"corners_m": ring, "top_m": 0.2}),))
    inputs = ControlInputs(sample, np.array([2, 2]), loop.target, zones=low)
    _, out = control_loop.step(loop.params, loop.state, inputs, loop.now_ns)
    assert not out.release_commanded.any() and not out.command.gripper_open.any()
    assert (out.violation_count & int(Violation.ZONE)).all()
    assert "exclusion zone" in abort_reason(int(out.violation_count[0]), 1.35)
    high = low._replace(top_m=np.array([9.0]))
    _, out = control_loop.step(
        loop.params, loop.state, dataclasses.replace(inputs, zones=high), loop.now_ns
    )
    assert (out.row["safety_code_count"] & int(Intervention.ARM_IN_ZONE)).all()
    assert "exclusion zone" in fault_reason(int(out.row["safety_code_count"][0]))
    assert not out.command.valve_ratio.any() and not out.command.supply_enabled.any()
