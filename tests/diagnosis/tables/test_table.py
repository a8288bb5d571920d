"""Layouts, separators, encodings and units of tables from other programs."""

from pathlib import Path

import numpy as np
import pytest

from diagnosis.tables.table import RefusedTableError, read_raw_table, read_table
from diagnosis.tables.time_series import time_in_seconds
from tests.diagnosis.single_stage.synthetic import Columns, pendulum


@pytest.fixture
def swing() -> Columns:
    return pendulum(np.random.default_rng(1), viscous=0.1, rate_hz=30.0)


LAYOUTS = (
    ("# t theta_deg omega_deg_s", " ", False, ""),
    ("Exported 3 May\nmass A\nt\ttheta_deg\tomega", "\t", False, "above the header"),
    ("t;theta;omega\ns;deg;deg/s", ";", True, "row below the header"),
    ("\n\nt,theta [°],omega", ",", False, ""),
    ("t|theta_deg|omega_deg_s", "|", False, ""),
)
"""Lines down to the header, separator, whether commas are decimal, and a part of the notes."""


def test_layouts_of_other_programs_are_read(tmp_path: Path, swing: Columns) -> None:
    path = tmp_path / "a.csv"
    for head, separator, has_decimal_commas, note in LAYOUTS:
        rows = [
            separator.join(f"{v:.7g}" for v in row) for row in zip(*swing.values(), strict=True)
        ]
        text = "\n".join([head, *rows])
        path.write_text(text.replace(".", ",") if has_decimal_commas else text)
        table = read_table(path)
        name = next(n for n in table.columns if n.startswith("theta"))
        assert np.allclose(table.numbers(name), swing["theta_deg"], atol=1e-4), head
        assert time_in_seconds(table, "t")[-1] == pytest.approx(swing["t"][-1]), head
        assert note in " ".join(table.notes), head


def test_utf16_and_times_of_day_are_read(tmp_path: Path, swing: Columns) -> None:
    path = tmp_path / "a.csv"
    rows = [f"10:00:{t:09.6f},{a:.6f}" for t, a in zip(swing["t"], swing["theta_deg"], strict=True)]
    path.write_text("time,angle_deg\n" + "\n".join(rows), encoding="utf-16")
    table = read_table(path)
    assert time_in_seconds(table, "time")[-1] == pytest.approx(swing["t"][-1], abs=1e-5)
    assert any("times of day" in note for note in table.notes)


def test_files_without_names_or_without_text_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    for content, words in (
        (b"0.1,0.2\n" * 40, "add a header line"),
        (b"PK\x03\x04" + bytes(range(256)) * 20, "export the sheet as CSV"),
        (bytes(range(256)) * 20, "is not text"),
    ):
        path.write_bytes(content)
        with pytest.raises(RefusedTableError, match=words):
            read_raw_table(path)


def test_units_are_taken_from_the_row_below_the_header(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    rows = "\n".join(f"{0.1 * k:.1f},{k},{k},{k}" for k in range(30))
    path.write_text(f"Time,Carry,Side,Height\n[s],[yd],[yd],[ft]\n{rows}\n")
    found = read_raw_table(path)
    assert found.header == ["Time", "Carry", "Side", "Height"]
    assert found.units == {"Time": "s", "Carry": "yd", "Side": "yd", "Height": "ft"}
