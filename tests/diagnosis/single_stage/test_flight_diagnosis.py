"""Tracked balls: drag, wind, units, axes, launches and bounces, doubtful verdicts, refused records."""

from pathlib import Path

import numpy as np
import pytest

from diagnosis.single_stage.csv_diagnosis import diagnose_flight_csv
from diagnosis.single_stage.flight_problem import BallProperties
from diagnosis.verdict import VerdictKind
from tests.diagnosis.single_stage.synthetic import (
    ball,
    effects,
    join_notes,
    joined,
    thrown,
    value,
    write,
    write_flights,
)

VELOCITIES = [(7.0, 0.5, 5.0), (9.0, -0.5, 4.0), (4.0, 0.0, 6.0)]
AXES = ("x", "y", "z")
DRAG = ("air_drag", "drag_per_m")


def test_the_drag_coefficient_of_a_known_ball_is_found(tmp_path: Path) -> None:
    known = BallProperties(mass_kg=0.05, diameter_m=0.1)
    truth = 0.5 * 1.204 * 0.25 * np.pi * 0.1**2 * 0.47 / 0.05
    path = write_flights(tmp_path / "a.csv", [thrown(v, truth) for v in VELOCITIES[:2]], 50.0)
    found = diagnose_flight_csv(path, ball=known)
    assert found.verdict is VerdictKind.EXPLAINED
    assert effects(found) == {"air_drag"}
    low, fitted, high = value(found, "air_drag", "extra_drag_coefficient_ratio")
    assert fitted == pytest.approx(0.47, abs=0.03)
    assert low < 0.47 < high or abs(fitted - 0.47) < 0.01
    assert found.shrink is not None
    assert found.shrink.ratio > 0.9


def test_a_bounce_ends_the_flight(tmp_path: Path) -> None:
    down = thrown((2.0, 0.0, 0.0), span_s=0.5)
    up = thrown((2.0, 0.0, 4.0), span_s=0.5) + down[-1] - [0.0, 0.0, 1.5]
    found = diagnose_flight_csv(write_flights(tmp_path / "a.csv", [np.concatenate([down, up])]))
    assert found.verdict is VerdictKind.NONE
    assert found.evidence["samples"] <= 50


def test_launch_and_rest_on_the_ground_are_cut_off(tmp_path: Path) -> None:
    run = ball(np.random.default_rng(10), 0.06, rate_hz=100.0)
    x, z, h = run["x"], run["z"], 0.01
    vx, vz = (x[5] - x[0]) / (5 * h), (z[5] - z[0]) / (5 * h)
    swung = np.arange(-40, 0) * h
    hand = 0.5 * (swung + 0.4) ** 2 / 0.4
    hand_x, hand_z = x[0] + vx * (hand - hand[-1] - h), z[0] + vz * (hand - hand[-1] - h)
    whole_x = np.concatenate([hand_x, x, np.full(60, x[-1])])
    whole_z = np.concatenate([hand_z, z, np.full(60, z[-1])])
    columns = {"t": np.arange(len(whole_x)) * h, "x": whole_x, "z": whole_z}
    low, drag, high = value(diagnose_flight_csv(write(tmp_path / "a.csv", columns)), *DRAG)
    assert drag == pytest.approx(0.06, rel=0.15)
    assert low < 0.06 < high


def test_a_falling_paper_cone_shows_strong_drag(tmp_path: Path) -> None:
    """A sonar above it measures the distance; x = ln cosh(sqrt(g k) t) / k."""
    t = np.arange(0.0, 1.4, 0.05)
    way = np.log(np.cosh(np.sqrt(9.81 * 3.2) * t)) / 3.2
    way = 0.3 + way + np.random.default_rng(11).normal(0.0, 0.001, len(t))
    path = write(tmp_path / "a.csv", {"t": t, "Position (m)": way})
    found = diagnose_flight_csv(path, "t", ["Position (m)"])
    assert found.verdict is VerdictKind.EXPLAINED
    low, drag, high = value(found, *DRAG)
    assert drag == pytest.approx(3.2, rel=0.05)
    assert low < 3.2 < high


def test_millimetres_are_recognised_by_gravity(tmp_path: Path) -> None:
    path = write_flights(tmp_path / "a.csv", [1000.0 * thrown(VELOCITIES[0])], noise_m=1.0)
    found = diagnose_flight_csv(path)
    assert found.verdict is VerdictKind.NONE
    assert "taken as mm" in join_notes(found)
    for options, words in (
        ({"length_unit": "m"}, "--length-unit mm"),
        ({"axes": ["z", "y", "x"], "length_unit": "mm"}, "wrong axis"),
    ):
        refused = diagnose_flight_csv(path, **options)
        assert refused.verdict is VerdictKind.BAD_DATA
        assert words in refused.sentence


def test_unusable_flights_are_refused_with_the_remedy(tmp_path: Path) -> None:
    in_feet = []
    for drag in (0.0, 0.022):
        rng = np.random.default_rng(1)
        one = joined([ball(rng, drag_per_m=drag, rate_hz=30.0) for _ in range(3)])
        in_feet.append(one | {axis: one[axis] / 0.3048 for axis in AXES})
    slow = ball(np.random.default_rng(2), rate_hz=240.0)
    slow["t"] = 6.0 * slow["t"]
    t = np.arange(0.0, 1.5, 1.0 / 30.0)
    still = {"t": t, "x": np.full(len(t), 1.0), "y": np.full(len(t), 2.0)}
    mixed = ball(np.random.default_rng(3))
    late = mixed["t"] > 0.5 * mixed["t"][-1]
    mixed |= {axis: np.where(late, 100.0, 1.0) * mixed[axis] for axis in AXES}
    for columns, words in (
        (in_feet[0], "feet"),
        (in_feet[1], "feet"),
        (slow, "runs 6 times too slowly"),
        (still, "it rests"),
        (mixed, "units are mixed"),
    ):
        found = diagnose_flight_csv(write(tmp_path / "a.csv", columns))
        assert found.verdict is VerdictKind.BAD_DATA, words
        assert words in found.sentence
