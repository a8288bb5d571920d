"""One joint's actuation from commands and motion: truth planted by an independent plant comes back."""

from pathlib import Path

import numpy as np
import pytest

from diagnosis.alone.diagnose import actuation_from_csv
from diagnosis.verdict import Diagnosis, VerdictKind
from tests.diagnosis.slew_networks import slew_speed, staircase, write_csv

STEP_S = 0.002
LEVELS = (1.0, -0.6, 0.3, -0.15, 0.45, -0.8, 0.6, -0.3)


def plant(
    command: np.ndarray,
    dead_time_s: float = 0.0,
    lag_s: float = 0.0,
    band: tuple[float, float] = (0.0, 0.0),
    hysteresis: float = 0.0,
    limit: float = np.inf,
    gap: float = 0.0,
    gain: float = 0.5,
) -> tuple[np.ndarray, np.ndarray]:
    """Speed and position in steps of 2 ms, written down step by step and not with the product's code."""
    late = round(dead_time_s / STEP_S)
    speed = spool = true = seen = 0.0
    speeds, positions = [], []
    for k in range(len(command)):
        u = command[k - late] if k >= late else 0.0
        spool = min(max(spool, u - hysteresis), u + hysteresis)
        dead = band[0] if spool > 0 else band[1]
        steady = gain * np.sign(spool) * max(abs(spool) - dead, 0.0) / (1.0 - dead)
        steady = min(max(steady, -limit), limit)
        speed = steady if lag_s == 0.0 else speed + STEP_S * (steady - speed) / lag_s
        true += STEP_S * speed
        seen = min(max(seen, true - gap / 2), true + gap / 2)
        speeds.append(speed)
        positions.append(seen)
    return np.array(speeds), np.array(positions)


def record(
    path: Path,
    rate_hz: float = 50.0,
    noise: float = 0.001,
    scale: float = 1.0,
    jitter: float = 0.0,
    degrees: bool = False,
    wrapped: bool = False,
    span_s: float = 28.0,
    **effects: float | tuple[float, float],
) -> Path:
    """A table of steps with rests as someone else may have recorded it."""
    rng = np.random.default_rng(4)
    time_s = np.arange(0.0, span_s, STEP_S)
    command = np.zeros_like(time_s)
    for number in range(int(span_s / 3.2)):
        on = (time_s >= 1.0 + 3.2 * number) & (time_s < 3.0 + 3.2 * number)
        command[on] = LEVELS[number % len(LEVELS)]
    _, position = plant(command, **effects)
    seen_s = np.arange(0.0, span_s - 0.1, 1.0 / rate_hz)
    seen_s = np.sort(seen_s + jitter / rate_hz * rng.uniform(-1, 1, len(seen_s))).clip(0.0)
    u = command[(seen_s / STEP_S).astype(int)] * scale
    y = np.interp(seen_s, time_s, position) + rng.normal(0.0, noise, len(seen_s))
    if wrapped:
        y = (y + np.pi) % (2.0 * np.pi) - np.pi
    if degrees:
        y = np.degrees(y)
    head = f"time,cmd,position_{'deg' if degrees else 'rad'}"
    rows = np.stack([seen_s, u, y], axis=1)
    np.savetxt(path, rows, delimiter=",", header=head, comments="", fmt="%.7g")
    return path


def top(found: Diagnosis) -> dict[str, dict[str, float]]:
    return {
        e.effect: {n: p.value for n, p in e.parameters.items()} for e in found.causes[0].effects
    }


def assert_within(
    found: Diagnosis, effect: str, parameter: str, truth: float, slack: float
) -> None:
    """The value is near the truth, and the interval is not nonsense."""
    (fitted,) = [e for e in found.causes[0].effects if e.effect == effect]
    value = fitted.parameters[parameter]
    assert value.value == pytest.approx(truth, abs=slack)
    low, high = value.ci90
    assert low <= value.value <= high
    assert high - low < 6.0 * slack


def test_an_ideal_joint_needs_no_effect(tmp_path: Path) -> None:
    found = actuation_from_csv(record(tmp_path / "a.csv"))
    assert found.verdict is VerdictKind.NONE
    assert found.causes[0].name == "none"
    assert any("column 'cmd' taken as the command" in n for n in found.evidence["notes"])


@pytest.mark.parametrize("seed_rate", [(50.0, 1.0, 0.0), (60.0, 850.0, 0.4)])
def test_dead_time_lag_and_dead_band_come_back(
    tmp_path: Path, seed_rate: tuple[float, float, float]
) -> None:
    rate_hz, scale, jitter = seed_rate
    path = record(
        tmp_path / "a.csv",
        rate_hz=rate_hz,
        scale=scale,
        jitter=jitter,
        dead_time_s=0.12,
        lag_s=0.25,
        band=(0.15, 0.12),
    )
    found = actuation_from_csv(path, "time", "cmd", "position_rad")
    assert found.verdict is VerdictKind.EXPLAINED
    assert set(top(found)) == {"valve_dead_time", "valve_lag", "valve_dead_band"}
    assert_within(found, "valve_dead_time", "extra_dead_time_s", 0.12, 0.03)
    assert_within(found, "valve_lag", "extra_lag_s", 0.25, 0.03)
    assert_within(found, "valve_dead_band", "positive_ratio", 0.15, 0.02)
    assert_within(found, "valve_dead_band", "negative_ratio", 0.12, 0.02)
    assert found.shrink is not None
    assert found.shrink.ratio > 0.85
    assert found.shrink.predicted_ratio == pytest.approx(found.shrink.ratio, abs=0.1)


def test_backlash_is_not_taken_for_a_dead_band(tmp_path: Path) -> None:
    found = actuation_from_csv(record(tmp_path / "a.csv", gap=0.05))
    assert set(top(found)) == {"backlash"}
    assert_within(found, "backlash", "gap_rad_m", 0.05, 0.005)


def test_degrees_wraps_and_a_negative_gain_make_no_difference(tmp_path: Path) -> None:
    path = record(tmp_path / "a.csv", degrees=True, wrapped=True, gain=-1.6, lag_s=0.3)
    found = actuation_from_csv(path)
    assert set(top(found)) == {"valve_lag"}
    assert_within(found, "valve_lag", "extra_lag_s", 0.3, 0.03)
    notes = " ".join(found.evidence["notes"])
    assert "degrees" in notes
    assert "unwrapped" in notes
    assert found.evidence["gain_per_full_command"]["value"] == pytest.approx(-1.6, rel=0.05)


def test_the_slew_networks_show_dead_band_dead_time_and_lag(tmp_path: Path) -> None:
    joystick = staircase((850.0, -850.0, 300.0, -300.0, 200.0, -200.0, 600.0, -600.0), 5.0, 3.0)
    write_csv(tmp_path / "slew.csv", joystick, slew_speed(joystick))
    found = actuation_from_csv(tmp_path / "slew.csv", "time_s", "joystick", "slew_rad")
    assert found.verdict is VerdictKind.EXPLAINED
    named = top(found)
    assert {"valve_dead_band", "valve_dead_time", "valve_lag"} <= set(named)
    # The networks' own description: dead band 18-24 %, 5 % response after 0.4-0.5 s.
    assert 0.08 < named["valve_dead_band"]["positive_ratio"] < 0.26
    assert 0.1 < named["valve_dead_time"]["extra_dead_time_s"] < 0.5
    assert found.evidence["selection"]["inclusion_probability"]["valve_dead_band"] > 0.9
    assert found.evidence["gain_per_full_command"]["value"] < 0.0
    assert found.shrink is not None
    assert found.shrink.ci90[0] > 0.6
