"""Anybody's CSV through the command line: guesses are named, bad data are refused, nothing crashes."""

import json
from pathlib import Path

import numpy as np
import pytest

from cli.main import main
from diagnosis.alone.reading.columns import outputs_of
from diagnosis.alone.reading.layout import RefusedTableError
from diagnosis.alone.reading.runs import split_runs, time_seconds
from diagnosis.alone.reading.tables import read_table
from diagnosis.verdict import Diagnosis
from tests.diagnosis.alone.answers import effects


def table(path: Path, header: str, *columns: np.ndarray) -> Path:
    rows = np.stack(columns, axis=1)
    np.savetxt(path, rows, delimiter=",", header=header, comments="", fmt="%.9g")
    return path


TIME_S = np.arange(0.0, 12.0, 0.02)
STEPS = np.where(TIME_S % 3.0 < 1.5, np.where(TIME_S % 6.0 < 3.0, 1.0, -0.6), 0.0)
MOVED = np.cumsum(0.4 * STEPS) * 0.02


def diagnose(tmp_path: Path, stage: str, path: Path, *more: str) -> tuple[int, Diagnosis]:
    out = tmp_path / "out.json"
    code = main(["diagnose", stage, str(path), "--json", str(out), *more])
    return code, Diagnosis.model_validate(json.loads(out.read_text()))


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ((TIME_S, STEPS * 0.0, MOVED), "constant channel"),
        ((TIME_S, STEPS, MOVED * 0.0 + 0.3), "constant channel"),
        ((TIME_S[::10], STEPS[::10], MOVED[::10]), "5 Hz"),
        ((np.where(TIME_S > 6.0, TIME_S - 3.0, TIME_S), STEPS, MOVED), "go back"),
        ((TIME_S, STEPS, np.where(TIME_S % 1.0 < 0.5, np.nan, MOVED)), "NaN"),
        ((TIME_S, STEPS, 0.5 * TIME_S), "does not follow"),
        ((TIME_S, STEPS, np.random.default_rng(3).normal(size=TIME_S.size)), "does not follow"),
        ((TIME_S[40:130], STEPS[40:130], MOVED[40:130]), "at least 2 s"),
        ((TIME_S[:10], STEPS[:10], MOVED[:10]), "empty or cut off"),
    ],
)
def test_bad_tables_are_refused_with_exit_code_four(
    tmp_path: Path, columns: tuple[np.ndarray, ...], words: str
) -> None:
    path = table(tmp_path / "a.csv", "time_s,command,position_rad", *columns)
    code, found = diagnose(tmp_path, "actuation", path)
    assert code == 4
    assert found.verdict == "bad_data"
    assert words in found.sentence


def test_commands_that_are_missing_are_held_and_told(tmp_path: Path) -> None:
    """Some programs leave out what has not changed; a cable that dropped out looks the same."""
    changed = np.concatenate([[True], np.diff(STEPS) != 0.0]) | (np.arange(STEPS.size) % 3 > 0)
    sparse = np.where(changed, STEPS, np.nan)
    path = table(tmp_path / "a.csv", "time_s,command,position_rad", TIME_S, sparse, MOVED)
    code, found = diagnose(tmp_path, "actuation", path, "--command", "command")
    assert (code, found.verdict) == (0, "none")
    assert any(f"no number in {int(np.sum(~changed))} of" in n for n in found.evidence["notes"])


def test_missing_or_unclear_columns_are_named_with_the_option(tmp_path: Path) -> None:
    path = table(
        tmp_path / "a.csv", "time_s,boom_cmd,arm_cmd,boom_pos", TIME_S, STEPS, STEPS, MOVED
    )
    code, found = diagnose(tmp_path, "actuation", path)
    assert code == 4
    assert "boom_cmd and arm_cmd would fit" in found.sentence
    assert "--command" in found.sentence
    code, found = diagnose(tmp_path, "actuation", path, "--command", "bom_cmd")
    assert "no column 'bom_cmd'" in found.sentence
    assert main(["diagnose", "actuation", str(path), "--command", "boom_cmd,arm_cmd"]) == 1


