"""Lines of a text file: kinds of files that are no text are named, the encoding is found or refused."""

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Final, NamedTuple

from diagnosis.tables.cells import RefusedTableError

MAX_BYTES: Final = 1_500_000_000
"""Largest file, bytes; reading takes about four times as much memory."""
SNIFFED_BYTES: Final = 4096
"""Bytes from the start of a file that decide whether it is text."""
BINARY_RATIO: Final = 0.1
"""Share of control characters in those bytes above which a file is not text."""
SEPARATOR_LINES: Final = 400
"""Lines, half from each end of the file, from which the separator is found."""
_AS_CSV: Final = "export its channels as CSV with the program that wrote it"
CONTAINERS: Final = (
    (b"version https://git-lfs", "is a Git LFS pointer, not the file itself: run git lfs pull"),
    (b"PK\x03\x04", "is an archive or a spreadsheet (.xlsx), not text: export the sheet as CSV"),
    (b"\xd0\xcf\x11\xe0", "is an old spreadsheet (.xls), not text: export the sheet as CSV"),
    (b"\x1f\x8b", "is compressed (gzip): unpack it"),
    (b"\x28\xb5\x2f\xfd", "is compressed (zstd): unpack it"),
    (b"BZh", "is compressed (bzip2): unpack it"),
    (b"\x89HDF", f"is an HDF5 file: {_AS_CSV}"),
    (b"MATLAB 5.0", "is a MATLAB file: write the variables with writetable"),
    (b"MDF  ", f"is a measurement file (MDF): {_AS_CSV}"),
    (b"UnFinMF", f"is an unfinished measurement file (MDF): {_AS_CSV}"),
    (b"PAR1", "is a Parquet file: write it as CSV"),
    (b"ULog", "is a PX4 log: convert it with ulog2csv"),
    (b"%PDF", "is a PDF: give the measurements as CSV"),
    (b"<?xml", f"is XML: {_AS_CSV}"),
    (b"<!DOCTYPE", "is a web page, perhaps of a failed download"),
    (b"<html", "is a web page, perhaps of a failed download"),
    *((mark, f"is JSON: {_AS_CSV}") for mark in (b"{", b"[{", b"[\n", b"[\r\n")),
    (b"<", f"is XML or a web page: {_AS_CSV}"),
)
"""First bytes of files that are no tables, and what to do with them."""
MAX_FOREIGN_LINES: Final = 1000
"""More of them than lines above a header: some are in the table."""
_FOREIGN_WORD: Final = re.compile(
    r"[^\x00-\x7f]{3,}|(?<!\w)[^\W\d_a-zA-Zµàèéòù]+(?!\w)|[\x80-\x9f¡-¯¶¸»¿\ufffd]"
)
"""What texts of Western Europe do not hold, but those of other encodings do when they are read as such."""


class TextLines(NamedTuple):
    """Lines of a file that are not blank, and the number of each in the file."""

    lines: list[str]
    numbers: list[int]
    notes: list[str]
    foreign: dict[int, str]
    """Text of neither encoding by the number of its line; usable only where the line is left out."""


def read_lines(path: Path) -> TextLines:
    """Read the lines of a text file in UTF-8, UTF-16 or, with a note, Windows-1252.

    Raises:
        RefusedTableError: the file is missing, too large, or not text.
    """
    try:
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise RefusedTableError(
                f"{path.name} has {size / 1e9:.1f} GB, at most {MAX_BYTES / 1e9:g} GB are read: "
                "give the part with the motion, or every tenth row"
            )
        refuse_other_kinds(path)
        text, notes, foreign = _decode(path)
    except OSError as error:
        raise RefusedTableError(f"cannot open {path}: {error.strerror}") from error
    every = text.replace("\x00", "").replace("\r\n", "\n").replace("\r", "\n").split("\n")
    kept = [k for k, line in enumerate(every) if line.strip()]
    return TextLines([every[k] for k in kept], [k + 1 for k in kept], notes, foreign)


def refuse_other_kinds(path: Path) -> None:
    """Refuse files that are no text, by name.

    Raises:
        RefusedTableError: with the kind of the file, and what to do with it.
    """
    with path.open("rb") as file:
        start = file.read(SNIFFED_BYTES)
    for mark, words in CONTAINERS:
        if start.startswith(mark):
            raise RefusedTableError(f"{path.name} {words}.")
    control = sum(byte < 0x20 and byte not in b"\t\n\r\x00" for byte in start)
    if control > BINARY_RATIO * len(start):
        raise RefusedTableError(
            f"{path.name} is not text ({control} of its first {len(start)} bytes are control characters): "
            "export the record as CSV"
        )


def _decode(path: Path) -> tuple[str, list[str], dict[int, str]]:
    data = path.read_bytes()
    try:
        if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
            return data.decode("utf-16"), [], {}
        return data.decode("utf-8-sig"), [], {}
    except UnicodeDecodeError:
        pass
    text = data.decode("cp1252", errors="replace")
    foreign: dict[int, str] = {}
    number, counted = 1, 0
    for found in _FOREIGN_WORD.finditer(text):
        number += text.count("\n", counted, found.start())
        counted = found.start()
        foreign.setdefault(number, text[counted : counted + 12].split("\n")[0])
        if len(foreign) > MAX_FOREIGN_LINES:
            break
    return text, ["not UTF-8: read as Windows-1252 (European spreadsheets)"], foreign


def require_readable(
    path: Path, foreign: dict[int, str], rows: Sequence[int], words: Iterable[str]
) -> None:
    """Refuse text of an unknown encoding in what is used of a file: its rows, and the words above them.

    Raises:
        RefusedTableError: with the first such row.
    """
    if not foreign:
        return
    in_rows = foreign.keys() & set(rows)
    above = [number for number in foreign if number < min(rows, default=0)]
    if above and any(_FOREIGN_WORD.search(word) for word in words):
        in_rows = {above[-1]}
    if in_rows:
        number = min(in_rows)
        raise RefusedTableError(
            f"row {number} of {path.name} is neither UTF-8 nor Windows-1252 ({foreign[number]!r}): save the "
            "file as UTF-8"
        )


def find_separator(lines: Sequence[str]) -> str:
    """The separator that most lines have equally often, outside quotation marks.

    A decimal comma does not occur equally often, so it is not taken for a separator.
    """
    part = [*lines[: SEPARATOR_LINES // 2], *lines[-SEPARATOR_LINES // 2 :]]
    part = [re.sub(r'"[^"]*"', "", line) for line in part]
    best, most = " ", 0
    for separator in ";\t|,":
        counts = Counter(line.count(separator) for line in part)
        count, lines_count = counts.most_common(1)[0]
        if count > 0 and lines_count > max(most, 0.5 * len(part)):
            best, most = separator, lines_count
    return best
