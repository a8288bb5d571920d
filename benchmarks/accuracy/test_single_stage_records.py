"""One stage alone: records of joints, swings and balls as people have them, and what is found in them."""

from pathlib import Path

import numpy as np
import pytest

from diagnosis.single_stage.csv_diagnosis import (
    diagnose_actuation_csv,
    diagnose_flight_csv,
    diagnose_swing_csv,
)
from diagnosis.single_stage.fit import fit_structure
from diagnosis.single_stage.swing_diagnosis import diagnose_swing
from diagnosis.single_stage.swing_problem import COULOMB_PARAMETER, make_swing_problem
from diagnosis.tables.free_swings import SwingRecord
from diagnosis.verdict import VerdictKind
from tests.diagnosis.single_stage.joint_records import STEP_S, operated, record
from tests.diagnosis.single_stage.synthetic import (
    ball,
    caught_swing,
    effects,
    join_notes,
    joined,
    joint,
    pendulum,
    swing_angles,
    thrown,
    value,
    write,
    write_angles,
    write_flights,
)

AXES = ("x", "y", "z")
DRAG = ("air_drag", "drag_per_m")
EXCAVATOR_EFFECTS = {"valve_dead_time", "valve_lag", "valve_dead_band"}
VELOCITIES = [(7.0, 0.5, 5.0), (9.0, -0.5, 4.0), (4.0, 0.0, 6.0)]
VISCOUS = ("passive_viscous_friction", "extra_viscous_per_s")


def test_uneven_time_stamps_and_another_scale_change_nothing(tmp_path: Path) -> None:
    path = record(
        tmp_path / "a.csv",
        rate_hz=60.0,
        scale=850.0,
        jitter=0.4,
        dead_time_s=0.12,
        lag_s=0.25,
        band=(0.15, 0.12),
    )
    found = diagnose_actuation_csv(path, "time", "cmd", "position_rad")
    assert effects(found) == EXCAVATOR_EFFECTS
    for effect, parameter, truth in (
        ("valve_dead_time", "extra_dead_time_s", 0.12),
        ("valve_lag", "extra_lag_s", 0.25),
        ("valve_dead_band", "positive_ratio", 0.15),
    ):
        assert value(found, effect, parameter)[1] == pytest.approx(truth, abs=0.03), effect


def test_the_rate_of_a_servo_is_limited_by_a_speed(tmp_path: Path) -> None:
    rng = np.random.default_rng(7)
    goal = np.repeat(rng.uniform(-0.8, 0.8, 30), 500 + rng.integers(0, 9))
    place, places = 0.0, np.zeros(len(goal))
    for k, wanted in enumerate(goal):
        place += float(np.clip(wanted - place, -3.0 * STEP_S, 3.0 * STEP_S))
        places[k] = place
    rows = np.arange(0, len(goal), 10)
    seen = places[rows] + rng.normal(0.0, 0.001, len(rows))
    servo = {"time_s": rows * STEP_S, "cmd_rad": goal[rows], "pos_rad": seen}
    found = diagnose_actuation_csv(write(tmp_path / "a.csv", servo))
    assert effects(found) == {"speed_limit"}
    low, _, high = value(found, "speed_limit", "limit_rad_m_per_s")
    assert low < 3.0 < high
    assert found.causes[0].effects[0].parameters["limit_rad_m_per_s"].unit == "rad/s"


