"""Tables as other people write them: layouts, units, runs and labels are understood, the rest is refused."""

from pathlib import Path

import numpy as np
import pytest

from diagnosis.alone.diagnose import actuation_from_csv, flight_from_csv, swing_from_csv
from diagnosis.alone.reading.layout import RefusedTableError, read_layout
from diagnosis.alone.reading.runs import time_seconds
from diagnosis.alone.reading.tables import read_table
from diagnosis.verdict import VerdictKind
from tests.diagnosis.alone.answers import effects
from tests.diagnosis.alone.planted import Columns, ball, joined, joint, pendulum, write

DROPS = Path(__file__).parents[1] / "data" / "ball_drops" / "ball_drops.csv"


@pytest.fixture
def swing() -> Columns:
    return pendulum(np.random.default_rng(1), viscous=0.1, rate_hz=30.0)


def lines_of(columns: Columns, separator: str) -> list[str]:
    return [separator.join(f"{v:.7g}" for v in row) for row in zip(*columns.values(), strict=True)]


@pytest.mark.parametrize(
    ("head", "separator", "comma", "note"),
    [
        ("# t theta_deg omega_deg_s", " ", False, None),
        ("Exported 3 May\nmass A\nt\ttheta_deg\tomega", "\t", False, "above the header"),
        ("t;theta;omega\ns;deg;deg/s", ";", True, "row below the header"),
        ("\n\nt,theta [°],omega", ",", False, None),
        ("t|theta_deg|omega_deg_s", "|", False, None),
    ],
)
def test_layouts_of_other_programs(
    tmp_path: Path, swing: Columns, head: str, separator: str, comma: bool, note: str | None
) -> None:
    path = tmp_path / "a.csv"
    text = "\n".join([head, *lines_of(swing, separator)])
    path.write_text(text.replace(".", ",") if comma else text)
    table = read_table(path)
    name = next(n for n in table.columns if n.startswith("theta"))
    assert np.allclose(table.numbers(name), swing["theta_deg"], atol=1e-4)
    assert time_seconds(table, "t")[-1] == pytest.approx(swing["t"][-1])
    assert note is None or any(note in text for text in table.notes)


def test_utf16_and_clock_times_are_read(tmp_path: Path, swing: Columns) -> None:
    path = tmp_path / "a.csv"
    rows = [f"10:00:{t:09.6f},{a:.6f}" for t, a in zip(swing["t"], swing["theta_deg"], strict=True)]
    path.write_text("time,angle_deg\n" + "\n".join(rows), encoding="utf-16")
    table = read_table(path)
    assert time_seconds(table, "time")[-1] == pytest.approx(swing["t"][-1], abs=1e-5)
    assert any("times of day" in note for note in table.notes)


def test_a_table_without_names_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("0.1,0.2\n" * 40)
    with pytest.raises(RefusedTableError, match="add a header line"):
        read_layout(path)


def test_a_gyro_alone_tells_the_friction(tmp_path: Path, swing: Columns) -> None:
    short = {name: column[:300] for name, column in swing.items() if name != "theta_deg"}
    found = swing_from_csv(write(tmp_path / "a.csv", short))
    assert effects(found) == {"passive_viscous_friction"}
    fitted = found.causes[0].effects[0].parameters["extra_viscous_per_s"]
    assert fitted.value == pytest.approx(0.1, rel=0.05)


