"""A throw as CSV: the same data as from its MCAP, what may be missing, what is refused."""

import json
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from diagnosis.loading.logs import load_throws
from diagnosis.loading.measured import measured_motion, rows_of_interest
from diagnosis.loading.prepared import prepare
from diagnosis.loading.throw_csv import throw_csv
from diagnosis.loading.throw_data import LoadedSet
from machine.spec import load_spec
from runtime.records.log_writer import write_throw_log
from sim_twin.twin.profile import nominal_profile
from tests.cases import each
from tests.diagnosis.loading.test_logs import make_log


def both(folder: Path, text: str | None = None) -> tuple[LoadedSet, LoadedSet]:
    """The same throw from MCAP and from CSV."""
    log = make_log()
    write_throw_log(folder / "a.mcap", log)
    (folder / "csv").mkdir()
    (folder / "csv" / "a.csv").write_text(throw_csv(log) if text is None else text)
    return load_throws([folder / "a.mcap"]), load_throws([folder / "csv"])


def without(text: str, *words: str) -> str:
    """The file without the columns whose names hold one of the words."""
    lines = text.splitlines()
    start = next(k for k, line in enumerate(lines) if not line.startswith("#"))
    rows = [line.split(",") for line in lines[start:]]
    kept = [k for k, name in enumerate(rows[0]) if not any(word in name for word in words)]
    return "\n".join([*lines[:start], *(",".join(row[k] for k in kept) for row in rows)])


def test_csv_and_mcap_load_alike(tmp_path: Path) -> None:
    (first,), (second,) = (loaded.throws for loaded in both(tmp_path))
    for field in fields(first):
        ours, theirs = getattr(first, field.name), getattr(second, field.name)
        if isinstance(ours, np.ndarray):
            assert ours.shape == theirs.shape, field.name
            np.testing.assert_allclose(theirs, ours, atol=1e-9, err_msg=field.name)
        elif field.name != "path":
            assert theirs == ours, field.name


def test_ball_switch_and_pressure_may_be_missing(tmp_path: Path) -> None:
    lean = without(throw_csv(make_log()), "ball_", "payload", "supply", "requested", "tick")
    _, loaded = both(tmp_path, lean)
    (throw,) = loaded.throws
    assert throw.ball_m.shape == (0, 3)
    assert any("no ball track" in note for note in loaded.evidence()["repairs"][throw.throw_id])


@each(
    ("change", "words"),
    [
        (lambda text: without(text, "gyro_"), "gyro_x_rad_per_s"),
        (lambda text: without(text, "gyro_", "accel_", "imu_", "pitch_"), "pitch_position_rad"),
        (
            lambda text: text.replace("# impact:", '# throws: {"b": {}}\n# impact:'),
            "without rows: b",
        ),
        (lambda text: without(text, "motion_code"), "motion_code_count"),
        (lambda text: text.replace("# calibration:", "# c:"), "no valve calibration"),
        (lambda text: text.replace("# target: {", "# target: {,"), "holds no JSON"),
        (lambda text: text.replace('"source": "survey"', '"source": "guess"'), "impact"),
        (lambda _: "t,theta\n1,2\n" * 40, "is no whole throw"),
        (lambda _: "", "empty or cut off"),
    ],
    copied="tmp_path",
)
def test_what_cannot_be_used_is_refused_with_the_reason(
    tmp_path: Path, change: object, words: str
) -> None:
    assert callable(change)
    _, loaded = both(tmp_path, str(change(throw_csv(make_log()))))
    assert loaded.throws == ()
    assert words in loaded.refused[0][1]


