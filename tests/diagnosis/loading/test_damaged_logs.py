"""Damaged throw logs are read or refused with a reason."""

import json
import random
from pathlib import Path

import pytest

from diagnosis.loading.logs import load_throws
from diagnosis.loading.throw_csv import throw_csv
from runtime.records.log_writer import write_throw_log
from tests.cases import each
from tests.diagnosis.loading.test_logs import make_log

CELLS = ("", "nan", "inf", "-1e308", "1e30", "abc", "9223372036854775808", '"', "\x00", ",,", "1,5")
VALUES = ("null", "1", '"x"', "[1, 2]", "{}", '{"x_m": "a"}', "1e999", "-5", '{"a": 1e300}', "NaN")
ROUNDS = 60


def damaged_table(text: str, rng: random.Random) -> str:
    """A CSV with a cell, a column, a line above the columns or a stretch of rows spoilt."""
    lines = text.splitlines()
    above = sum(line.startswith("#") for line in lines)
    what = rng.randrange(5)
    if what == 0:
        at = rng.randrange(above)
        lines[at] = f"{lines[at].split(':')[0]}: {rng.choice(VALUES)}"
    elif what == 1:
        at = rng.randrange(above + 1, len(lines))
        cells = lines[at].split(",")
        cells[rng.randrange(len(cells))] = rng.choice(CELLS)
        lines[at] = ",".join(cells)
    elif what == 2:
        column, junk = rng.randrange(lines[above].count(",") + 1), rng.choice(CELLS)
        for at in range(above + 1, len(lines)):
            cells = lines[at].split(",")
            cells[column] = junk
            lines[at] = ",".join(cells)
    elif what == 3:
        start = rng.randrange(len(lines))
        del lines[start : start + rng.randrange(1, 300)]
    else:
        one, other = rng.randrange(len(lines)), rng.randrange(len(lines))
        lines[one], lines[other] = lines[other], lines[one]
    return "\n".join(lines)


def damaged_bytes(raw: bytes, rng: random.Random) -> bytes:
    """A file cut off, or with bytes turned over, lost or put in."""
    at, what = rng.randrange(len(raw)), rng.randrange(4)
    if what == 0:
        return raw[:at]
    if what == 1:
        return raw[:at] + raw[at + rng.randrange(1, 5000) :]
    if what == 2:
        return raw[:at] + rng.randbytes(300) + raw[at:]
    changed = bytearray(raw)
    for _ in range(rng.choice((1, 10, 300))):
        changed[rng.randrange(len(raw))] = rng.randrange(256)
    return bytes(changed)


@pytest.mark.parametrize("suffix", [".csv", ".mcap"])
def test_a_damaged_log_is_read_or_refused_with_a_reason(tmp_path: Path, suffix: str) -> None:
    log, rng = make_log(), random.Random(20261122)
    text = throw_csv(log)
    write_throw_log(tmp_path / "whole.mcap", log)
    raw = (tmp_path / "whole.mcap").read_bytes()
    path = tmp_path / f"a{suffix}"
    refused = 0
    for _ in range(ROUNDS):
        if suffix == ".csv" and rng.random() < 0.7:
            path.write_text(damaged_table(text, rng))
        else:
            path.write_bytes(damaged_bytes(text.encode() if suffix == ".csv" else raw, rng))
        loaded = load_throws([path])
        refused += not loaded.throws
        assert loaded.throws or all(len(reason) > 20 for _, reason in loaded.refused)
        assert json.dumps(loaded.evidence())
    # Most damage is beyond repair, some is none: both paths are walked.
    assert ROUNDS // 4 < refused < ROUNDS


@each(
    ("line", "words"),
    [
        ('# start_t_mono_ns: {"s": 1}', "whole nanoseconds"),
        ("# impact_t_mono_ns: 1e999", "whole nanoseconds"),
        ('# throws: {"a-1": 5}', "names throws without rows"),
        ("# result: 7", "is needed"),
        ("# target: [8, 0, 0]", "x_m, y_m, z_m"),
    ],
    copied="tmp_path",
)
def test_what_stands_above_the_columns_is_checked(tmp_path: Path, line: str, words: str) -> None:
    key = line.split(":")[0]
    kept = [old for old in throw_csv(make_log()).splitlines() if not old.startswith(f"{key}:")]
    path = tmp_path / "a.csv"
    path.write_text("\n".join([line, *kept]))
    (reason,) = (reason for _, reason in load_throws([path]).refused)
    assert words in reason


def test_a_number_no_machine_can_have_counts_as_missing(tmp_path: Path) -> None:
    lines = throw_csv(make_log()).splitlines()
    above = sum(line.startswith("#") for line in lines)
    column = lines[above].split(",").index("boom_sensor_position_rad")
    cells = lines[above + 300].split(",")
    cells[column] = "1e30"
    lines[above + 300] = ",".join(cells)
    path = tmp_path / "a.csv"
    path.write_text("\n".join(lines))
    (throw,) = load_throws([path]).throws
    assert "sensor_position_rad_m: 1 missing values interpolated" in throw.notes


def test_suffixes_in_capitals_are_found_and_no_binary_is_printed(tmp_path: Path) -> None:
    write_throw_log(tmp_path / "one.mcap", make_log())
    (tmp_path / "one.mcap").rename(tmp_path / "wurf 1.MCAP")
    (tmp_path / "b.CSV").write_bytes(b"# \x1b[2J\x07\xff: x\n1,2\n")
    loaded = load_throws([tmp_path])
    assert len(loaded.throws) == 1
    ((_, reason),) = loaded.refused
    assert "holds no JSON" in reason
    assert reason.isprintable()
