"""Joints that stick: when they break loose, how they then move, and when they come to rest again."""

import numpy as np
import pytest

from machine.conventions import Array
from sim_twin.effects.effect import Effect
from sim_twin.effects.stiction import UNSURE_RATIO, VALVE_SHARE_RATIO
from tests.sim_twin.effects.test_valve_effects import (
    CALIBRATION,
    PROFILE,
    TELESCOPE,
    drive,
    effect,
    step_command,
)

MEAN_LAG_TICKS = 200.0 * PROFILE.damping_ratio[3] / PROFILE.natural_frequency_rad_per_s[3]


def sticks(breakaway_rad_m_per_s: float) -> Effect:
    return effect("stiction", breakaway_rad_m_per_s=breakaway_rad_m_per_s)


def ramp(ticks: int = 300) -> Array:
    valve = np.zeros((ticks, 4))
    valve[:, TELESCOPE] = np.linspace(0.0, 0.6, ticks)
    return valve


def steady_speed(valve: Array) -> Array:
    table = CALIBRATION.tables[TELESCOPE]
    return np.interp(valve[:, TELESCOPE], table.valve_ratio, table.actuator_speed_rad_m_per_s)


def first_motion(velocity: Array) -> int:
    return int(np.flatnonzero(velocity)[0])


def test_a_sticking_joint_waits_for_the_breakaway_speed() -> None:
    valve = ramp()
    stuck = drive(valve, sticks(0.1), dead_s=0.0)[:, TELESCOPE]
    first, reached = first_motion(stuck), np.flatnonzero(steady_speed(valve) > 0.1)[0]
    # What pushes is as late as the valve, and the load, with less of the lag, later.
    assert first == pytest.approx(reached + VALVE_SHARE_RATIO * MEAN_LAG_TICKS, abs=2.0)


def test_a_joint_that_breaks_loose_soon_moves_as_if_it_had_never_stuck() -> None:
    """Valve and oil went on while it stood."""
    stuck = drive(ramp(), sticks(0.1), dead_s=0.0)[:, TELESCOPE]
    free = drive(ramp(), dead_s=0.0)[:, TELESCOPE]
    first = first_motion(stuck)
    assert free[first] > 0.08
    assert stuck[first] == pytest.approx((1.0 - np.exp(-1.0)) * free[first])
    np.testing.assert_allclose(stuck[first + 6 :], free[first + 6 :], rtol=2e-3)


def test_a_moving_joint_with_too_small_a_command_comes_to_rest() -> None:
    valve = np.concatenate([step_command(0.5, ticks=100), step_command(0.06, ticks=300)])
    assert drive(valve)[-1, TELESCOPE] > 0.005
    stuck = drive(valve, sticks(0.05))
    assert stuck[99, TELESCOPE] > 0.15
    assert stuck[-1, TELESCOPE] > 0.0, "slow, but never slow enough to stop"
    closed = np.concatenate([step_command(0.5, ticks=100), step_command(0.0, ticks=300)])
    assert drive(closed, sticks(0.05))[-1, TELESCOPE] == 0.0


def test_a_joint_that_sticks_comes_to_rest_when_the_measured_one_did() -> None:
    valve = np.concatenate([step_command(0.5, ticks=100), step_command(0.06, ticks=300)])
    stood = np.full(valve.shape, 0.1)
    stood[250:260] = 0.0
    stuck = drive(valve, sticks(0.05), seen=stood)[:, TELESCOPE]
    assert stuck[249] > 0.005
    assert not stuck[250:].any(), "it stays until the valve asks for more"
    closed = np.concatenate([step_command(0.5, ticks=100), step_command(0.0, ticks=300)])
    never = drive(closed, sticks(0.05), seen=np.full(closed.shape, 0.1))
    np.testing.assert_allclose(never[100:], drive(closed)[100:], atol=1e-4)
    reversed_ = np.where(np.arange(400)[:, None] < 250, 0.1, -0.1) * np.ones(4)
    assert not drive(valve, sticks(0.05), seen=reversed_)[250:, TELESCOPE].any()
    np.testing.assert_array_equal(drive(valve, seen=stood), drive(valve))


def test_near_its_breakaway_a_joint_is_loose_when_the_measured_one_was() -> None:
    """Static friction is not the same each time; further away the command decides alone."""
    valve = ramp()
    pushed = steady_speed(valve)

    def loose_at(seen_from: int) -> int:
        seen = np.where(np.arange(len(valve))[:, None] < seen_from, 0.0, 0.2) * np.ones(4)
        return first_motion(drive(valve, sticks(0.1), dead_s=0.0, seen=seen)[:, TELESCOPE])

    lag = VALVE_SHARE_RATIO * MEAN_LAG_TICKS
    soonest, latest = (
        np.flatnonzero(pushed > 0.1 * (1.0 + sign * UNSURE_RATIO))[0] + lag for sign in (-1, 1)
    )
    assert latest - soonest > 10.0
    middle = int(0.5 * (soonest + latest))
    assert loose_at(middle) == middle
    assert loose_at(0) == pytest.approx(soonest, abs=2.0)
    assert loose_at(len(valve)) == pytest.approx(latest, abs=2.0)
