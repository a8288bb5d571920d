"""Joints: effects of an independent plant, intervals, end stops, merged topics, servos, refused records."""

from pathlib import Path

import numpy as np
import pytest

from diagnosis.single_stage.actuation_problem import find_end_stops
from diagnosis.single_stage.csv_diagnosis import diagnose_actuation_csv
from diagnosis.verdict import Diagnosis, VerdictKind
from tests.diagnosis.single_stage.synthetic import (
    Columns,
    effects,
    join_notes,
    joined,
    joint,
    value,
    write,
)

STEP_S = 0.002
EXCAVATOR_EFFECTS = {"valve_dead_time", "valve_lag", "valve_dead_band"}
LEVELS = (1.0, -0.6, 0.3, -0.15, 0.45, -0.8, 0.6, -0.3)
SPAN_S = 36.0


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
    """Speed and position in steps of 2 ms, independent of the product."""
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
    """A table of steps with rests; `jitter` of the clock in sample periods."""
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
    for rate_hz, scale, jitter in ((50.0, 1.0, 0.0), (60.0, 850.0, 0.4)):
        path = record(
            tmp_path / "a.csv",
            rate_hz=rate_hz,
            scale=scale,
            jitter=jitter,
            dead_time_s=0.12,
            lag_s=0.25,
            band=(0.15, 0.12),
        )
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


def test_backlash_is_separated_from_a_dead_band(tmp_path: Path) -> None:
    found = diagnose_actuation_csv(record(tmp_path / "a.csv", gap=0.05))
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
    logged = np.clip(rows - round(command_late_s / STEP_S), 0, None)
    return {
        "time_s": rows * STEP_S,
        "cmd": lever[logged],
        "pos_rad": angles[rows] + rng.normal(0.0, 0.001, len(rows)),
    }


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
    time_s, position = free["time_s"], free["pos_rad"]
    speed = np.gradient(position, time_s)
    assert not find_end_stops(position, speed, free["cmd"], 0.001, 0.02, 5).places


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
