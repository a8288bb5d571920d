"""Steps of a joint's command as a person would read them off a plot."""

import re

import numpy as np
import pytest

from diagnosis.tables.step_responses import (
    StepResponse,
    find_late_onset,
    find_step_responses,
    read_directions,
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
    assert re.match(r"positive steps begin to move the joint after 0\.(29|3) s", words)
    assert "negative steps" in words


def test_a_step_counts_up_to_an_end_stop_and_a_stay_there_is_no_speed() -> None:
    command, speed = np.zeros(800), np.zeros(800)
    command[100:300] = command[400:700] = 0.8
    speed[120:300] = speed[420:560] = 0.4
    speed[200:320] = np.nan
    excluded, stayed = find_step_responses(command, speed, TICK_S, 0.02)
    for step in (excluded, stayed):
        assert step.onset_s == pytest.approx(0.2, abs=0.03)
        assert step.steady_speed == pytest.approx(0.4)


def test_a_coarse_encoder_s_step_before_a_step_is_no_motion() -> None:
    command, speed = np.zeros(600), np.zeros(600)
    command[100:500] = 0.8
    speed[99], speed[120:500] = 0.1, 0.4
    speed[104] = 0.1
    (step,) = find_step_responses(command, speed, TICK_S, 0.02)
    assert step.onset_s == pytest.approx(0.2, abs=0.04)
    speed[80:100] = 0.1
    assert not find_step_responses(command, speed, TICK_S, 0.02)


def test_no_joint_moves_before_it_moves() -> None:
    command, speed = np.zeros(600), np.zeros(600)
    command[100:500] = 0.8
    # Creeps at first: a line through two far speeds would begin before the step.
    speed[130:500] = np.clip(0.1 + 0.3 * np.arange(370) * TICK_S / 2.0, 0.0, 0.4)
    (step,) = find_step_responses(command, speed, TICK_S, 0.02)
    assert step.onset_s == pytest.approx(0.3, abs=0.04)


def test_dead_time_dead_band_and_saturation_are_read_off_for_each_direction() -> None:
    levels = (0.2, 0.4, 0.6, 0.8, 1.0)
    command, speed = np.zeros(3200), np.zeros(3200)
    for k, level in enumerate((*levels, *(-one for one in levels))):
        at = 100 + 300 * k
        late, band, most = (20, 0.3, 0.4) if level > 0.0 else (30, 0.1, 9.0)
        command[at : at + 200] = level
        speed[at + late : at + 200] = np.sign(level) * np.clip(abs(level) - band, 0.0, most)
    up, down = read_directions(find_step_responses(command, speed, TICK_S, 0.02))
    assert (up.direction, down.direction) == ("positive", "negative")
    assert up.dead_time_s == pytest.approx(0.2, abs=0.03)
    assert down.dead_time_s == pytest.approx(0.3, abs=0.03)
    assert up.dead_band_ratio == pytest.approx(0.3, abs=0.02)
    assert down.dead_band_ratio == pytest.approx(0.1, abs=0.02)
    assert (up.saturation_ratio, down.saturation_ratio) == (0.8, None)
    assert (up.top_speed, down.top_speed) == (pytest.approx(0.4), pytest.approx(0.9))
    assert (up.steps_count, down.steps_count) == (5, 5)


@pytest.mark.parametrize(
    ("speeds", "saturation"),
    [
        ((0.1, 0.2, 0.4, 0.39, 0.35), 0.6),  # full is slower: place and load differ
        ((0.4, 0.2, 0.26, 0.33, 0.38), None),  # one odd step among proportional ones
        ((0.1, 0.2, 0.3, 0.36, 0.37), None),  # 0.8 is as fast as full, which proves little
    ],
)
def test_a_direction_is_saturated_where_most_higher_levels_are_no_faster(
    speeds: tuple[float, ...], saturation: float | None
) -> None:
    levels = (0.2, 0.4, 0.6, 0.8, 0.9)
    steps = [
        StepResponse(0, level, 0.2, 0.1, speed, False)
        for level, speed in zip(levels, speeds, strict=True)
    ]
    (reading,) = read_directions(steps)
    assert reading.saturation_ratio == saturation
