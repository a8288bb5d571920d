"""One machine through the safety gate."""

import dataclasses

import numpy as np

from machine.conventions import Motion
from machine.spec import load_spec
from runtime.control import safety
from tests.runtime.samples import NOW_NS, at_rest

SPEC = load_spec()
POSITIVE = np.asarray(SPEC.limits.speed_positive_rad_m_per_s)
NEGATIVE = np.asarray(SPEC.limits.speed_negative_rad_m_per_s)
ACCELERATION = np.asarray(SPEC.limits.acceleration_rad_m_per_s2)
LOW, HIGH = SPEC.position_range_rad_m
MIDDLE = np.array([0.0, 0.6, 0.0, 0.8])


def remember(last, was_open, recent=0.0):
    """Memory with these last valves (N, 4); `recent` is what the last 0.1 s held in both directions."""
    held = np.full_like(last, recent)
    closed = safety.closed_memory(len(last))
    return closed._replace(
        valve_ratio=last,
        recent_up_ratio=held,
        recent_down_ratio=held,
        gripper_open=was_open,
        hold_start_ratio=np.ones_like(last),
        hold_tick_count=np.ones(len(last), dtype=np.int64),
    )


def gate(
    valve=(0.1, 0.1, 0.1, 0.1),
    *,
    opens=False,
    last=None,
    was_open=False,
    recent=0.0,
    motion=Motion.THROW,
    now_ns=NOW_NS,
    **sample,
):
    """One machine through the gate; returns valves (4,), gripper, bits, memory."""
    given_sample = at_rest(1)
    position = np.array([MIDDLE])
    given_sample = dataclasses.replace(given_sample, joint_position_rad_m=position)
    sample = {
        name: np.asarray([value]) if name != "t_mono_ns" else value
        for name, value in sample.items()
    }
    given_sample = dataclasses.replace(given_sample, **sample)
    last = np.asarray([valve if last is None else last], dtype=np.float64)
    memory = remember(last, np.array([was_open]), recent)
    after, out = safety.apply(
        SPEC,
        np.asarray([valve], dtype=np.float64),
        np.array([opens]),
        memory,
        given_sample,
        np.array([int(motion)]),
        now_ns,
    )
    assert out.valve_ratio is after.valve_ratio
    return out.valve_ratio[0], bool(out.gripper_open[0]), int(out.intervention_count[0]), after
