"""Joints whose speed depends on place and time, kinked valves and resonance: named, with their sizes."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from diagnosis.single_stage.csv_diagnosis import diagnose_actuation_csv
from diagnosis.single_stage.joint_response import list_actuation_options, simulate_speed
from diagnosis.verdict import Diagnosis, VerdictKind
from tests.diagnosis.single_stage.synthetic import effects, value, write

STEP_S = 0.01
TIME_S = np.arange(0.0, 27.0, STEP_S)
LEVELS = np.array([0.9, -0.5, 0.25, -0.8, 0.6, -0.3, -0.95, 0.75, -0.6, 0.45, 0.35, -0.15])
LEVER = np.where(TIME_S % 3.0 < 1.8, LEVELS[(TIME_S // 3.0).astype(int)], 0.0)

Slope = Callable[[float, float, int], float]
"""Speed from the lever, the position and the row."""


def diagnose(path: Path, speed: Slope) -> Diagnosis:
    """A record at 25 Hz with noise."""
    place, places = 0.0, []
    for k, lever in enumerate(LEVER):
        places.append(place)
        place += STEP_S * speed(float(lever), place, k)
    seen = np.array(places)[::4]
    seen = seen + np.random.default_rng(7).normal(0.0, 0.0005, len(seen))
    columns = {"time_s": TIME_S[::4], "lever": LEVER[::4], "position_rad": seen}
    return diagnose_actuation_csv(write(path, columns))


def test_speed_that_depends_on_the_position_is_said(tmp_path: Path) -> None:
    found = diagnose(tmp_path / "a.csv", lambda u, q, _: 0.4 * u * (1.0 + 0.8 * q))
    assert found.verdict is VerdictKind.EXPLAINED
    assert effects(found) == {"speed_by_position"}
    assert value(found, "speed_by_position", "low_end_ratio")[2] < 0.0
    assert value(found, "speed_by_position", "high_end_ratio")[0] > 0.0


def test_a_load_from_one_time_on_is_said(tmp_path: Path) -> None:
    found = diagnose(tmp_path / "a.csv", lambda u, _, k: (0.4 if TIME_S[k] < 15.0 else 0.26) * u)
    assert found.verdict is VerdictKind.EXPLAINED
    assert effects(found) == {"speed_drift"}
    assert value(found, "speed_drift", "change_ratio")[1] == pytest.approx(-0.35, abs=0.04)
    assert value(found, "speed_drift", "middle_ratio")[1] == pytest.approx(15.0 / 27.0, abs=0.05)


def test_a_kink_of_the_valve_is_found(tmp_path: Path) -> None:
    found = diagnose(
        tmp_path / "a.csv",
        lambda u, *_: (
            0.4 * np.sign(u) * float(np.interp(abs(u), (0.0, 0.4, 1.0), (0.0, 0.15, 1.0)))
        ),
    )
    assert effects(found) == {"valve_curve"}
    assert value(found, "valve_curve", "kink_ratio")[1] == pytest.approx(0.4, abs=0.04)
    assert value(found, "valve_curve", "kink_speed_ratio")[1] == pytest.approx(0.15, abs=0.03)


def test_resonance_takes_the_place_of_a_lag_and_one_sine_does_not_show_it() -> None:
    for sine_s, expected in ((None, {"valve_lag", "resonance"}), (2.0, {"valve_lag"})):
        options = list_actuation_options(0.04, 30.0, 0.5, 2.0, "rad", True, sine_s=sine_s)
        assert {o.effect for o in options if o.place == "valve_lag"} == expected


def test_a_resonance_rings_at_its_frequency() -> None:
    values = {
        "speed_per_command": 2.0,
        "resonance.frequency_hz": 0.5,
        "resonance.damping_ratio": 0.1,
    }
    speed = simulate_speed(np.ones(4000), 0.01, values, starts_at_rest=True)
    above = np.flatnonzero(np.diff(np.sign(speed - 2.0)) > 0.0)
    assert np.diff(above) * 0.01 == pytest.approx(2.0 / np.sqrt(1.0 - 0.1**2), abs=0.03)
    assert speed[-1] == pytest.approx(2.0, abs=0.01)
    # The overshoot of a second-order response is exp(-pi z / sqrt(1 - z^2)).
    overshoot = np.exp(-0.1 * np.pi / np.sqrt(1.0 - 0.1**2))
    assert np.max(speed) == pytest.approx(2.0 * (1.0 + overshoot), abs=0.02)


def test_speeds_follow_place_and_direction() -> None:
    command, place = np.array([0.5, 0.5, -0.5, -0.5]), np.array([-1.0, 1.0, -1.0, 1.0])
    ratios = {"low_end": -0.3, "lower_half": -0.1, "upper_half": 0.2, "high_end": 0.5}
    even = {f"speed_by_position.{name}_ratio": ratio for name, ratio in ratios.items()}
    sides = {
        "speed_by_position_two_sided.positive_slope_ratio": 0.2,
        "speed_by_position_two_sided.negative_slope_ratio": -0.6,
    }
    for values, expected in (
        (even, [0.7, 1.5, -0.7, -1.5]),
        (sides, [0.8, 1.2, -1.6, -0.4]),
    ):
        seen = simulate_speed(command, 0.1, {"speed_per_command": 2.0, **values}, place=place)
        assert seen == pytest.approx(expected)