def test_runs_of_a_joint_in_one_file(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    runs = [joint(rng, dead_time_s=0.2) for _ in range(2)]
    for run in runs:
        for name in list(run):
            run[name] = run[name][:700]
        run["boom_deg"] += rng.uniform(-20.0, 20.0)
    runs[1]["lever_pct"] = runs[1]["lever_pct"] * 1.0
    path = write(tmp_path / "a.csv", joined(runs))
    found = actuation_from_csv(path, "stamp_ms", "lever_pct", "boom_deg")
    fitted = {e.effect: e.parameters for e in found.causes[0].effects}
    low, high = fitted["valve_dead_time"]["extra_dead_time_s"].ci90
    assert low < 0.2 < high
    assert any("2 runs" in note for note in found.evidence["notes"])


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
    found = actuation_from_csv(write(tmp_path / "a.csv", both))
    assert [(e.effect, e.joint) for e in found.causes[0].effects] == [
        ("valve_dead_time", "arm_pos_deg")
    ]
    assert set(found.evidence["parts"]) == {"boom_pos_deg", "arm_pos_deg"}


def test_speeds_of_a_ball_are_enough(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    runs = [ball(rng, drag_per_m=0.05, noise_m=0.0) for _ in range(2)]
    for run in runs:
        h = run["t"][1]
        for axis in "xyz":
            run[f"v{axis}"] = np.gradient(run[axis], h)
            run[f"v{axis}"][[0, -1]] = np.nan
            run[f"v{axis}"] += rng.normal(0.0, 0.02, len(run["t"]))
            del run[axis]
    found = flight_from_csv(write(tmp_path / "a.csv", joined(runs)))
    assert effects(found) == {"air_drag"}
    assert any("are speeds" in note for note in found.evidence["notes"])


def test_a_film_with_y_down_is_turned_and_gravity_scales_pixels(tmp_path: Path) -> None:
    run = ball(np.random.default_rng(5), noise_m=0.002)
    film = {"t": run["t"], "x": run["x"], "y": 3.0 - run["z"]}
    found = flight_from_csv(write(tmp_path / "a.csv", film))
    assert found.verdict is VerdictKind.NONE
    assert any("points down" in note for note in found.evidence["notes"])
    film = {"t": run["t"], "x_px": 400.0 * run["x"], "y_px": 400.0 * run["z"]}
    found = flight_from_csv(write(tmp_path / "a.csv", film))
    assert found.verdict is VerdictKind.NONE
    assert any("pixels: 40" in note or "pixels: 39" in note for note in found.evidence["notes"])


def test_balls_are_told_apart_by_their_label_or_by_their_flights(tmp_path: Path) -> None:
    rng = np.random.default_rng(6)
    runs = [ball(rng, drag_per_m=k, is_drop=True) for k in (0.0, 0.12)]
    for run in runs:
        del run["x"], run["y"]
    labelled = joined(runs, what=["steel", "foam"])
    found = flight_from_csv(write(tmp_path / "a.csv", labelled))
    parts = found.evidence["parts"]
    assert (parts["steel"]["verdict"], parts["foam"]["verdict"]) == ("none", "explained")
    del labelled["what"]
    mixed = flight_from_csv(write(tmp_path / "a.csv", labelled))
    assert mixed.verdict is VerdictKind.BAD_DATA
    assert "disagree" in mixed.sentence
    assert "--group" in mixed.sentence


def test_real_drops_without_a_group_are_split_or_refused(tmp_path: Path) -> None:
    rows = [line.split(",") for line in DROPS.read_text().splitlines()]
    chosen = [r for r in rows[1:] if r[0] in ("Baseball", "Yellow Whiffle Ball")]
    path = tmp_path / "a.csv"
    path.write_text("\n".join(",".join(r) for r in [rows[0], *chosen]))
    found = flight_from_csv(path, "time_s", ["height_m"])
    assert set(found.evidence["parts"]) == {"Baseball", "Yellow Whiffle Ball"}
    baseball = found.evidence["parts"]["Baseball"]
    assert "kg per square metre" in baseball["sentence"]
    (drag,) = [one for one in baseball["evidence"]["limits"] if one["effect"] == "air_drag"]
    # A sphere of its weight (5 oz) and size (22.25 cm around) has 0.008 1/m: this film hides about as much.
    assert 0.005 < drag["below"] < 0.012
    path.write_text("\n".join(",".join(r[2:4]) for r in [rows[0], *chosen]))
    assert "disagree" in flight_from_csv(path).sentence


@pytest.mark.parametrize(
    "rows",
    [
        ["inf,inf,inf"] * 50,
        [f"{k * 0.02},1e300,{k % 3}e299" for k in range(300)],
        [f"{-k * 0.02},{k % 7},{k % 5}" for k in range(300)],
        [f"{k * 0.02},0.5,0.5" for k in range(300)],
        ["1,2"] * 20 + ['"1,2,3'] * 20,
        ["\x00,\x07,é"] * 60,
    ],
)
def test_nothing_crashes_on_rubbish(tmp_path: Path, rows: list[str]) -> None:
    path = tmp_path / "a.csv"
    path.write_text("\n".join(["t,u,q", *rows]))
    for found in (
        actuation_from_csv(path, "t", "u", "q"),
        swing_from_csv(path, "t", "q"),
        flight_from_csv(path, "t", ["u", "q"]),
    ):
        assert found.verdict is VerdictKind.BAD_DATA
        assert found.sentence


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"PK\x03\x04" + bytes(range(256)) * 20, "export the sheet as CSV"),
        (bytes(range(256)) * 20, "is not text"),
    ],
)
def test_what_is_no_text_is_said_to_be_none(tmp_path: Path, content: bytes, words: str) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes(content)
    with pytest.raises(RefusedTableError, match=words):
        read_layout(path)


def test_a_row_of_yards_is_a_row_of_units(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    rows = "\n".join(f"{0.1 * k:.1f},{k},{k},{k}" for k in range(30))
    path.write_text(f"Time,Carry,Side,Height\n[s],[yd],[yd],[ft]\n{rows}\n")
    found = read_layout(path)
    assert found.header == ["Time", "Carry", "Side", "Height"]
    assert found.units == {"Time": "s", "Carry": "yd", "Side": "yd", "Height": "ft"}
