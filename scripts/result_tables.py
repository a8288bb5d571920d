"""Write the documents' tables from benchmarks/results/*.json and from the table of effects.

    python -m scripts.result_tables [--check]

A table stands between two comments of a document:

    <!-- table: policy_accuracy rows=target_m columns=policy values=sd_downrange_m -->
    <!-- end of table -->

The name is that of the result file, or ``effects``. Options: `rows` and `columns` choose labels, `values`
chooses values, ``where=label:text`` keeps matching rows (``_`` is a blank), ``intervals=no`` leaves
intervals out and ``intervals=COLUMN`` shows those of one column. Without `columns` each value is a column.
``--check`` changes nothing and fails when a table is old.
"""

import re
import sys
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.result_file import Result, Row, Value, read_result
from sim_twin.effects.schema import DRIFT, EffectSpec, parameter_unit
from sim_twin.effects.table import EFFECTS

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks" / "results"
BLOCK = re.compile(r"(<!-- table: ([^>]+?) -->\n)(.*?)(<!-- end of table -->)", re.S)
UNITS = {
    "rad_or_m_per_s": "rad/s or m/s",
    "rad_m_per_s": "rad/s (m/s)",
    "rad_per_s": "rad/s",
    "m_per_s": "m/s",
    "l_per_min": "l/min",
    "per_s": "1/s",
    "per_m": "1/m",
    "rad_m": "rad (m)",
    "rad": "rad",
    "ratio": "%",
    "mib": "MiB",
    "ms": "ms",
    "us": "us",
    "hz": "Hz",
    "kg": "kg",
    "m": "m",
    "s": "s",
    "count": "",
}
"""Endings of the names of values and labels, longest first, and the unit that a reader sees."""


@dataclass(frozen=True)
class Layout:
    """What a document asks of a table."""

    rows: tuple[str, ...] = ()
    columns: str = ""
    values: tuple[str, ...] = ()
    where: dict[str, str] = field(default_factory=dict[str, str])
    intervals: bool = True
    intervals_of: str = ""
    """The one column with intervals; empty: all."""


def read_layout(options: list[str]) -> Layout:
    """The options of a comment.

    Raises:
        ValueError: an option that does not exist.
    """
    rows: tuple[str, ...] = ()
    columns, values, intervals, intervals_of = "", (), True, ""
    where: dict[str, str] = {}
    for option in options:
        key, _, text = option.partition("=")
        if key == "rows":
            rows = tuple(text.split(","))
        elif key == "columns":
            columns = text
        elif key == "values":
            values = tuple(text.split(","))
        elif key == "intervals":
            intervals = text != "no"
            intervals_of = text if intervals else ""
        elif key == "where":
            label, _, wanted = text.partition(":")
            where[label] = wanted.replace("_", " ")
        else:
            raise ValueError(f"unknown option '{option}' of a table")
    return Layout(rows, columns, values, where, intervals, intervals_of)


def title(name: str) -> str:
    """`sd_downrange_m` as `sd downrange, m`."""
    for ending, unit in UNITS.items():
        if name == ending or name.endswith(f"_{ending}"):
            words = name[: -len(ending)].rstrip("_").replace("_", " ")
            return f"{words}, {unit}".strip(", ") if unit else words
    return name.replace("_", " ")


def scale(name: str) -> float:
    """Shares are shown in per cent."""
    return 100.0 if name.endswith("_ratio") else 1.0


def digits_of(values: list[float]) -> int:
    """Decimals that show each value with up to three digits, three decimals at most."""
    texts = [f"{value:.3g}" for value in values if 0.0 < abs(value) < 100.0]
    decimals = [len(text.partition(".")[2]) for text in texts if "e" not in text]
    return min(max(decimals, default=0), 3)


def number(value: float, name: str, digits: int) -> str:
    """A value in a column of so many decimals; means with their sign."""
    value *= scale(name)
    if abs(value) >= 1e5:
        return f"{value / 1e6:.4g} million"
    text = f"{value:.{digits}f}"
    if 0.0 < abs(value) < 0.5 * 10.0**-digits:
        text = f"{value:.2g}"
    if float(text) == 0.0:
        return text.removeprefix("-")
    return f"+{text}" if name.startswith("mean_") and value > 0 else text


def cell(value: Value, name: str, digits: int, *, intervals: bool) -> str:
    """A value, with its interval; a range alone where there is no value."""
    low, high = value.low, value.high
    limits: list[str] = []
    if low is not None and high is not None:
        limits = [number(low, name, digits), number(high, name, digits)]
    if value.value is None:
        return " to ".join(limits)
    text = number(value.value, name, digits)
    return f"{text} [{', '.join(limits)}]" if limits and intervals else text


def line(cells: list[str]) -> str:
    """One row of a table."""
    return "|" + "|".join(cells) + "|"


def is_known(value: Value) -> bool:
    """Whether there is anything to show."""
    return value.value is not None or value.low is not None


def decimals(rows: list[Row], names: tuple[str, ...]) -> dict[str, int]:
    """Decimals of each value's column."""
    found: dict[str, int] = {}
    for name in names:
        values = [v for row in rows for v in (row.values[name].value,) if v is not None]
        if not values:
            ends = [(row.values[name].low, row.values[name].high) for row in rows]
            values = [v for pair in ends for v in pair if v is not None]
        found[name] = digits_of([scale(name) * v for v in values])
    return found


