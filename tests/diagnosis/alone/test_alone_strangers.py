"""Files as strangers hand them in: other programs' columns, units and sensors, hands, grounds and bounces."""

from pathlib import Path

import numpy as np
import pytest

from diagnosis.alone.diagnose import actuation_from_csv, flight_from_csv
from diagnosis.alone.reading.clocks import time_of
from diagnosis.alone.reading.layout import RefusedTableError
from diagnosis.alone.reading.runs import time_seconds
from diagnosis.alone.reading.tables import read_table
from diagnosis.alone.reading.units import spikes, turn_of
from diagnosis.verdict import VerdictKind
from tests.diagnosis.alone.answers import notes_of, value
from tests.diagnosis.alone.planted import Columns, ball, joined, joint, write

# --- times


@pytest.mark.parametrize(
    ("header", "cells"),
    [
        ("Zeit [s]", [f"{0.02 * k:.2f}" for k in range(60)]),
        ("clock", [f"03.05.2024 10:00:{0.02 * k:06.3f}".replace(".", ".") for k in range(60)]),
        ("stamp", [f"1:{0.02 * k:05.2f}" for k in range(60)]),
        ("sec,nanosec", [f"{100 + k // 50},{20_000_000 * (k % 50)}" for k in range(60)]),
        ("tick_of_it", [f"{0.02 * k:.2f}" for k in range(60)]),
    ],
)
def test_clocks_of_other_programs(tmp_path: Path, header: str, cells: list[str]) -> None:
    path = tmp_path / "a.csv"
    path.write_text(f"{header},q\n" + "\n".join(f"{c},{k % 7}" for k, c in enumerate(cells)))
    table = read_table(path)
    assert time_seconds(table, time_of(table, None))[-1] == pytest.approx(1.18, abs=1e-6)


