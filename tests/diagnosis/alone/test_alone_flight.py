"""Tracked balls: drag where there is drag, none where gravity is enough, on made and on measured drops."""

from pathlib import Path

import numpy as np
import pytest

from diagnosis.alone.diagnose import flight_from_csv
from diagnosis.alone.flight_problem import Ball
from diagnosis.verdict import VerdictKind

DROPS = Path(__file__).parents[1] / "data" / "ball_drops" / "ball_drops.csv"
STEP_S = 0.001


def thrown(
    velocity: tuple[float, float, float],
    drag_per_m: float = 0.0,
    wind: tuple[float, float, float] = (0.0, 0.0, 0.0),
    span_s: float = 1.2,
) -> np.ndarray:
    """Positions every millisecond, semi-implicit Euler, (ticks, 3)."""
    p, v, rows = np.array([0.0, 0.0, 1.5]), np.array(velocity, dtype=float), []
    for _ in range(round(span_s / STEP_S)):
        rows.append(p.copy())
        air = v - np.array(wind)
        v = v + STEP_S * (np.array([0.0, 0.0, -9.81]) - drag_per_m * np.linalg.norm(air) * air)
        p = p + STEP_S * v
    return np.array(rows)


def write(
    path: Path, flights: list[np.ndarray], rate_hz: float = 100.0, noise_m: float = 0.003
) -> Path:
    rng = np.random.default_rng(1)
    lines = ["t,x,y,z"]
    for flight in flights:
        rows = flight[:: round(1.0 / rate_hz / STEP_S)]
        rows = rows + rng.normal(0.0, noise_m, rows.shape)
        lines += [f"{k / rate_hz:.5f},{x:.5f},{y:.5f},{z:.5f}" for k, (x, y, z) in enumerate(rows)]
    path.write_text("\n".join(lines) + "\n")
    return path


VELOCITIES = [(7.0, 0.5, 5.0), (9.0, -0.5, 4.0), (4.0, 0.0, 6.0)]


def test_gravity_alone_needs_no_effect(tmp_path: Path) -> None:
    found = flight_from_csv(write(tmp_path / "a.csv", [thrown(v) for v in VELOCITIES[:2]], 50.0))
    assert found.verdict is VerdictKind.NONE
    assert found.evidence["flights"] == 2


def test_drag_comes_back_as_a_coefficient_when_the_ball_is_known(tmp_path: Path) -> None:
    ball = Ball(mass_kg=0.05, diameter_m=0.1)
    truth = 0.5 * 1.204 * 0.25 * np.pi * 0.1**2 * 0.47 / 0.05
    path = write(tmp_path / "a.csv", [thrown(v, truth) for v in VELOCITIES[:2]], 50.0)
    found = flight_from_csv(path, ball=ball)
    assert found.verdict is VerdictKind.EXPLAINED
    (effect,) = found.causes[0].effects
    assert effect.effect == "air_drag"
    fitted = effect.parameters["extra_drag_coefficient_ratio"]
    assert fitted.value == pytest.approx(0.47, abs=0.03)
    assert fitted.ci90[0] < 0.47 < fitted.ci90[1] or abs(fitted.value - 0.47) < 0.01
    assert found.shrink is not None
    assert found.shrink.ratio > 0.9


def test_wind_is_named_beside_drag(tmp_path: Path) -> None:
    flights = [thrown(v, 0.03, (3.0, -2.0, 0.0), 0.9) for v in VELOCITIES]
    found = flight_from_csv(write(tmp_path / "a.csv", flights, 50.0))
    named = {e.effect: e.parameters for e in found.causes[0].effects}
    assert set(named) == {"air_drag", "wind"}
    assert named["wind"]["x_m_per_s"].value == pytest.approx(3.0, abs=0.4)
    assert named["wind"]["y_m_per_s"].value == pytest.approx(-2.0, abs=0.4)


def test_a_bounce_ends_the_flight(tmp_path: Path) -> None:
    down = thrown((2.0, 0.0, 0.0), span_s=0.5)
    up = thrown((2.0, 0.0, 4.0), span_s=0.5) + down[-1] - [0.0, 0.0, 1.5]
    found = flight_from_csv(write(tmp_path / "a.csv", [np.concatenate([down, up])]))
    assert found.verdict is VerdictKind.NONE
    assert found.evidence["samples"] <= 50


def test_millimetres_show_by_gravity_and_wrong_axes_are_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", [1000.0 * thrown(VELOCITIES[0])], noise_m=1.0)
    found = flight_from_csv(path)
    assert found.verdict is VerdictKind.NONE
    assert any("taken as mm" in note for note in found.evidence["notes"])
    wrong = flight_from_csv(path, length_unit="m")
    assert wrong.verdict is VerdictKind.BAD_DATA
    assert "--length-unit mm" in wrong.sentence
    sideways = flight_from_csv(path, axes=["z", "y", "x"], length_unit="mm")
    assert sideways.verdict is VerdictKind.BAD_DATA
    assert "wrong axis" in sideways.sentence


def drops_of(folder: Path, *balls: str) -> Path:
    lines = DROPS.read_text().splitlines()
    chosen = [line for line in lines[1:] if line.split(",")[0] in balls]
    path = folder / "drops.csv"
    path.write_text("\n".join([lines[0], *chosen]) + "\n")
    return path


def test_real_drops_name_drag_for_light_balls_and_not_for_the_bowling_ball(tmp_path: Path) -> None:
    light = ("Whiffle Ball 2", "Blue Basketball")
    path = drops_of(tmp_path, *light, "Bowling Ball")
    found = flight_from_csv(path, "time_s", ["height_m"], "ball")
    assert found.verdict is VerdictKind.EXPLAINED
    dragged = {e.joint for e in found.causes[0].effects if e.effect == "air_drag"}
    assert dragged == set(light)
    parts = found.evidence["parts"]
    assert parts["Bowling Ball"]["verdict"] == "none"
    assert parts["Whiffle Ball 2"]["shrink"]["ratio"] > 0.6
    # The basketballs pass the drag crisis: a constant coefficient is not enough for them.
    assert "drag_crisis" in parts["Blue Basketball"]["causes"][0]["name"]