def test_holes_at_the_ends_and_an_html_page(tmp_path: Path) -> None:
    ends = MOVED.copy()
    ends[:7] = np.nan
    ends[-4:] = np.nan
    path = table(tmp_path / "a.csv", "t_ms,u,q_rad", TIME_S * 1000.0, STEPS, ends)
    page = tmp_path / "out.html"
    code, found = diagnose(tmp_path, "actuation", path, "--html", str(page))
    assert code == 0
    assert found.verdict == "none"
    assert any("11 rows without a number at the ends" in note for note in found.evidence["notes"])
    text = page.read_text()
    assert "<svg" in text
    assert "<script src" not in text


def test_two_joints_give_one_result_with_both_inside(tmp_path: Path) -> None:
    late = np.concatenate([np.zeros(10), STEPS[:-10]])
    slow = np.cumsum(0.4 * late) * 0.02
    path = table(tmp_path / "a.csv", "t,c1,c2,q1_rad,q2_rad", TIME_S, STEPS, STEPS, MOVED, slow)
    code, found = diagnose(
        tmp_path, "actuation", path, "--command", "c1,c2", "--position", "q1_rad,q2_rad"
    )
    assert code == 0
    assert [(e.effect, e.joint) for e in found.causes[0].effects] == [("valve_dead_time", "q2_rad")]
    assert set(found.evidence["parts"]) == {"q1_rad", "q2_rad"}


def test_a_file_that_is_no_table_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    for content in ("", "hello\n" * 50, "1,2,3\n" * 50, "\x00\x01\x02" * 100):
        path.write_text(content)
        for stage in ("actuation", "swing", "flight"):
            code, found = diagnose(tmp_path, stage, path)
            assert code == 4, (content, stage, found.sentence)
    assert diagnose(tmp_path, "flight", tmp_path / "missing.csv")[0] == 4


def test_times_take_their_unit_from_name_or_step(tmp_path: Path) -> None:
    for header, factor in (("t_us", 1e6), ("stamp", 1e9), ("t", 1e3), ("time", 1.0)):
        path = table(tmp_path / "a.csv", f"{header},u", np.round(TIME_S * factor, 3), STEPS)
        assert time_seconds(read_table(path), header)[-1] == pytest.approx(TIME_S[-1], rel=1e-4)


def test_a_restart_of_time_begins_a_run_and_chaos_is_refused() -> None:
    runs = split_runs(np.concatenate([TIME_S, TIME_S, TIME_S + 20.0]))
    assert runs.max() == 2
    with pytest.raises(RefusedTableError, match="clock jumps"):
        split_runs(np.random.default_rng(0).uniform(0.0, 10.0, 200))


def test_of_a_position_and_its_speed_the_position_is_taken(tmp_path: Path) -> None:
    path = table(
        tmp_path / "a.csv", "time_s,joystick,slew_rad_per_s,slew_rad", TIME_S, STEPS, STEPS, MOVED
    )
    found = read_table(path)
    assert outputs_of(found, ["time_s", "joystick"]) == (["slew_rad"], False)
    alone = read_table(
        table(tmp_path / "b.csv", "time_s,joystick,slew_rad_per_s", TIME_S, STEPS, STEPS)
    )
    assert outputs_of(alone, ["time_s", "joystick"]) == (["slew_rad_per_s"], True)


def test_long_records_are_thinned_out(tmp_path: Path) -> None:
    """100 000 rows at 10 kHz; a million take 10 times as long to read (docs/diagnosis_one_stage.md)."""
    t = 1e-4 * np.arange(100_000)
    angle = 0.5 * np.exp(-0.05 * t) * np.cos(3.0 * t)
    angle += np.random.default_rng(7).normal(0.0, 0.002, len(t))
    code, found = diagnose(tmp_path, "swing", table(tmp_path / "a.csv", "t,angle_rad", t, angle))
    assert code == 0
    assert effects(found) == {"passive_viscous_friction"}
    assert found.evidence["samples"] <= 2000