def test_frame_numbers_need_the_frame_rate(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("Frame,y\n" + "\n".join(f"{k + 40},{k}" for k in range(60)))
    with pytest.raises(RefusedTableError, match="--fps"):
        time_of(read_table(path), None)
    table = read_table(path)
    assert time_seconds(table, time_of(table, None, 24.0))[-1] == pytest.approx(59 / 24.0)


def test_stray_values_are_found_and_steps_bounces_and_noise_are_none() -> None:
    rng = np.random.default_rng(1)
    t = np.arange(0.0, 10.0, 0.02)
    smooth = np.sin(3.0 * t) + rng.normal(0.0, 0.003, len(t))
    for signal in (smooth, np.sign(np.sin(3.0 * t)), np.abs(smooth), np.round(smooth, 1)):
        assert not np.any(spikes(signal))
    wrong = smooth.copy()
    wrong[[50, 200, 201, 333]] += [2.0, -1.5, -1.4, 0.5]
    assert np.flatnonzero(spikes(wrong)).tolist() == [50, 200, 201, 333]
    assert turn_of(np.array([4000.0, 4095.0, 3.0, 60.0, 1.0, 4090.0])) == 4096.0
    assert turn_of(smooth) is None


# --- joints


def test_german_table_of_a_lever_that_never_reaches_the_end(tmp_path: Path) -> None:
    """Rows of commas and semicolons; the dead band is told in parts of 100 %, not of the largest command."""
    one = joint(np.random.default_rng(41), dead_time_s=0.15, lag_s=0.2, dead_band=0.12)
    rows = zip(one["stamp_ms"] * 1e-3, 0.8 * one["lever_pct"], one["boom_deg"], strict=True)
    text = "\n".join(f"{t:.3f};{u:.3f};{q:.4f}" for t, u, q in rows).replace(".", ",")
    path = tmp_path / "a.csv"
    path.write_text("Zeit [s];Hebel [%];Auslegerwinkel [°]\n" + text, encoding="utf-8")
    found = actuation_from_csv(path)
    assert found.evidence["command_full"] == 100.0
    _, band, _ = value(found, "valve_dead_band", "positive_ratio")
    assert band == pytest.approx(0.8 * 0.12, abs=0.01)
    low, _, high = value(found, "valve_dead_time", "extra_dead_time_s")
    assert low < 0.15 < high


def test_a_lever_that_moves_on_is_a_line_between_its_rows(tmp_path: Path) -> None:
    """At 12 Hz a held command would take half a period, 40 ms, off the dead time."""
    one = joint(np.random.default_rng(42), dead_time_s=0.2, rate_hz=250.0, noise_rad=2e-4)
    t = one["stamp_ms"] * 1e-3
    lever = np.interp(t, t[::200], one["lever_pct"][::200])
    late = np.interp(t - 0.2, t, lever, left=lever[0])
    angle = np.cumsum(late) * 0.004 * 0.3
    columns = {"t": t[::20], "lever": lever[::20], "boom_deg": angle[::20]}
    found = actuation_from_csv(write(tmp_path / "a.csv", columns))
    _, dead_time, _ = value(found, "valve_dead_time", "extra_dead_time_s")
    assert dead_time == pytest.approx(0.2, abs=0.01)


def test_two_commands_of_which_none_is_rest(tmp_path: Path) -> None:
    """Steps between two values of a servo valve whose neutral is not in the file."""
    t = np.arange(0.0, 20.0, 0.02)
    u = np.where(t % 4.3 < 2.0, 10.0, 5.0)
    late = np.concatenate([np.full(10, 10.0), u[:-10]])
    columns = {"t": t, "Boom Cmd": u, "Boom Ms": 60.0 + np.cumsum(8.0 * (late - 7.5)) * 0.02}
    columns["Boom Ms"] = np.concatenate([[60.0], columns["Boom Ms"][:-1]])
    columns["Boom Ms"] += np.random.default_rng(1).normal(0.0, 0.05, len(t))
    found = actuation_from_csv(write(tmp_path / "a.csv", columns))
    assert found.evidence["command_rest"] == pytest.approx(7.5, abs=0.3)
    low, _, high = value(found, "valve_dead_time", "extra_dead_time_s")
    assert low < 0.2 < high


# --- swings


# --- flights


def thrown(seed: int, drag_per_m: float, rate_hz: float = 60.0) -> Columns:
    return ball(np.random.default_rng(seed), drag_per_m, rate_hz=rate_hz)


def test_a_film_in_pixels_with_frame_numbers(tmp_path: Path) -> None:
    runs = [thrown(seed, drag_per_m=0.05, rate_hz=30.0) for seed in (7, 8)]
    for run in runs:
        run["frame"] = np.arange(len(run["t"])) + 143.0
        run["x_px"], run["y_px"] = 100.0 + 180.0 * run["x"], 900.0 - 180.0 * run["z"]
        for name in ("t", "x", "y", "z"):
            del run[name]
    path = write(tmp_path / "a.csv", joined(runs, shot=["1", "2"]))
    assert "--fps" in flight_from_csv(path).sentence
    found = flight_from_csv(path, fps=30.0)
    low, drag, high = value(found, "air_drag", "drag_per_m")
    assert drag == pytest.approx(0.05, rel=0.15)
    assert low < 0.05 < high


def test_the_vertical_is_where_things_fall_and_stray_points_are_left_out(tmp_path: Path) -> None:
    run = thrown(9, drag_per_m=0.06)
    run["y"], run["z"] = run["z"].copy(), -run["y"]
    run["x"][20] += 0.7
    found = flight_from_csv(write(tmp_path / "a.csv", run))
    assert "things fall along axis y" in notes_of(found)
    assert "1 stray values" in notes_of(found)
    low, _, high = value(found, "air_drag", "drag_per_m")
    assert low < 0.06 < high


def test_the_hand_before_and_the_ground_after_are_cut_off(tmp_path: Path) -> None:
    run = thrown(10, drag_per_m=0.06, rate_hz=100.0)
    x, z, h = run["x"], run["z"], 0.01
    vx, vz = (x[5] - x[0]) / (5 * h), (z[5] - z[0]) / (5 * h)
    swung = np.arange(-40, 0) * h
    hand = 0.5 * (swung + 0.4) ** 2 / 0.4
    hand_x, hand_z = x[0] + vx * (hand - hand[-1] - h), z[0] + vz * (hand - hand[-1] - h)
    still = np.ones(60)
    whole_x = np.concatenate([hand_x, x, still * x[-1]])
    whole_z = np.concatenate([hand_z, z, still * z[-1]])
    columns = {"t": np.arange(len(whole_x)) * h, "x": whole_x, "z": whole_z}
    found = flight_from_csv(write(tmp_path / "a.csv", columns))
    low, drag, high = value(found, "air_drag", "drag_per_m")
    assert drag == pytest.approx(0.06, rel=0.15)
    assert low < 0.06 < high


def test_a_paper_cone_falls_at_its_terminal_speed(tmp_path: Path) -> None:
    """A sonar above it measures the distance, which grows; x = ln cosh(sqrt(g k) t) / k."""
    t = np.arange(0.0, 1.4, 0.05)
    way = np.log(np.cosh(np.sqrt(9.81 * 3.2) * t)) / 3.2
    way = 0.3 + way + np.random.default_rng(11).normal(0.0, 0.001, len(t))
    found = flight_from_csv(
        write(tmp_path / "a.csv", {"t": t, "Position (m)": way}), "t", ["Position (m)"]
    )
    assert found.verdict is VerdictKind.EXPLAINED
    low, drag, high = value(found, "air_drag", "drag_per_m")
    assert drag == pytest.approx(3.2, rel=0.05)
    assert low < 3.2 < high
