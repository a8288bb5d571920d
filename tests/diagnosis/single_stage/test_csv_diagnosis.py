"""Single-stage diagnoses through the command line: guessed columns, refused files, exit codes."""

import json
from pathlib import Path

import numpy as np

from cli.main import main
from diagnosis.single_stage.csv_diagnosis import (
    diagnose_actuation_csv,
    diagnose_flight_csv,
    diagnose_swing_csv,
)
from diagnosis.verdict import Diagnosis, VerdictKind
from tests.diagnosis.single_stage.synthetic import effects

TIME_S = np.arange(0.0, 12.0, 0.02)
STEPS = np.where(TIME_S % 3.0 < 1.5, np.where(TIME_S % 6.0 < 3.0, 1.0, -0.6), 0.0)
MOVED = np.cumsum(0.4 * STEPS) * 0.02


def table(path: Path, header: str, *columns: np.ndarray) -> Path:
    rows = np.stack(columns, axis=1)
    np.savetxt(path, rows, delimiter=",", header=header, comments="", fmt="%.9g")
    return path


def diagnose(tmp_path: Path, stage: str, path: Path, *more: str) -> tuple[int, Diagnosis]:
    out = tmp_path / "out.json"
    code = main(["diagnose", stage, str(path), "--json", str(out), *more])
    return code, Diagnosis.model_validate(json.loads(out.read_text()))


def test_unusable_tables_are_refused_with_exit_code_four(tmp_path: Path) -> None:
    for time_s, command, position, words in (
        (TIME_S, STEPS * 0.0, MOVED, "constant channel"),
        (TIME_S, STEPS, MOVED * 0.0 + 0.3, "constant channel"),
        (TIME_S[::10], STEPS[::10], MOVED[::10], "5 Hz"),
        (np.where(TIME_S > 6.0, TIME_S - 3.0, TIME_S), STEPS, MOVED, "go back"),
        (TIME_S, STEPS, np.where(TIME_S % 1.0 < 0.5, np.nan, MOVED), "NaN"),
        (TIME_S, STEPS, 0.5 * TIME_S, "does not follow"),
        (TIME_S[40:130], STEPS[40:130], MOVED[40:130], "at least 2 s"),
        (TIME_S[:10], STEPS[:10], MOVED[:10], "empty or cut off"),
    ):
        path = table(tmp_path / "a.csv", "time_s,command,position_rad", time_s, command, position)
        code, found = diagnose(tmp_path, "actuation", path)
        assert (code, found.verdict) == (4, "bad_data"), words
        assert words in found.sentence


def test_missing_commands_are_held(tmp_path: Path) -> None:
    """Some programs log a command only when it changes."""
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


def test_missing_rows_at_the_ends_and_the_html_report(tmp_path: Path) -> None:
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


def test_two_joints_give_one_result_with_both_parts(tmp_path: Path) -> None:
    late = np.concatenate([np.zeros(10), STEPS[:-10]])
    slow = np.cumsum(0.4 * late) * 0.02
    path = table(tmp_path / "a.csv", "t,c1,c2,q1_rad,q2_rad", TIME_S, STEPS, STEPS, MOVED, slow)
    code, found = diagnose(
        tmp_path, "actuation", path, "--command", "c1,c2", "--position", "q1_rad,q2_rad"
    )
    assert code == 0
    assert [(e.effect, e.joint) for e in found.causes[0].effects] == [("valve_dead_time", "q2_rad")]
    assert set(found.evidence["parts"]) == {"q1_rad", "q2_rad"}


def test_files_without_a_table_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    for content in ("", "hello\n" * 50, "1,2,3\n" * 50, "\x00\x01\x02" * 100):
        path.write_text(content)
        for stage in ("actuation", "swing", "flight"):
            code, found = diagnose(tmp_path, stage, path)
            assert code == 4, (content, stage, found.sentence)
    assert diagnose(tmp_path, "flight", tmp_path / "missing.csv")[0] == 4


UNREADABLE = (
    ["inf,inf,inf"] * 50,
    [f"{k * 0.02},1e300,{k % 3}e299" for k in range(300)],
    [f"{-k * 0.02},{k % 7},{k % 5}" for k in range(300)],
    [f"{k * 0.02},0.5,0.5" for k in range(300)],
    ["1,2"] * 20 + ['"1,2,3'] * 20,
    ["\x00,\x07,é"] * 60,
)


def test_unreadable_rows_are_refused_without_an_error(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    for rows in UNREADABLE:
        path.write_text("\n".join(["t,u,q", *rows]))
        for found in (
            diagnose_actuation_csv(path, "t", "u", "q"),
            diagnose_swing_csv(path, "t", "q"),
            diagnose_flight_csv(path, "t", ["u", "q"]),
        ):
            assert found.verdict is VerdictKind.BAD_DATA, rows[0]
            assert found.sentence


def _throw(period_s: float, drag_per_m: float = 0.03) -> tuple[np.ndarray, np.ndarray]:
    """Times and (rows, 2) places in m of a ball with quadratic drag, with 1 mm of noise."""
    fine = 10
    state = np.array([0.0, 1.5, 7.0, 8.0])
    rows = [state[:2]]
    for _ in range(round(1.4 / period_s)):
        for _ in range(fine):
            speed = np.hypot(state[2], state[3])
            slope = np.array([0.0, -9.81]) - drag_per_m * speed * state[2:]
            step = period_s / fine
            state = np.concatenate([state[:2] + step * state[2:], state[2:] + step * slope])
        rows.append(state[:2])
    place = np.array(rows)
    place += np.random.default_rng(5).normal(0.0, 0.001, place.shape)
    return period_s * np.arange(len(place)), place


def test_lost_detections_are_left_out(tmp_path: Path) -> None:
    time_s, place = _throw(0.02)
    for scale, stand_in, unit in ((1.0, 0.0, "m"), (1000.0, -1.0, "mm")):
        track = scale * place
        track[4::6] = stand_in
        path = table(tmp_path / "a.csv", f"t,x_{unit},z_{unit}", time_s, *track.T)
        code, found = diagnose(tmp_path, "flight", path)
        assert code == 0, found.sentence
        assert effects(found) == {"air_drag"}
        assert any("taken as lost" in note for note in found.evidence["notes"])


def test_repeated_frames_are_kept_once(tmp_path: Path) -> None:
    place = _throw(0.02)[1]
    held = np.repeat(place, 2, axis=0)
    path = table(tmp_path / "a.csv", "t,x_m,z_m", 0.01 * np.arange(len(held)), *held.T)
    code, found = diagnose(tmp_path, "flight", path)
    assert code == 0, found.sentence
    assert effects(found) == {"air_drag"}
    assert any("kept once" in note for note in found.evidence["notes"])


def test_a_track_without_a_unit_that_falls_too_fast_asks_for_it(tmp_path: Path) -> None:
    time_s, place = _throw(0.02)
    path = table(tmp_path / "a.csv", "t,x,z", time_s, *(70.0 * place).T)
    code, found = diagnose(tmp_path, "flight", path)
    assert code == 4
    assert "--length-unit" in found.sentence
