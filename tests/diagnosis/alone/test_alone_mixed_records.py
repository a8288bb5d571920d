"""Records that change their unit or clock half way, hit the sensor's range, rest, or are in feet."""

from pathlib import Path

import numpy as np
import pytest

from diagnosis.alone.diagnose import flight_from_csv, swing_from_csv
from diagnosis.alone.reading.consistency import clipped
from diagnosis.verdict import Diagnosis, VerdictKind
from tests.diagnosis.alone.answers import effects, notes_of, value
from tests.diagnosis.alone.planted import ball, joined, pendulum, write

AXES = ("x", "y", "z")


def refused(found: Diagnosis) -> str:
    assert found.verdict is VerdictKind.BAD_DATA
    return found.sentence


@pytest.mark.parametrize("drag", [0.0, 0.022])
def test_throws_in_feet_are_no_topspin(tmp_path: Path, drag: float) -> None:
    rng = np.random.default_rng(1)
    one = joined([ball(rng, drag_per_m=drag, rate_hz=30.0) for _ in range(3)])
    one |= {axis: one[axis] / 0.3048 for axis in AXES}
    assert "feet" in refused(flight_from_csv(write(tmp_path / "a.csv", one)))


def test_a_film_in_slow_motion_is_told_its_factor(tmp_path: Path) -> None:
    one = ball(np.random.default_rng(2), rate_hz=240.0)
    one["t"] = 6.0 * one["t"]
    assert "runs 6 times too slowly" in refused(flight_from_csv(write(tmp_path / "a.csv", one)))


def test_a_ball_that_never_moves_was_not_let_go_late(tmp_path: Path) -> None:
    t = np.arange(0.0, 1.5, 1.0 / 30.0)
    still = {"t": t, "x": np.full(len(t), 1.0), "y": np.full(len(t), 2.0)}
    assert "it rests" in refused(flight_from_csv(write(tmp_path / "a.csv", still)))


def test_metres_and_centimetres_in_one_track_are_refused(tmp_path: Path) -> None:
    one = ball(np.random.default_rng(3))
    late = one["t"] > 0.5 * one["t"][-1]
    one |= {axis: np.where(late, 100.0, 1.0) * one[axis] for axis in AXES}
    assert "units are mixed" in refused(flight_from_csv(write(tmp_path / "a.csv", one)))


def test_seconds_and_milliseconds_in_one_column_are_refused(tmp_path: Path) -> None:
    one = pendulum(np.random.default_rng(4))
    late = one["t"] > 9.0
    one["t"] = np.where(late, 1000.0, 1.0) * one["t"]
    path = write(tmp_path / "a.csv", {"t": one["t"], "theta_deg": one["theta_deg"]})
    assert "units of time are mixed" in refused(swing_from_csv(path))


def test_an_angle_that_is_cut_off_keeps_its_frictions(tmp_path: Path) -> None:
    one = pendulum(np.random.default_rng(5), viscous=0.1, noise_rad=0.001)
    limit = 0.75 * float(np.max(np.abs(one["theta_deg"])))
    angle = np.clip(one["theta_deg"], -limit, limit)
    found = swing_from_csv(write(tmp_path / "a.csv", {"t": one["t"], "theta_deg": angle}))
    assert effects(found) == {"passive_viscous_friction"}
    _, viscous, _ = value(found, "passive_viscous_friction", "extra_viscous_per_s")
    assert viscous == pytest.approx(0.1, rel=0.02)
    assert "the angle is cut off" in notes_of(found)


def test_a_gyro_that_is_cut_off_is_refused(tmp_path: Path) -> None:
    one = pendulum(np.random.default_rng(6), viscous=0.1, noise_rad=0.001)
    limit = 0.75 * float(np.max(np.abs(one["omega_deg_s"])))
    rate = np.clip(one["omega_deg_s"], -limit, limit)
    path = write(tmp_path / "a.csv", {"t": one["t"], "omega_deg_s": rate})
    assert "range of the gyro" in refused(swing_from_csv(path))


def test_a_coarse_encoder_is_not_cut_off() -> None:
    angle = np.cos(np.arange(0.0, 60.0, 0.01))
    assert not np.any(clipped(np.round(angle / 0.05) * 0.05))
    assert np.any(clipped(np.round(np.clip(angle, -0.7, 0.7) / 0.05) * 0.05))


def test_a_length_must_be_above_zero(tmp_path: Path) -> None:
    one = pendulum(np.random.default_rng(7))
    path = write(tmp_path / "a.csv", {"t": one["t"], "theta_deg": one["theta_deg"]})
    assert "--length-m" in refused(swing_from_csv(path, length_m=-1.0))
