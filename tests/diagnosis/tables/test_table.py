"""Layouts, separators, encodings and units of tables from other programs."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from diagnosis.tables.cells import RefusedTableError
from diagnosis.tables.columns import find_time_column
from diagnosis.tables.layouts import read_raw_table
from diagnosis.tables.table import ReadOptions, read_table
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
    assert list(found.cells) == ["Time", "Carry", "Side", "Height"]
    assert found.units == {"Time": "s", "Carry": "yd", "Side": "yd", "Height": "ft"}


def write(path: Path, header: str, *columns: Sequence[object], separator: str = ",") -> Path:
    rows = [separator.join(str(cell) for cell in row) for row in zip(*columns, strict=True)]
    path.write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")
    return path


COUNT = range(40)
FORMS = (
    ("1.5", 1.5),
    ("\u22121.5", -1.5),
    ("1,234.5", 1234.5),
    ("1.234,5", 1234.5),
    ("12 345,25", 12345.25),
    ("1'234.5", 1234.5),
    ("1,234,567", 1234567.0),
    ("0,250", 0.25),
    ("2,5e-3", 0.0025),
)


def test_a_column_has_one_form_of_numbers(tmp_path: Path) -> None:
    for text, value in FORMS:
        path = write(tmp_path / "a.csv", "t;v", COUNT, [text, *["3"] * 39], separator=";")
        table = read_table(path)
        assert table.numbers("v").tolist() == [value, *[3.0] * 39], text


def test_whole_thousands_follow_the_other_cells(tmp_path: Path) -> None:
    """A time that goes on, another column's form, or the option; without them the table is refused."""
    times = [f"{25 * k:,}" for k in range(60)]
    path = write(tmp_path / "a.csv", "t;v", times, range(60), separator=";")
    assert read_table(path).numbers("t").tolist() == [25.0 * k for k in range(60)]
    mixed = ["2,125", "7,250"] * 20
    path = write(tmp_path / "a.csv", "v;w", mixed, ["0,5"] * 40, separator=";")
    assert read_table(path).numbers("v")[0] == 2.125
    path = write(tmp_path / "a.csv", "v;w", mixed, ["0.5"] * 40, separator=";")
    assert read_table(path).numbers("v")[0] == 2125.0
    path = write(tmp_path / "a.csv", "v;w", mixed, COUNT, separator=";")
    with pytest.raises(RefusedTableError, match="--decimal point or --decimal comma"):
        read_table(path).numbers("v")
    assert read_table(path, ReadOptions(decimal="comma")).numbers("v")[0] == 2.125
    assert read_table(path, ReadOptions(decimal="point")).numbers("v")[0] == 2125.0


@given(
    st.lists(st.floats(-9e6, 9e6), min_size=25, max_size=40),
    st.sampled_from([".", ","]),
    st.sampled_from(["", " ", "'", "."]),
)
def test_numbers_are_read_as_they_were_written(
    tmp_path_factory: pytest.TempPathFactory, values: list[float], decimal: str, group: str
) -> None:
    group = "" if group == decimal else group
    cells = [
        f"{v:,.2f}".replace(",", "_").replace(".", decimal).replace("_", group) for v in values
    ]
    path = tmp_path_factory.getbasetemp() / "written.csv"
    write(path, "t;v", range(len(cells)), cells, separator=";")
    assert np.allclose(read_table(path).numbers("v"), [round(v, 2) for v in values], atol=1e-9)


def test_text_in_a_column_of_numbers_is_refused_with_its_place(tmp_path: Path) -> None:
    cells: list[object] = [*COUNT]
    cells[17] = "ERR 4"
    path = write(tmp_path / "a.csv", "t,v", COUNT, cells)
    with pytest.raises(RefusedTableError, match=r"row 19 of a\.csv, column 'v': 'ERR 4'"):
        read_table(path).numbers("v")
    values = read_table(path, ReadOptions(missing=("ERR 4",))).numbers("v")
    assert np.flatnonzero(np.isnan(values)).tolist() == [17]


def test_a_row_with_more_cells_than_names_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", "t,v", COUNT, ["1"] * 20 + ["1,020"] * 20)
    with pytest.raises(RefusedTableError, match=r"row 22 of a\.csv has 3 cells"):
        read_table(path)


