"""Joints: effects of an independent plant, intervals, end stops, merged topics, servos, refused records."""

from pathlib import Path

import numpy as np
import pytest

from diagnosis.single_stage.actuation_problem import find_end_stops
from diagnosis.single_stage.csv_diagnosis import diagnose_actuation_csv
from diagnosis.verdict import Diagnosis, VerdictKind
from tests.diagnosis.single_stage.joint_records import operated, record
from tests.diagnosis.single_stage.synthetic import (
    effects,
    join_notes,
    joint,
    value,
    write,
)

EXCAVATOR_EFFECTS = {"valve_dead_time", "valve_lag", "valve_dead_band"}
SPAN_S = 36.0


def assert_within(
    found: Diagnosis, effect: str, parameter: str, truth: float, slack: float
) -> None:
    """The value is near the truth, and its interval contains it and is narrow."""
    (fitted,) = [e for e in found.causes[0].effects if e.effect == effect]
    value = fitted.parameters[parameter]
    assert value.value == pytest.approx(truth, abs=slack)
    low, high = value.ci90
    assert low <= value.value <= high
    assert high - low < 6.0 * slack


def test_an_ideal_joint_needs_no_effect(tmp_path: Path) -> None:
    found = diagnose_actuation_csv(record(tmp_path / "a.csv"))
    assert found.verdict is VerdictKind.NONE
    assert found.causes[0].name == "none"
    assert any("column 'cmd' taken as the command" in n for n in found.evidence["notes"])


def test_dead_time_lag_and_dead_band_are_found(tmp_path: Path) -> None:
    path = record(tmp_path / "a.csv", dead_time_s=0.12, lag_s=0.25, band=(0.15, 0.12))
    found = diagnose_actuation_csv(path, "time", "cmd", "position_rad")
    assert found.verdict is VerdictKind.EXPLAINED
    assert effects(found) == EXCAVATOR_EFFECTS
    assert_within(found, "valve_dead_time", "extra_dead_time_s", 0.12, 0.03)
    assert_within(found, "valve_lag", "extra_lag_s", 0.25, 0.03)
    assert_within(found, "valve_dead_band", "positive_ratio", 0.15, 0.02)
    assert_within(found, "valve_dead_band", "negative_ratio", 0.12, 0.02)
    assert found.shrink is not None
    assert found.shrink.ratio > 0.85
    assert found.shrink.predicted_ratio == pytest.approx(found.shrink.ratio, abs=0.1)


def test_a_measured_speed_suffices(tmp_path: Path) -> None:
    columns = joint(np.random.default_rng(21), dead_time_s=0.15, lag_s=0.2, dead_band=0.12)
    path = write(tmp_path / "a.csv", columns)
    found = diagnose_actuation_csv(path, "stamp_ms", "lever_pct", velocity="boom_rate_deg_s")
    assert found.verdict is VerdictKind.EXPLAINED
    assert effects(found) == EXCAVATOR_EFFECTS
    for effect, parameter, truth in (
        ("valve_dead_time", "extra_dead_time_s", 0.15),
        ("valve_lag", "extra_lag_s", 0.2),
        ("valve_dead_band", "positive_ratio", 0.12),
    ):
        assert value(found, effect, parameter)[1] == pytest.approx(truth, rel=0.15), effect


def test_backlash_is_named_where_some_steps_reverse_and_others_go_on(tmp_path: Path) -> None:
    levels = (1.0, 0.6, -0.3, -0.45, 0.3, -0.8, -0.6, 0.45)
    found = diagnose_actuation_csv(record(tmp_path / "a.csv", gap=0.05, levels=levels))
    assert effects(found) == {"backlash"}
    assert_within(found, "backlash", "gap_rad_m", 0.05, 0.005)


def test_degrees_wraps_and_a_negative_gain_make_no_difference(tmp_path: Path) -> None:
    path = record(tmp_path / "a.csv", degrees=True, wrapped=True, gain=-1.6, lag_s=0.3)
    found = diagnose_actuation_csv(path)
    assert effects(found) == {"valve_lag"}
    assert_within(found, "valve_lag", "extra_lag_s", 0.3, 0.03)
    notes = join_notes(found)
    assert "degrees" in notes
    assert "unwrapped" in notes
    assert found.evidence["gain_per_full_command"]["value"] == pytest.approx(-1.6, rel=0.05)


def test_end_stops_are_found_where_the_joint_stands_against_them() -> None:
    free = operated(5)
    low, high = (float(end) for end in np.quantile(free["pos_rad"], [0.06, 0.94]))
    stopped = operated(5, (low, high))
    for run, places in ((free, 0), (stopped, 2)):
        position, time_s = run["pos_rad"], run["time_s"]
        speed = np.gradient(position, time_s)
        found = find_end_stops(position, speed, run["cmd"], 0.001, 0.02, 5)
        assert len(found.places) == places