def ends(value: Value, name: str) -> list[float]:
    """A value and its interval, as they are shown."""
    known = [v for v in (value.value, value.low, value.high) if v is not None]
    return [scale(name) * v for v in known]


def result_table(result: Result, layout: Layout) -> str:
    """The table of one result file and, below it, where the numbers come from."""
    rows = [row for row in result.rows if all(row.labels[k] == v for k, v in layout.where.items())]
    labels = layout.rows or tuple(
        name for name in rows[0].labels if name not in {layout.columns, *layout.where}
    )
    names = layout.values or tuple(
        n for n in rows[0].values if any(is_known(r.values[n]) for r in rows)
    )
    groups: dict[tuple[str, ...], list[Row]] = {}
    for row in rows:
        groups.setdefault(tuple(row.labels[name] for name in labels), []).append(row)
    count = {row.n for row in rows}
    heads = [title(name) for name in labels]
    columns = list(dict.fromkeys(row.labels[layout.columns] for row in rows if layout.columns))
    alike = [key for key, members in groups.items() if len({r.n for r in members}) == 1]
    has_n = len(count) > 1 and 2 * len(alike) > len(groups)
    heads += ["n"] * has_n + (columns or [title(name) for name in names])
    digits = decimals(rows, names)
    lines = [line(heads), "|" + "---|" * len(heads)]
    for key, members in groups.items():
        if "unit" in labels:
            digits = {name: digits_of(ends(members[0].values[name], name)) for name in names}
        cells = [str(members[0].n) if key in alike else ""] * has_n
        if columns:
            shows_n = len(count) > 1 and not (has_n and key in alike)
            cells += [pivoted(members, c, layout, names, digits, shows_n=shows_n) for c in columns]
        else:
            (row,) = members
            cells += [
                cell(row.values[name], name, digits[name], intervals=layout.intervals)
                for name in names
            ]
        lines.append(line([*key, *cells]))
    meaning = ""
    if columns and names != ("result",):
        meaning = f"Cells: {' / '.join(title(name) for name in names)}. "
    return "\n".join(lines) + "\n\n" + meaning + source(result, layout, count) + "\n"


def pivoted(
    members: list[Row],
    column: str,
    layout: Layout,
    names: tuple[str, ...],
    digits: dict[str, int],
    *,
    shows_n: bool,
) -> str:
    """The cell of one column: its values, and its n if asked for."""
    row = next((r for r in members if r.labels[layout.columns] == column), None)
    if row is None:
        return ""
    shown = layout.intervals and layout.intervals_of in ("", column)
    texts = [cell(row.values[name], name, digits[name], intervals=shown) for name in names]
    text = "/".join(text for text in texts if text)
    return f"{text} (n {row.n})" if text and shows_n else text


def source(result: Result, layout: Layout, count: set[int]) -> str:
    """Where the numbers come from, in one line; the host stands in the file."""
    facts = [f"n {next(iter(count))}"] if len(count) == 1 and count != {1} else []
    facts += [f"code {result.commit}", result.date]
    has_interval = any(v.low is not None for row in result.rows for v in row.values.values())
    if has_interval and layout.intervals:
        facts.append(
            f"{result.interval} intervals" if result.interval.endswith("%") else result.interval
        )
    note = f" {result.notes}" if result.notes else ""
    return f"`{result.command}` ([file](BENCH/{result.name}.json): {', '.join(facts)}).{note}"


def effects_table() -> str:
    """The table of effects as the code has it; effects of one driven joint are marked."""
    heads = ["effect", "stage", "parameters (unit, bounds)", "physics"]
    lines = [line(heads), "|" + "---|" * len(heads)]
    lines += [line(effect_cells(spec)) for spec in EFFECTS.values()]
    return (
        "\n".join(lines) + "\n\n(j): acts on one driven joint; the others on the whole machine.\n"
    )


def effect_cells(spec: EffectSpec) -> list[str]:
    """One row of the table of effects."""
    words = spec.physics.replace("|u|", "abs u")
    if spec.name == DRIFT:
        limits = "`<effect>.<parameter>`: one, within plus or minus that parameter's range"
        return [f"`{DRIFT}`", "as that effect", limits, words]
    limits = "; ".join(
        f"`{p.name}` ({parameter_unit(p.name)}, {p.low:g} to {p.high:g})" for p in spec.parameters
    )
    return [f"`{spec.name}`" + " (j)" * bool(spec.joints), spec.stage, limits, words]


def table(directive: str) -> str:
    """The table that a comment asks for."""
    name, *options = directive.split()
    if name == "effects":
        return effects_table()
    return result_table(read_result(RESULTS / f"{name}.json"), read_layout(options))


def renew(document: Path) -> str:
    """A document's text with all its tables made anew."""
    up = "../" * (len(document.relative_to(ROOT).parts) - 1)

    def replace(match: re.Match[str]) -> str:
        made = table(match[2]).replace("](BENCH/", f"]({up}benchmarks/results/")
        return f"{match[1]}{made}{match[4]}"

    return BLOCK.sub(replace, document.read_text(encoding="utf-8"))


def main() -> int:
    """Renew all documents, or with --check tell which are old."""
    documents = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    old = [d for d in documents if renew(d) != d.read_text(encoding="utf-8")]
    if "--check" in sys.argv[1:]:
        for document in old:
            print(
                f"{document.relative_to(ROOT)}: a table is old; run python -m scripts.result_tables"
            )
        return 1 if old else 0
    for document in old:
        document.write_text(renew(document), encoding="utf-8")
        print(f"renewed {document.relative_to(ROOT)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
