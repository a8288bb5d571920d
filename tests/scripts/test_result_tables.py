"""Tables of documents, from result files."""

import pytest

from benchmarks.result_file import Result, Row, Value
from scripts.result_tables import read_layout, result_table, title


def result(*rows: tuple[dict[str, str], int, dict[str, Value]]) -> Result:
    return Result(
        name="made",
        title="Made up",
        command="make it",
        seed=1,
        commit="abc1234",
        date="2026-01-01",
        host="a computer",
        rows=[Row(labels=labels, n=n, values=values) for labels, n, values in rows],
    )


SPREAD = [
    ({"mode": m, "target_m": t}, 10, {"sd_m": Value(value=v, low=v / 2, high=2 * v)})
    for m, t, v in (("2d", "8", 0.05), ("2d", "9", 0.101), ("3d", "8", 0.04))
]


def test_values_are_columns_with_units_digits_and_intervals():
    lines = result_table(result(*SPREAD), read_layout(["where=mode:2d"])).splitlines()
    assert lines[0] == "|target, m|sd, m|"
    assert lines[2:4] == ["|8|0.050 [0.025, 0.100]|", "|9|0.101 [0.051, 0.202]|"]
    assert "n 10, code abc1234, 2026-01-01, 95 % intervals" in lines[-1]


def test_a_label_can_make_the_columns():
    options = ["rows=target_m", "columns=mode", "intervals=no"]
    lines = result_table(result(*SPREAD), read_layout(options)).splitlines()
    assert lines[0] == "|target, m|2d|3d|"
    assert lines[2:4] == ["|8|0.050|0.040|", "|9|0.101||"]


def test_counts_that_differ_and_ranges_without_a_value_are_shown():
    rows = [
        (
            {"part": "all"},
            3,
            {"share_ratio": Value(value=0.5), "wall_s": Value(value=None, low=2, high=4)},
        ),
        ({"part": "one"}, 4, {"share_ratio": Value(value=1.0), "wall_s": Value(value=None)}),
    ]
    lines = result_table(result(*rows), read_layout([])).splitlines()
    assert lines[0] == "|part|n|share, %|wall, s|"
    assert lines[2:4] == ["|all|3|50|2 to 4|", "|one|4|100||"]


def test_an_unknown_option_is_refused():
    with pytest.raises(ValueError, match="height"):
        read_layout(["height=3"])


def test_titles_read_as_words():
    names = ("mean_downrange_m", "coverage_ratio", "steps_per_s", "machines")
    assert [title(name) for name in names] == [
        "mean downrange, m",
        "coverage, %",
        "steps, 1/s",
        "machines",
    ]
