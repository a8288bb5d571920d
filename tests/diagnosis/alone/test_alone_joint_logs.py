"""Logs of joints as they are: end stops, merged topics, clocks that differ, servos."""

from pathlib import Path

import numpy as np

from diagnosis.alone.diagnose import actuation_from_csv
from diagnosis.verdict import VerdictKind
from tests.diagnosis.alone.answers import effects, notes_of, value
from tests.diagnosis.alone.planted import Columns, write

STEP_S = 0.002


def operated(
    seed: int,
    stops: tuple[float, float] = (-np.inf, np.inf),
    command_late_s: float = 0.0,
    span_s: float = 60.0,
) -> Columns:
    """A joint of 0.4 rad/s, dead time 0.15 s, lag 0.15 s, bands of 10 %, under held levers at 50 Hz."""
    rng = np.random.default_rng(seed)
    count = round(span_s / STEP_S)
    lever = np.zeros(count)
    k, way = 0, 1.0
    while k < count:
        held = round(rng.uniform(0.6, 2.2) / STEP_S)
        if rng.random() < 0.65:
            way = -way if rng.random() < 0.75 else way
            lever[k : k + held] = way * rng.uniform(0.2, 1.0)
        k += held
    speed = angle = 0.0
    angles = np.zeros(count)
    for k in range(count):
        u = lever[max(k - 75, 0)]
        steady = 0.4 * np.sign(u) * max(abs(u) - 0.1, 0.0) / 0.9
        speed += STEP_S / 0.15 * (steady - speed)
        angle += STEP_S * speed
        if not stops[0] < angle < stops[1]:
            angle, speed = float(np.clip(angle, *stops)), 0.0
        angles[k] = angle
    rows = np.arange(0, count, 10)
    told = np.clip(rows - round(command_late_s / STEP_S), 0, None)
    return {
        "time_s": rows * STEP_S,
        "cmd": lever[told],
        "pos_rad": angles[rows] + rng.normal(0.0, 0.001, len(rows)),
    }


def test_stays_at_end_stops_are_left_out(tmp_path: Path) -> None:
    free = operated(5)
    low, high = np.quantile(free["pos_rad"], [0.06, 0.94])
    found = actuation_from_csv(write(tmp_path / "a.csv", operated(5, (float(low), float(high)))))
    assert effects(found) == {"valve_dead_band", "valve_dead_time", "valve_lag"}
    low, _, high = value(found, "valve_dead_band", "positive_ratio")
    assert low < 0.1 < high
    assert "end stop" in notes_of(found)
    whole = actuation_from_csv(write(tmp_path / "a.csv", free))
    assert "end stop" not in notes_of(whole)


def test_rows_of_merged_topics_are_no_missing_numbers(tmp_path: Path) -> None:
    run = operated(6)
    rows: list[str] = []
    for k, (t, u, q) in enumerate(zip(*run.values(), strict=True)):
        rows.append(f"{t:.4f},,{q:.5f}")
        if k % 3 == 0:
            rows.append(f"{t + 0.001:.4f},{u:.4f},")
        rows.extend(f"{t + 0.002 + 0.001 * n:.4f},," for n in range(4))
    path = tmp_path / "a.csv"
    path.write_text("time_s,cmd,pos_rad\n" + "\n".join(rows) + "\n")
    found = actuation_from_csv(path)
    assert effects(found) == {"valve_dead_band", "valve_dead_time", "valve_lag"}
    low, _, high = value(found, "valve_dead_time", "extra_dead_time_s")
    assert low < 0.15 < high
    assert "held from before" in notes_of(found)
    assert "taken as rows of something else" in notes_of(found)


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
    found = actuation_from_csv(write(tmp_path / "a.csv", servo))
    assert effects(found) == {"speed_limit"}
    low, _, high = value(found, "speed_limit", "limit_rad_m_per_s")
    assert low < 3.0 < high
    assert found.causes[0].effects[0].parameters["limit_rad_m_per_s"].unit == "rad/s"


def test_a_motion_before_its_command_is_refused(tmp_path: Path) -> None:
    found = actuation_from_csv(write(tmp_path / "a.csv", operated(8, command_late_s=0.6)))
    assert found.verdict is VerdictKind.BAD_DATA
    assert "the motion leads the command by" in found.sentence
    assert "shift one column" in found.sentence


def test_a_goal_is_a_command_and_the_same_times_twice_are_one_clock(tmp_path: Path) -> None:
    run = operated(9, span_s=20.0)
    named = {
        "time": run["time_s"],
        "stamp": run["time_s"],
        "goal_rad": run["cmd"],
        "pos_rad": run["pos_rad"],
    }
    notes = notes_of(actuation_from_csv(write(tmp_path / "a.csv", named)))
    assert "column 'goal_rad' taken as the command" in notes
    assert "column 'time' taken as the time" in notes
