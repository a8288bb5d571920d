"""Time columns, output columns, outliers, wrapped counters, runs and commands of a table."""

from pathlib import Path

import numpy as np
import pytest

from diagnosis.tables.cells import RefusedTableError
from diagnosis.tables.column_units import find_outliers, find_wrap_period, joint_output_in_si
from diagnosis.tables.columns import (
    find_command_column,
    find_output_columns,
    find_time_column,
    split_list,
)
from diagnosis.tables.joint_record import CommandScale, JointRecord
from diagnosis.tables.table import Table, read_table
from diagnosis.tables.time_series import split_runs, time_in_seconds

TIME_S = np.arange(0.0, 12.0, 0.02)


def table(path: Path, header: str, *columns: np.ndarray) -> Table:
    np.savetxt(
        path, np.stack(columns, axis=1), delimiter=",", header=header, comments="", fmt="%.9g"
    )
    return read_table(path)


def test_time_columns_of_other_programs_are_found(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    for header, cells in (
        ("Zeit [s]", [f"{0.02 * k:.2f}" for k in range(60)]),
        ("clock", [f"03.05.2024 10:00:{0.02 * k:06.3f}" for k in range(60)]),
        ("stamp", [f"1:{0.02 * k:05.2f}" for k in range(60)]),
        ("sec,nanosec", [f"{100 + k // 50},{20_000_000 * (k % 50)}" for k in range(60)]),
        ("tick_of_it", [f"{0.02 * k:.2f}" for k in range(60)]),
    ):
        path.write_text(f"{header},q\n" + "\n".join(f"{c},{k % 7}" for k, c in enumerate(cells)))
        found = read_table(path)
        last_s = time_in_seconds(found, find_time_column(found, None))[-1]
        assert last_s == pytest.approx(1.18, abs=1e-6), header


def test_frame_numbers_need_the_frame_rate(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("Frame,y\n" + "\n".join(f"{k + 40},{k}" for k in range(60)))
    with pytest.raises(RefusedTableError, match="--fps"):
        find_time_column(read_table(path), None)
    found = read_table(path)
    last_s = time_in_seconds(found, find_time_column(found, None, 24.0))[-1]
    assert last_s == pytest.approx(59 / 24.0)


UNITS_OF_NAMES = (
    *(
        ("q [\u00b0]", np.pi / 180, "rad"),
        ("q_\u00ba", np.pi / 180, "rad"),
        ("q (mrad)", 1e-3, "rad"),
    ),
    *(("q_rev", 2 * np.pi, "rad"), ("q (gon)", np.pi / 200, "rad"), ("q rad", 1.0, "rad")),
    *(("q (millimeter)", 1e-3, "m"), ("q_dm", 0.1, "m"), ("q", 1.0, "unit")),
)
UNITS_OF_SPEEDS = (
    *(
        ("v_rpm", np.pi / 30, "rad"),
        ("v (deg/min)", np.pi / 10800, "rad"),
        ("v [km/h]", 1 / 3.6, "m"),
    ),
    *(("v_mph", 0.44704, "m"), ("v (mm/min)", 1e-3 / 60, "m"), ("v_mm_min", 1e-3, "m")),
)


def test_units_in_names_of_columns(tmp_path: Path) -> None:
    values = np.sin(TIME_S)
    for is_speed, units in ((False, UNITS_OF_NAMES), (True, UNITS_OF_SPEEDS)):
        for name, factor, unit in units:
            found = table(tmp_path / "a.csv", f"t,{name}", TIME_S, values)
            converted, seen = joint_output_in_si(found, name, found.numbers(name), is_speed)
            assert seen == unit, name
            assert np.allclose(converted, factor * values, atol=1e-6 * factor), name
            assert len(found.notes) == (factor != 1.0), name


def test_the_unit_of_time_follows_from_name_or_step(tmp_path: Path) -> None:
    for header, factor in (
        ("t_us", 1e6),
        ("stamp", 1e9),
        ("t", 1e3),
        ("time", 1.0),
        ("t_h", 1 / 3600),
    ):
        found = table(tmp_path / "a.csv", f"{header},u", np.round(TIME_S * factor, 9), TIME_S)
        assert time_in_seconds(found, header)[-1] == pytest.approx(TIME_S[-1], rel=1e-4), header


def test_a_restart_of_time_begins_a_run_and_unsorted_times_are_refused() -> None:
    runs = split_runs(np.concatenate([TIME_S, TIME_S, TIME_S + 20.0]))
    assert runs.max() == 2
    with pytest.raises(RefusedTableError, match="clock jumps"):
        split_runs(np.random.default_rng(0).uniform(0.0, 10.0, 200))


def test_a_goal_is_a_command_and_a_duplicate_time_column_is_ignored(tmp_path: Path) -> None:
    columns = [TIME_S, TIME_S, np.sin(TIME_S), np.cos(TIME_S)]
    found = table(tmp_path / "a.csv", "time,stamp,goal_rad,pos_rad", *columns)
    assert find_time_column(found, None) == "time"
    assert find_command_column(found, "time", None) == "goal_rad"


def test_a_current_may_be_a_response_and_is_not_taken_as_the_command(tmp_path: Path) -> None:
    found = table(tmp_path / "a.csv", "time,motor_current,pos_rad", TIME_S, TIME_S, TIME_S)
    with pytest.raises(RefusedTableError, match="give --command COLUMN"):
        find_command_column(found, "time", "pos_rad")


def test_a_position_is_preferred_to_its_speed(tmp_path: Path) -> None:
    columns = [TIME_S] * 4
    both = table(tmp_path / "a.csv", "time_s,joystick,slew_rad_per_s,slew_rad", *columns)
    assert find_output_columns(both, ["time_s", "joystick"]) == (["slew_rad"], False)
    speed = table(tmp_path / "b.csv", "time_s,joystick,slew_rad_per_s", *columns[:3])
    assert find_output_columns(speed, ["time_s", "joystick"]) == (["slew_rad_per_s"], True)


def test_outliers_are_found_and_steps_bounces_and_noise_are_kept() -> None:
    rng = np.random.default_rng(1)
    t = np.arange(0.0, 10.0, 0.02)
    smooth = np.sin(3.0 * t) + rng.normal(0.0, 0.003, len(t))
    for signal in (smooth, np.sign(np.sin(3.0 * t)), np.abs(smooth), np.round(smooth, 1)):
        assert not np.any(find_outliers(signal))
    wrong = smooth.copy()
    wrong[[50, 200, 201, 333]] += [2.0, -1.5, -1.4, 0.5]
    assert np.flatnonzero(find_outliers(wrong)).tolist() == [50, 200, 201, 333]


def test_the_period_of_a_wrapped_counter_is_found() -> None:
    assert find_wrap_period(np.array([4000.0, 4095.0, 3.0, 60.0, 1.0, 4090.0])) == 4096.0
    assert find_wrap_period(np.sin(TIME_S)) is None


def test_a_command_that_changes_within_a_tick_counts_for_its_share() -> None:
    time_s = np.array([0.0, 0.013, 0.031, 0.05])
    command = np.array([0.0, 1.0, -1.0, 0.0])
    record = JointRecord(time_s, command, time_s, np.zeros(4, dtype=np.int64), False, "rad")
    scale = CommandScale(0.0, 1.0, False, 0.01, ())
    on_grid = scale.on_grid(record, np.arange(0.0, 0.05, 0.01))
    np.testing.assert_allclose(on_grid, [0.0, 0.7, 1.0, -0.8, -1.0], atol=1e-9)


def test_a_path_without_times_is_refused(tmp_path: Path) -> None:
    found = table(tmp_path / "a.csv", "x_m,z_m", TIME_S, 2.0 * TIME_S)
    with pytest.raises(RefusedTableError, match="a path alone does not tell"):
        find_time_column(found, None)


def test_a_comma_within_a_name_does_not_separate(tmp_path: Path) -> None:
    found = table(tmp_path / "a.csv", 't,"Lever, left",q', TIME_S, TIME_S, TIME_S)
    assert split_list("Lever, left", found) == ["Lever, left"]
    assert split_list("q,lever,left", found) == ["q", "Lever, left"]
    assert split_list("t, q", found) == ["t", "q"]


def test_german_names_of_command_and_position_are_found(tmp_path: Path) -> None:
    wave = np.sin(TIME_S)
    for command, position in (("Befehl", "Winkel_rad"), ("Sollwert", "Istwert")):
        found = table(tmp_path / "a.csv", f"Zeit,{command},{position}", TIME_S, wave, wave)
        assert find_command_column(found, "Zeit", None) == command
        assert find_output_columns(found, ["Zeit", command]) == ([position], False)