def test_windows_encoding_keeps_the_degree_sign(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes(("t;Neigung (°)\n" + "0,5;3\n" * 30).encode("cp1252"))
    table = read_table(path)
    assert "deg" in table.words("Neigung (°)")
    assert any("Windows-1252" in note for note in table.notes)


def test_another_encoding_matters_where_the_file_is_used(tmp_path: Path) -> None:
    path, day = tmp_path / "a.csv", "오전".encode("cp949")
    rows = b"".join(b"%d,%d,x\n" % (k, 2 * k) for k in COUNT)
    path.write_bytes(b"recorded," + day + b"\n\nt,v,note\n" + rows)
    table = read_table(path)
    assert list(table.columns) == ["t", "v", "note"]
    assert table.numbers("v").tolist() == [2 * k for k in COUNT]
    path.write_bytes(b"t,v," + day + b"\n" + rows)
    with pytest.raises(RefusedTableError, match=r"row 1 of a\.csv is neither UTF-8"):
        read_table(path)
    path.write_bytes(b"t,v,note\n" + rows + b"99,99," + day + b"\n")
    with pytest.raises(RefusedTableError, match=r"row 42 of a\.csv is neither UTF-8"):
        read_table(path)


def test_stand_ins_for_no_value_are_left_out_and_counted(tmp_path: Path) -> None:
    for stand_in in (-999, 32767, 1e10):
        values = [0.01 * k for k in COUNT]
        for k in (3, 4, 30):
            values[k] = stand_in
        table = read_table(write(tmp_path / "a.csv", "t,v", COUNT, values))
        assert np.flatnonzero(np.isnan(table.numbers("v"))).tolist() == [3, 4, 30]
        assert any("3 rows hold" in note for note in table.notes)
    ramp = read_table(write(tmp_path / "a.csv", "t,v", COUNT, [999 - 20 * k for k in COUNT]))
    assert not np.any(np.isnan(ramp.numbers("v")))
    switch = read_table(write(tmp_path / "a.csv", "t,v", COUNT, [999 * (k % 2) for k in COUNT]))
    assert np.max(switch.numbers("v")) == 999.0


def test_the_sign_of_an_unsigned_integer_is_restored(tmp_path: Path) -> None:
    signed = [round(300.0 * np.sin(0.3 * k)) for k in COUNT]
    for bits in (16, 32):
        path = write(tmp_path / "a.csv", "t,v", COUNT, [v % 2**bits for v in signed])
        table = read_table(path)
        assert table.numbers("v").tolist() == signed
        assert any(f"{bits} bits" in note for note in table.notes)
    switch = [65535 * (k % 2) for k in COUNT]
    assert np.max(read_table(write(tmp_path / "a.csv", "t,v", COUNT, switch)).numbers("v")) > 0.0


def test_names_that_occur_twice_are_numbered_and_not_asked_for(tmp_path: Path) -> None:
    table = read_table(write(tmp_path / "a.csv", "t,oil,oil", COUNT, COUNT, COUNT))
    assert list(table.columns) == ["t", "oil", "oil (2)"]
    assert table.numbers("t").size == 40
    with pytest.raises(RefusedTableError, match="several columns called 'oil'"):
        table.numbers("oil")


def test_layouts_of_measuring_programs(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    ports = "trace_names,,lever,In1,In1\npath,,Root/Valve,Root/Angles/boom,Root/Angles/arm\n"
    path.write_text(
        ports + "".join(f"{'trace_values' if k == 0 else ''},{k},{k},1,2\n" for k in COUNT),
        encoding="utf-8",
    )
    assert list(read_table(path).columns) == ["time", "lever", "boom", "arm"]
    head = "descriptions,x\ntrace_names,,lever,arm\ntrace_units,,%,deg\nflags,,2,2\n"
    body = [f"{'trace_values' if k == 0 else ''},{0.1 * k:.1f},{k},{2 * k}" for k in COUNT]
    path.write_text(head + "\n".join(body))
    table = read_table(path)
    assert list(table.columns) == ["time", "lever", "arm"]
    assert table.units == {"time": "s", "lever": "%", "arm": "deg"}
    assert table.numbers("arm")[3] == 6.0
    head = "Name\trec\n\nName\tP.a\tName\tP.b\nSampleTime[ms]\t10\tSampleTime[ms]\t10\nUnit\tV\tUnit\trad\n"
    path.write_text(head + "\n".join(f"{10 * k}\t{k}\t{10 * k}\t{3 * k}" for k in COUNT))
    table = read_table(path)
    assert table.units == {"time": "ms", "a": "v", "b": "rad"}
    assert table.numbers("b")[2] == 6.0
    path.write_text(head + "\n".join(f"{10 * k}\t{k}\t{10 * k + 1}\t{3 * k}" for k in COUNT))
    with pytest.raises(RefusedTableError, match="TwinCAT Scope"):
        read_table(path)
    head = "#multi:\n\tred\t\tblue\t\nt\tx\ty\tx\ty\n"
    path.write_text(head + "\n".join(f"{k}\t{k}\t1\t{2 * k}\t2" for k in COUNT))
    table = read_table(path)
    assert table.row_count == 80
    assert table.labels("body")[::40] == ["red", "blue"]
    assert table.numbers("x")[43] == 6.0


def test_the_header_is_found_above_thin_rows_and_below_many_lines(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    thin = "".join(f"{k},,,\n" for k in range(15))
    path.write_text("n,x,y,z\n" + thin + "".join(f"{k},1.5,2,3\n" for k in COUNT))
    table = read_table(path)
    assert list(table.columns) == ["n", "x", "y", "z"]
    assert table.row_count == 55
    settings = "".join(f"gain {k},4,{k}\n" for k in range(300))
    path.write_text(settings + "t,u,q\n" + "".join(f"{k},1,2\n" for k in COUNT))
    assert list(read_table(path).columns) == ["t", "u", "q"]


def test_other_kinds_of_files_are_named(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    for content, words in (
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:00\n", "git lfs pull"),
        (b"\x89HDF\r\n\x1a\n" + b"x" * 99, "HDF5"),
    ):
        path.write_bytes(content)
        with pytest.raises(RefusedTableError, match=words):
            read_table(path)


NO_VALUES = (
    *("", "NaN", "n/a", "#DIV/0!", "#N/A", "nan(ind)", "-1.#IND", "<NA>", "1e400", "\u2013"),
    *('""', "NULL"),
)
WORDS = ("ERR", "?", "---", "N.A.", "(3)", "3-", "0x1F", "1_0", "12:30", "3 mm", "--3")


def test_cells_without_a_value_are_known_and_others_named_also_in_the_first_row(
    tmp_path: Path,
) -> None:
    for row in (0, 20):
        for word in (*NO_VALUES, *WORDS):
            cells = [word if k == row else f"{0.5 * k}" for k in COUNT]
            path = write(tmp_path / "a.csv", "t,u,v", COUNT, COUNT, cells)
            if word in WORDS:
                with pytest.raises(
                    RefusedTableError, match=rf"row {row + 2} of a\.csv, column 'v'"
                ):
                    read_table(path).numbers("v")
            else:
                values = read_table(path).numbers("v")
                assert np.flatnonzero(np.isnan(values)).tolist() == [row], word
                assert values[30] == 15.0


def test_units_and_switches_in_cells(tmp_path: Path) -> None:
    for unit in ("mm", "\u00b0", "%"):
        path = write(tmp_path / "a.csv", "t,v", COUNT, [f"-{k}.5 {unit}" for k in COUNT])
        table = read_table(path)
        assert table.numbers("v")[3] == -3.5
        assert table.units["v"] == unit
        assert any("from the cells" in note for note in table.notes)
    mixed = [f"{k} {'mm' if k % 2 else 'cm'}" for k in COUNT]
    with pytest.raises(RefusedTableError, match="'0 cm' is no number: the units cm and mm"):
        read_table(write(tmp_path / "a.csv", "t,v", COUNT, mixed)).numbers("v")
    for on, off in (("TRUE", "FALSE"), ("on", "off")):
        path = write(tmp_path / "a.csv", "t,v", COUNT, [on if k % 3 else off for k in COUNT])
        assert read_table(path).numbers("v")[:4].tolist() == [0.0, 1.0, 1.0, 0.0]


def test_a_quotation_mark_that_is_not_closed_swallows_no_rows(tmp_path: Path) -> None:
    for rows in ((5,), (5, 9), (5, 6, 30)):
        notes = ['"open' if k in rows else "fine" for k in COUNT]
        table = read_table(write(tmp_path / "a.csv", "t,v,note", COUNT, COUNT, notes))
        assert table.numbers("v").tolist() == [*map(float, COUNT)], rows
    notes = ['"one\ntwo, three"' if k == 5 else "fine" for k in COUNT]
    cells = ["bad" if k == 30 else k for k in COUNT]
    table = read_table(write(tmp_path / "a.csv", "t,v,note", COUNT, cells, notes))
    with pytest.raises(RefusedTableError, match="row 33 of"):
        table.numbers("v")


def test_comments_are_left_out_and_may_hold_the_names(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    rows = [f"{0.1 * k:.1f} {k} {2 * k}" for k in COUNT]
    for mark in ("#", "%", "//"):
        lines = [f"{mark} made by a logger", f"{mark} time cmd pos", *rows]
        path.write_text("\n".join([*lines[:20], f"{mark} paused", *lines[20:]]))
        table = read_table(path)
        assert list(table.columns) == ["time", "cmd", "pos"], mark
        assert table.row_count == len(rows)
        assert any("1 lines of comments" in note for note in table.notes)
    path.write_text("cmd,time\n" + "".join(f"{'#N/A' if k == 4 else k},{k}\n" for k in COUNT))
    assert read_table(path).row_count == len(rows)


def test_other_encodings_are_refused_rather_than_misread(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    for text, encoding in (
        ("\u6642\u9593,\u4f4d\u7f6e", "shift_jis"),
        ("\u65f6\u95f4,\u4f4d\u7f6e", "gbk"),
        ("\u0432\u0440\u0435\u043c\u044f,\u0443\u0433\u043e\u043b", "cp1251"),
        ("t,angle (\u00b0)", "mac_roman"),
        ("t,angle (\u00b0)", "cp850"),
    ):
        path.write_bytes((text + "\n" + "1,2\n" * 40).encode(encoding))
        with pytest.raises(RefusedTableError, match=r"row 1 of a\.csv is neither UTF-8"):
            read_table(path)
    for text in (
        "Zeit (\u00b5s),Stellgr\u00f6\u00dfe (%)",
        "t,Pression \u00e0 l'entr\u00e9e",
        "t,a (m/s\u00b2)",
    ):
        path.write_bytes((text + "\n" + "1,2\n" * 40).encode("cp1252"))
        assert list(read_table(path).columns) == text.split(",")


DATES = (
    "10-Mar-2024 23:59:{:06.3f}",
    "10.03.24 23:59:{:06.3f}",
    "2024/03/10 23:59:{:06.3f}",
    "2024-03-10T23:59:{:06.3f}+01:00",
    "Sun 10.03.2024 11:59:{:06.3f} PM",
)


def test_dates_of_many_programs(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    for form in DATES:
        write(path, "when;v", [form.format(0.5 * k) for k in COUNT], COUNT, separator=";")
        assert np.allclose(read_table(path).clock("when"), 0.5 * np.array(COUNT)), form
    write(path, "time,v", [f"10:00:{k:02}:250" for k in COUNT], COUNT)
    assert read_table(path).clock("time")[9] == 9.0
    write(path, "time,v", [f"{45361.5 + 0.02 * k / 86400:.9f}" for k in COUNT], COUNT)
    assert time_in_seconds(read_table(path), "time")[-1] == pytest.approx(0.78, abs=1e-3)
    days = ["2024-03-10" if k < 20 else "2024-03-11" for k in COUNT]
    clocks = [f"23:59:{40 + k}" if k < 20 else f"00:00:{k - 20:02}" for k in COUNT]
    write(path, "Date,Time,v", days, clocks, COUNT)
    table = read_table(path)
    assert time_in_seconds(table, find_time_column(table, None)).tolist() == [*map(float, COUNT)]


def test_days_and_midnight(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    clocks = [
        f"{(86380 + k) // 3600 % 24:02}:{(86380 + k) // 60 % 60:02}:{(86380 + k) % 60:02}"
        for k in COUNT
    ]
    days = ["31.01.2024" if k < 20 else "01.02.2024" for k in COUNT]
    for stamps in (clocks, [f"{d} {c}" for d, c in zip(days, clocks, strict=True)]):
        write(path, "Datum,v", stamps, COUNT)
        assert read_table(path).clock("Datum").tolist() == [float(k) for k in COUNT]
    slashes = [f"{d.replace('.', '/')[:10]} {c}" for d, c in zip(days, clocks, strict=True)]
    write(path, "Datum,v", [s.replace("31/01", "01/01") for s in slashes], COUNT)
    with pytest.raises(RefusedTableError, match="either number may be the month"):
        read_table(path).clock("Datum")


def test_a_change_of_the_unit_of_time_is_refused(tmp_path: Path) -> None:
    times = [0.01 * k for k in range(50)] + [500.0 + 10.0 * k for k in range(70)]
    path = write(tmp_path / "a.csv", "t,v", times, range(120))
    with pytest.raises(RefusedTableError, match="units of time are mixed"):
        time_in_seconds(read_table(path), "t")
