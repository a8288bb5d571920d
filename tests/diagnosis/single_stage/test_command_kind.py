"""Joints: kind of the command, parameters at a bound, the command before the record."""

from pathlib import Path

import numpy as np
import pytest

from diagnosis.single_stage.csv_diagnosis import diagnose_actuation_csv
from diagnosis.single_stage.fit import StructureFit
from diagnosis.single_stage.fit_problem import EffectOption, FreeParameter
from diagnosis.single_stage.stage_result import find_parameters_at_bound
from diagnosis.verdict import VerdictKind
from tests.diagnosis.single_stage.synthetic import value, write


def _servo(path: Path, command: np.ndarray, time_s: np.ndarray) -> Path:
    """A position servo with gain 0.9, offset 0.4 rad, delay 0.1 s and lag 0.08 s."""
    period_s = float(time_s[1] - time_s[0])
    late = np.interp(time_s - 0.1, time_s, command)
    place = np.empty_like(late)
    place[0] = late[0]
    for k in range(1, len(late)):
        place[k] = place[k - 1] + (1.0 - np.exp(-period_s / 0.08)) * (late[k] - place[k - 1])
    place = 0.4 + 0.9 * place + np.random.default_rng(2).normal(0.0, 0.003, len(late))
    return write(path, {"time_s": time_s, "target": command, "position_rad": place})


def test_a_servo_that_follows_a_sine_is_no_speed_drive(tmp_path: Path) -> None:
    time_s = np.arange(0.0, 20.0, 0.02)
    path = _servo(tmp_path / "a.csv", 1.5 * np.sin(2.0 * np.pi * 0.4 * time_s), time_s)
    found = diagnose_actuation_csv(path)
    assert found.verdict is VerdictKind.AMBIGUOUS
    assert found.evidence["command_kind"] == "position"
    assert "delay and lag cannot be separated" in found.sentence
    assert found.ambiguity is not None
    for (effect,), name in zip(
        found.ambiguity.effects, ("valve_dead_time", "valve_lag"), strict=True
    ):
        assert effect.effect == name
        (delay,) = effect.parameters.values()
        assert delay.value == pytest.approx(0.18, abs=0.04)


def test_a_servo_that_follows_a_chirp_needs_no_hint(tmp_path: Path) -> None:
    time_s = np.arange(0.0, 20.0, 0.02)
    phase = 2.0 * np.pi * (0.15 * time_s + 0.02 * time_s**2)
    found = diagnose_actuation_csv(_servo(tmp_path / "a.csv", 1.5 * np.sin(phase), time_s))
    assert found.verdict is VerdictKind.EXPLAINED
    assert found.evidence["command_kind"] == "position"
    delays = [p.value for e in found.causes[0].effects for p in e.parameters.values()]
    assert sum(delays) == pytest.approx(0.18, abs=0.04)


def test_a_speed_drive_that_follows_a_sine_is_no_servo(tmp_path: Path) -> None:
    time_s = np.arange(0.0, 20.0, 0.02)
    phase = 2.0 * np.pi * 0.4 * (time_s - 0.1)
    place = -0.5 * np.cos(phase) + np.random.default_rng(2).normal(0.0, 0.001, len(time_s))
    columns = {"time_s": time_s, "lever": np.sin(phase + 0.08 * np.pi), "position_rad": place}
    found = diagnose_actuation_csv(write(tmp_path / "a.csv", columns))
    assert found.evidence["command_kind"] == "speed"


def test_a_parameter_at_its_bound_is_no_explanation() -> None:
    """A lag has at most its high value; an absent effect lies at a bound, too."""
    lag = FreeParameter("extra_lag_s", "s", 0.02, 5.0, (0.1,))
    damping = FreeParameter("damping_ratio", "1", 0.05, 0.4, (0.3,), is_absent_at_high=True)
    ratio = FreeParameter("positive_ratio", "1", -0.9, 0.9, (0.1,))
    kink = FreeParameter("kink_ratio", "1", 0.1, 0.9, (0.4,), is_absent_at_low=False)
    options = (
        EffectOption("a", "valve_lag", (lag, damping)),
        EffectOption("b", "valve_gain", (ratio,)),
        EffectOption("c", "valve_curve", (kink,)),
    )
    names = ("a.extra_lag_s", "a.damping_ratio", "b.positive_ratio", "c.kink_ratio")
    for values, expected in (
        ((1.0, 0.4, 0.3, 0.4), ()),
        ((4.99, 0.2, 0.3, 0.4), ("valve_lag.extra_lag_s",)),
        ((0.02, 0.2, -0.9, 0.4), ("valve_gain.positive_ratio",)),
        ((0.02, 0.2, 0.3, 0.101), ("valve_curve.kink_ratio",)),
    ):
        fit = StructureFit(options, names, np.array(values), np.zeros(4), np.zeros((4, 4)))
        assert find_parameters_at_bound(fit) == expected


def test_a_joint_at_rest_was_not_commanded_before_the_record(tmp_path: Path) -> None:
    """The first command stands in the first row, the motion begins 0.3 s later."""
    time_s = np.arange(0.0, 12.0, 0.02)
    lever = np.where(time_s % 3.0 < 1.5, np.where(time_s % 6.0 < 3.0, 0.8, -0.5), 0.0)
    late = np.concatenate([np.zeros(15), lever[:-15]])
    place = np.concatenate([[0.0], np.cumsum(0.3 * late)[:-1] * 0.02])
    columns = {"time_s": time_s, "lever": lever, "position_rad": place}
    found = diagnose_actuation_csv(write(tmp_path / "a.csv", columns))
    assert found.verdict is VerdictKind.EXPLAINED
    low, _, high = value(found, "valve_dead_time", "extra_dead_time_s")
    assert low < 0.3 < high


def test_each_direction_has_its_own_dead_time(tmp_path: Path) -> None:
    """0.14 s out and 0.34 s in; the table of steps shows the same."""
    time_s = np.arange(0.0, 40.0, 0.02)
    sizes = np.array([0.9, -0.5, 0.3, -0.8, 0.6, -0.3, -0.9, 0.7, -0.6, 0.4])
    lever = np.where(time_s % 4.0 < 2.0, sizes[(time_s // 4.0).astype(int)], 0.0)
    out = np.concatenate([np.zeros(7), np.maximum(lever, 0.0)[:-7]])
    back = np.concatenate([np.zeros(17), np.minimum(lever, 0.0)[:-17]])
    place = np.concatenate([[0.0], np.cumsum(0.4 * (out + back))[:-1] * 0.02])
    place += np.random.default_rng(6).normal(0.0, 0.0005, len(place))
    columns = {"time_s": time_s, "lever": lever, "position_rad": place}
    found = diagnose_actuation_csv(write(tmp_path / "a.csv", columns))
    assert found.verdict is VerdictKind.EXPLAINED
    assert {e.effect for e in found.causes[0].effects} == {"valve_dead_time"}
    for way, truth in (("positive", 0.14), ("negative", 0.34)):
        low, _, high = value(found, "valve_dead_time", f"{way}_dead_time_s")
        assert low < truth < high
        onsets = [row["onset_s"] for row in found.evidence["steps"] if row["direction"] == way]
        assert len(onsets) >= 4
        assert np.median(onsets) == pytest.approx(truth, abs=0.04)
    assert value(found, "valve_dead_time", "extra_dead_time_s")[1] == pytest.approx(0.24, abs=0.03)