def test_flags_may_be_words_and_stamps_of_sensors_may_be_left_out(tmp_path: Path) -> None:
    lines = throw_csv(make_log()).splitlines()
    start = next(k for k, line in enumerate(lines) if not line.startswith("#"))
    header, *rows = (line.split(",") for line in lines[start:])
    held, opens = (
        header.index(f"{name}_ratio") for name in ("payload_held", "gripper_open_commanded")
    )
    stamp = header.index("sensor_t_s")
    for row in rows:
        for place in (held, opens):
            row[place] = {"1.0": "True", "0.0": "false"}.get(row[place], row[place])
        row[stamp] = ""
    text = "\n".join([*lines[:start], *(",".join(row) for row in (header, *rows))])
    first, second = (loaded.throws[0] for loaded in both(tmp_path, text))
    assert second.switch_open_t_s == pytest.approx(first.switch_open_t_s)
    assert second.open_command_t_s == pytest.approx(first.open_command_t_s)
    np.testing.assert_allclose(second.sensor_t_s, second.t_s)


def several(texts: dict[str, str]) -> str:
    """One file of several throws: a column of ids, and one line with what is each throw's own."""
    own = {
        name: {
            line[2:].split(":", 1)[0]: json.loads(line.split(":", 1)[1])
            for line in text.splitlines()
            if line.startswith("#")
        }
        for name, text in texts.items()
    }
    bodies = {
        name: [line for line in text.splitlines() if not line.startswith("#")]
        for name, text in texts.items()
    }
    for context in own.values():
        del context["throw_id"]
    head = next(iter(bodies.values()))[0]
    rows = [f"{name},{line}" for name, lines in bodies.items() for line in lines[1:]]
    return "\n".join([f"# throws: {json.dumps(own)}", f"throw_id,{head}", *rows])


def test_several_throws_in_one_file(tmp_path: Path) -> None:
    text = throw_csv(make_log())
    _, loaded = both(tmp_path, several({"t1": text, "t2": text.replace('"x_m": 1', '"x_m": 2', 1)}))
    assert [throw.throw_id for throw in loaded.throws] == ["t1", "t2"]
    # The column of ids goes before a line that names one throw.
    named = '# throw_id: "t0"\n' + several({"t1": text, "t2": text})
    (tmp_path / "csv" / "a.csv").write_text(named)
    assert [t.throw_id for t in load_throws([tmp_path / "csv"]).throws] == ["t1", "t2"]
    first, second = loaded.throws
    np.testing.assert_allclose(second.valve_ratio, first.valve_ratio)
    assert len(first.imu_t_s) == len(second.imu_t_s) > 0
    # What is wrong with one throw does not cost the others.
    broken = several({"t1": text, "t2": text.replace("# calibration:", "# c:")})
    (tmp_path / "csv" / "a.csv").write_text(broken)
    loaded = load_throws([tmp_path / "csv"])
    assert [throw.throw_id for throw in loaded.throws] == ["t1"]
    assert "throw t2: it carries no valve calibration" in loaded.refused[0][1]


def test_without_an_imu_the_swing_is_the_machines_own_estimate(tmp_path: Path) -> None:
    log = make_log()
    _, loaded = both(tmp_path, without(throw_csv(log), "gyro_", "accel_", "imu_"))
    (throw,) = loaded.throws
    assert any("no IMU" in note for note in throw.notes)
    motion = measured_motion(throw, np.zeros(4))
    rows = rows_of_interest(throw)
    np.testing.assert_allclose(motion.swing_rad, throw.joint_position_rad_m[rows, 4:])
    (prepared,) = prepare([throw], nominal_profile(load_spec()))
    assert not [block.name for block in prepared.blocks if block.name.startswith("swing.")]
    # Columns of an IMU without a sample are an IMU that hung.
    lines = throw_csv(log).splitlines()
    names = next(line for line in lines if not line.startswith("#")).split(",")
    (tmp_path / "csv" / "a.csv").write_text(
        "\n".join(line if line.startswith(("#", "t_s")) else emptied(line, names) for line in lines)
    )
    assert "it hung" in load_throws([tmp_path / "csv"]).refused[0][1]


def emptied(row: str, names: list[str]) -> str:
    """A row without the cells of the IMU."""
    cells = row.split(",")
    imu = ("imu_", "gyro_", "accel_")
    return ",".join("" if n.startswith(imu) else c for n, c in zip(names, cells, strict=True))
