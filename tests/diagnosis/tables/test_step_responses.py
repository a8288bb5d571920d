"""Steps of a joint's command as a person would read them off a plot."""

import numpy as np
import pytest

from diagnosis.tables.step_responses import (
    StepResponse,
    find_late_onset,
    find_step_responses,
    shows_lost_travel,
    tabulate,
)

TICK_S = 0.01
LEVELS = (0.8, 0.4, -0.4, -0.8, 0.4, -0.4)


def _response(dead_time_s: float, lag_s: float, travel: float) -> tuple[StepResponse, ...]:
    """Steps of 2 s with rests of 1 s; `travel` is lost after each reversal, gain 0.5 unit/s."""
    command, speed = np.zeros(1800), np.zeros(1800)
    way = 0.0
    for k, level in enumerate(LEVELS):
        on = np.arange(100 + 300 * k, 300 + 300 * k)
        command[on] = level
        late_s = dead_time_s + (travel / (0.5 * abs(level)) if way * level < 0.0 else 0.0)
        since = (on - on[0]) * TICK_S - late_s
        speed[on] = np.where(since > 0.0, 0.5 * level * (1.0 - np.exp(-since / lag_s)), 0.0)
        way = level
    return find_step_responses(command, speed, TICK_S, 0.02)


def test_onset_rise_and_steady_speed_are_measured_by_level() -> None:
    rows = tabulate(_response(0.2, 0.1, 0.0), "rad/s")
    assert [(row["direction"], row["level_ratio"], row["steps"]) for row in rows] == [
        ("negative", 0.4, 2),
        ("negative", 0.8, 1),
        ("positive", 0.4, 2),
        ("positive", 0.8, 1),
    ]
    for row in rows:
        sign = 1.0 if row["direction"] == "positive" else -1.0
        assert row["onset_s"] == pytest.approx(0.2, abs=0.03)
        assert row["rise_s"] == pytest.approx(0.1, abs=0.03)
        assert row["steady_speed"] == pytest.approx(sign * 0.5 * row["level_ratio"], rel=0.01)


def test_a_step_within_the_dead_band_has_no_onset() -> None:
    command, speed = np.zeros(400), np.zeros(400)
    command[100:300] = 0.1
    (row,) = tabulate(find_step_responses(command, speed, TICK_S, 0.02), "rad/s")
    assert row["onset_s"] is None
    assert row["steady_speed"] == 0.0


def test_only_reversals_that_cost_a_travel_show_backlash() -> None:
    assert shows_lost_travel(_response(0.2, 0.1, 0.06))
    assert not shows_lost_travel(_response(0.2, 0.1, 0.0))


def test_effects_that_move_the_joint_at_another_time_are_named() -> None:
    steps = _response(0.3, 0.1, 0.0)
    assert find_late_onset(steps, _response(0.28, 0.1, 0.0), 0.1) == ""
    words = find_late_onset(steps, _response(0.05, 0.1, 0.0), 0.1)
    assert words.startswith("positive steps begin to move the joint after 0.3 s")
    assert "negative steps" in words