def test_several_runs_of_a_joint_are_used_together(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    runs = [joint(rng, dead_time_s=0.2) for _ in range(2)]
    for run in runs:
        for name in list(run):
            run[name] = run[name][:700]
        run["boom_deg"] += rng.uniform(-20.0, 20.0)
    path = write(tmp_path / "a.csv", joined(runs))
    found = diagnose_actuation_csv(path, "stamp_ms", "lever_pct", "boom_deg")
    fitted = {e.effect: e.parameters for e in found.causes[0].effects}
    low, high = fitted["valve_dead_time"]["extra_dead_time_s"].ci90
    assert low < 0.2 < high
    assert "2 runs" in join_notes(found)


def test_a_continuous_command_is_interpolated(tmp_path: Path) -> None:
    """At 12 Hz a held command would shorten the dead time by half a period, 40 ms."""
    one = joint(np.random.default_rng(42), dead_time_s=0.2, rate_hz=250.0, noise_rad=2e-4)
    t = one["stamp_ms"] * 1e-3
    lever = np.interp(t, t[::200], one["lever_pct"][::200])
    late = np.interp(t - 0.2, t, lever, left=lever[0])
    angle = np.cumsum(late) * 0.004 * 0.3
    columns = {"t": t[::20], "lever": lever[::20], "boom_deg": angle[::20]}
    found = diagnose_actuation_csv(write(tmp_path / "a.csv", columns))
    _, dead_time, _ = value(found, "valve_dead_time", "extra_dead_time_s")
    assert dead_time == pytest.approx(0.2, abs=0.01)


def test_rest_may_lie_between_two_commands(tmp_path: Path) -> None:
    """Steps between two values of a servo valve whose neutral is not in the file."""
    t = np.arange(0.0, 20.0, 0.02)
    u = np.where(t % 4.3 < 2.0, 10.0, 5.0)
    late = np.concatenate([np.full(10, 10.0), u[:-10]])
    columns = {"t": t, "Boom Cmd": u, "Boom Ms": 60.0 + np.cumsum(8.0 * (late - 7.5)) * 0.02}
    columns["Boom Ms"] = np.concatenate([[60.0], columns["Boom Ms"][:-1]])
    columns["Boom Ms"] += np.random.default_rng(1).normal(0.0, 0.05, len(t))
    found = diagnose_actuation_csv(write(tmp_path / "a.csv", columns))
    assert found.evidence["command_rest"] == pytest.approx(7.5, abs=0.3)
    low, _, high = value(found, "valve_dead_time", "extra_dead_time_s")
    assert low < 0.2 < high


def test_blank_cells_of_merged_topics_are_not_missing_values(tmp_path: Path) -> None:
    run = operated(6, span_s=30.0)
    rows: list[str] = []
    for k, (t, u, q) in enumerate(zip(*run.values(), strict=True)):
        rows.append(f"{t:.4f},,{q:.5f}")
        if k % 3 == 0:
            rows.append(f"{t + 0.001:.4f},{u:.4f},")
        rows.extend(f"{t + 0.002 + 0.001 * n:.4f},," for n in range(4))
    path = tmp_path / "a.csv"
    path.write_text("time_s,cmd,pos_rad\n" + "\n".join(rows) + "\n")
    found = diagnose_actuation_csv(path)
    assert effects(found) == EXCAVATOR_EFFECTS
    low, _, high = value(found, "valve_dead_time", "extra_dead_time_s")
    assert low < 0.15 < high
    assert "held from before" in join_notes(found)
    assert "taken as rows of something else" in join_notes(found)


def test_joints_pair_up_by_their_names(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    boom, arm = joint(rng), joint(rng, dead_time_s=0.15)
    both = {
        "t_ms": boom["stamp_ms"],
        "boom_cmd": boom["lever_pct"],
        "arm_cmd": arm["lever_pct"],
        "arm_pos_deg": arm["boom_deg"],
        "boom_pos_deg": boom["boom_deg"],
    }
    found = diagnose_actuation_csv(write(tmp_path / "a.csv", both))
    assert [(e.effect, e.joint) for e in found.causes[0].effects] == [
        ("valve_dead_time", "arm_pos_deg")
    ]
    assert set(found.evidence["parts"]) == {"boom_pos_deg", "arm_pos_deg"}


def test_end_stops_are_excluded(tmp_path: Path) -> None:
    free = operated(5)
    low, high = np.quantile(free["pos_rad"], [0.06, 0.94])
    found = diagnose_actuation_csv(
        write(tmp_path / "a.csv", operated(5, (float(low), float(high))))
    )
    assert effects(found) == EXCAVATOR_EFFECTS
    low, _, high = value(found, "valve_dead_band", "positive_ratio")
    assert low < 0.1 < high
    assert "end stop" in join_notes(found)


def test_a_motion_that_leads_its_command_is_refused(tmp_path: Path) -> None:
    found = diagnose_actuation_csv(
        write(tmp_path / "a.csv", operated(8, command_late_s=0.6, span_s=30.0))
    )
    assert found.verdict is VerdictKind.BAD_DATA
    assert "the motion leads the command by" in found.sentence
    assert "shift one column" in found.sentence


def test_a_german_table_with_decimal_commas_is_read(tmp_path: Path) -> None:
    """The lever never reaches its end: dead bands are shares of 100 %, not of the largest command."""
    one = joint(np.random.default_rng(41), dead_time_s=0.15, lag_s=0.2, dead_band=0.12)
    rows = zip(one["stamp_ms"] * 1e-3, 0.8 * one["lever_pct"], one["boom_deg"], strict=True)
    text = "\n".join(f"{t:.3f};{u:.3f};{q:.4f}" for t, u, q in rows).replace(".", ",")
    path = tmp_path / "a.csv"
    path.write_text("Zeit [s];Hebel [%];Auslegerwinkel [°]\n" + text, encoding="utf-8")
    found = diagnose_actuation_csv(path)
    assert found.evidence["command_full"] == 100.0
    _, band, _ = value(found, "valve_dead_band", "positive_ratio")
    assert band == pytest.approx(0.8 * 0.12, abs=0.01)
    low, _, high = value(found, "valve_dead_time", "extra_dead_time_s")
    assert low < 0.15 < high


def test_a_stopped_swing_has_the_friction_that_acted_before(tmp_path: Path) -> None:
    one = caught_swing(4, coulomb=0.0)
    path = write(tmp_path / "a.csv", {name: one[name] for name in ("t", "angle_rad")})
    found = diagnose_swing_csv(path)
    assert effects(found) == {VISCOUS[0]}
    assert value(found, *VISCOUS)[1] == pytest.approx(0.05, rel=0.03)
    assert "a hand or an obstacle ends it" in join_notes(found)


def test_a_clipped_angle_keeps_its_friction(tmp_path: Path) -> None:
    one = pendulum(np.random.default_rng(5), viscous=0.1, noise_rad=0.001)
    limit = 0.75 * float(np.max(np.abs(one["theta_deg"])))
    angle = np.clip(one["theta_deg"], -limit, limit)
    found = diagnose_swing_csv(write(tmp_path / "a.csv", {"t": one["t"], "theta_deg": angle}))
    assert effects(found) == {VISCOUS[0]}
    assert value(found, *VISCOUS)[1] == pytest.approx(0.1, rel=0.02)
    assert "the angle is cut off" in join_notes(found)


def test_a_short_record_does_not_decide_between_two_frictions() -> None:
    t = np.arange(71) / 15.0
    fine = swing_angles(viscous=0.067, coulomb=0.165, start=0.93, frequency=6.95, span_s=5.0)
    angle = fine[np.round(1000.0 * t).astype(int)]
    angle += np.random.default_rng(4).normal(0.0, 0.0034, len(t))
    found = diagnose_swing((SwingRecord(t, angle),))
    assert 0.5 < max(cause.probability for cause in found.causes) < 0.95


def test_a_wrong_length_shows_against_a_reference(tmp_path: Path) -> None:
    path = write_angles(tmp_path / "a.csv", swing_angles(viscous=0.06, span_s=7.0), rate_hz=25.0)
    found = diagnose_swing_csv(path, length_m=0.9)
    _, ratio, _ = value(found, "gripper_length", "extra_length_ratio")
    assert 0.9 * (1.0 + ratio) == pytest.approx(9.81 / 9.0, rel=0.01)


def test_a_growing_swing_is_unknown(tmp_path: Path) -> None:
    t = np.arange(0.0, 16.0, 0.04)
    angle = 0.1 * np.exp(0.02 * t) * np.cos(4.0 * t)
    angle += np.random.default_rng(6).normal(0.0, 0.002, len(t))
    found = diagnose_swing_csv(write(tmp_path / "a.csv", {"t": t, "angle_rad": angle}))
    assert found.verdict is VerdictKind.UNKNOWN
    assert "energy is fed in" in found.sentence
    assert "used: 0 to 15.96 s" in join_notes(found)


def test_a_swing_of_large_amplitude_converges() -> None:
    angle = swing_angles(coulomb=0.3, start=np.radians(120.0), frequency=5.0, span_s=15.0)[::20]
    seen = angle + np.random.default_rng(3).normal(0.0, 0.003, len(angle))
    problem = make_swing_problem((SwingRecord(np.arange(len(seen)) / 50.0, seen),), np.nan, 0.003)
    dry = tuple(o for o in problem.options if o.key == "passive_coulomb_friction")
    found = fit_structure(problem, dry, {})
    assert np.sqrt(found.mean_square) < 1.5 * 0.003
    assert found.as_mapping()[COULOMB_PARAMETER] == pytest.approx(0.3, rel=0.01)


def test_gravity_alone_needs_no_effect(tmp_path: Path) -> None:
    flights = [thrown(v) for v in VELOCITIES[:2]]
    found = diagnose_flight_csv(write_flights(tmp_path / "a.csv", flights, 50.0))
    assert found.verdict is VerdictKind.NONE
    assert found.evidence["flights"] == 2


def test_velocities_without_positions_suffice(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    runs = [ball(rng, drag_per_m=0.05, noise_m=0.0) for _ in range(2)]
    for run in runs:
        h = run["t"][1]
        for axis in AXES:
            run[f"v{axis}"] = np.gradient(run[axis], h)
            run[f"v{axis}"][[0, -1]] = np.nan
            run[f"v{axis}"] += rng.normal(0.0, 0.02, len(run["t"]))
            del run[axis]
    found = diagnose_flight_csv(write(tmp_path / "a.csv", joined(runs)))
    assert effects(found) == {"air_drag"}
    assert "are speeds" in join_notes(found)


def test_pixels_are_scaled_by_gravity_and_frames_need_their_rate(tmp_path: Path) -> None:
    runs = [ball(np.random.default_rng(seed), 0.05, rate_hz=30.0) for seed in (7, 8)]
    films = [
        {
            "frame": np.arange(len(run["t"])) + 143.0,
            "x_px": 100.0 + 180.0 * run["x"],
            "y_px": 900.0 - 180.0 * run["z"],
        }
        for run in runs
    ]
    path = write(tmp_path / "a.csv", joined(films, shot=["1", "2"]))
    assert "--fps" in diagnose_flight_csv(path).sentence
    found = diagnose_flight_csv(path, fps=30.0)
    assert "points down" in join_notes(found)
    assert "pixels: 1" in join_notes(found)
    low, drag, high = value(found, *DRAG)
    assert drag == pytest.approx(0.05, rel=0.15)
    assert low < 0.05 < high


def test_the_vertical_is_found_by_gravity_and_outliers_are_removed(tmp_path: Path) -> None:
    run = ball(np.random.default_rng(9), drag_per_m=0.06)
    run["y"], run["z"] = run["z"].copy(), -run["y"]
    run["x"][20] += 0.7
    found = diagnose_flight_csv(write(tmp_path / "a.csv", run))
    assert "things fall along axis y" in join_notes(found)
    assert "1 stray values" in join_notes(found)
    low, _, high = value(found, *DRAG)
    assert low < 0.06 < high


def test_balls_are_separated_by_label_and_mixed_flights_are_refused(tmp_path: Path) -> None:
    rng = np.random.default_rng(6)
    runs = [ball(rng, drag_per_m=k, is_drop=True) for k in (0.0, 0.12)]
    labelled = joined([{"t": run["t"], "z": run["z"]} for run in runs], what=["steel", "foam"])
    parts = diagnose_flight_csv(write(tmp_path / "a.csv", labelled)).evidence["parts"]
    assert (parts["steel"]["verdict"], parts["foam"]["verdict"]) == ("none", "explained")
    del labelled["what"]
    mixed = diagnose_flight_csv(write(tmp_path / "a.csv", labelled))
    assert mixed.verdict is VerdictKind.BAD_DATA
    assert "disagree" in mixed.sentence
    assert "--group" in mixed.sentence


def test_long_records_are_decimated(tmp_path: Path) -> None:
    """100 000 rows at 10 kHz."""
    t = 1e-4 * np.arange(100_000)
    angle = 0.5 * np.exp(-0.05 * t) * np.cos(3.0 * t)
    angle += np.random.default_rng(7).normal(0.0, 0.002, len(t))
    found = diagnose_swing_csv(write(tmp_path / "a.csv", {"t": t, "angle_rad": angle}))
    assert effects(found) == {"passive_viscous_friction"}
    assert found.evidence["samples"] <= 2000
