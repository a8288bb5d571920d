"""Intervals and time stamps of joints: thresholds, bands without compensation, commands between two ticks."""

from pathlib import Path

import numpy as np
import pytest

from diagnosis.alone.diagnose import actuation_from_csv
from diagnosis.alone.reading.commands import Command
from diagnosis.alone.reading.motion import Motion
from diagnosis.verdict import Diagnosis

STEP_S = 0.002
SPAN_S = 36.0


def levers() -> np.ndarray:
    """Steps of 24 sizes in both directions with rests, one every 1.5 s, (ticks,)."""
    sizes = np.random.default_rng(8).permutation(np.linspace(0.08, 1.0, 24))
    sizes *= np.where(np.arange(24) % 2, -1.0, 1.0)
    time_s = np.arange(0.0, SPAN_S, STEP_S)
    number = np.minimum((time_s / 1.5).astype(int), 23)
    return np.where(time_s % 1.5 > 0.4, sizes[number], 0.0)


def diagnosed(path: Path, command: np.ndarray, speed: np.ndarray, rate_hz: float) -> Diagnosis:
    """What the tool says of a joint with that speed, (ticks,), over that command."""
    rng = np.random.default_rng(1)
    rows = np.arange(0, len(command), round(1.0 / rate_hz / STEP_S))
    angle = (np.cumsum(speed) * STEP_S)[rows] + rng.normal(0.0, 2e-4, len(rows))
    table = np.stack([rows * STEP_S, command[rows], angle], axis=1)
    np.savetxt(path, table, delimiter=",", header="t,u,q_rad", comments="", fmt="%.7f")
    return actuation_from_csv(path, "t", "u", "q_rad")


def test_the_interval_of_a_breakaway_lies_between_two_steps(tmp_path: Path) -> None:
    """Steps of 16 % of 0.5 rad/s do not move the joint, larger ones do: no slope tells of it."""
    command = levers()
    steady = 0.5 * command
    found = diagnosed(
        tmp_path / "a.csv", command, np.where(np.abs(steady) > 0.08, steady, 0.0), 50.0
    )
    named = {e.effect: e.parameters for e in found.causes[0].effects}
    assert list(named) == ["stiction"]
    low, high = named["stiction"]["breakaway_rad_m_per_s"].ci90
    assert low < 0.08 < high
    assert 0.01 < high - low < 0.05


def test_uneven_bands_without_compensation_are_no_uneven_gain(tmp_path: Path) -> None:
    command = levers()
    lost = np.where(command > 0.0, 0.22, 0.08)
    speed = 0.5 * np.sign(command) * np.maximum(np.abs(command) - lost, 0.0)
    found = diagnosed(tmp_path / "a.csv", command, speed, 50.0)
    named = {e.effect: e.parameters for e in found.causes[0].effects}
    assert list(named) == ["valve_dead_band"]
    bands = named["valve_dead_band"]
    assert bands["positive_ratio"].value == pytest.approx(0.22, abs=0.01)
    assert bands["negative_ratio"].value == pytest.approx(0.08, abs=0.01)


def test_a_command_that_changes_within_a_tick_counts_for_its_share() -> None:
    time_s = np.array([0.0, 0.013, 0.031, 0.05])
    motion = Motion(
        time_s, np.array([0.0, 1.0, -1.0, 0.0]), time_s, np.zeros(4, dtype=np.int64), False, "rad"
    )
    command = Command(0.0, 1.0, False, 0.01, ())
    told = command.on_grid(motion, np.arange(0.0, 0.05, 0.01))
    np.testing.assert_allclose(told, [0.0, 0.7, 1.0, -0.8, -1.0], atol=1e-9)


def test_a_lag_is_as_unsure_as_the_commands_time_stamps(tmp_path: Path) -> None:
    command = levers()
    speed = np.zeros(len(command))
    for k in range(1, len(speed)):
        speed[k] = speed[k - 1] + STEP_S * (0.5 * command[k] - speed[k - 1]) / 0.3
    found = diagnosed(tmp_path / "a.csv", command, speed, 20.0)
    (lag,) = (e.parameters["extra_lag_s"] for e in found.causes[0].effects)
    assert lag.ci90[0] < 0.3 < lag.ci90[1]
    assert lag.ci90[1] - lag.ci90[0] > 0.05  # a period of 20 Hz
