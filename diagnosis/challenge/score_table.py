"""The table of scores, for people and as JSON."""

import json
from collections.abc import Sequence

import numpy as np

from diagnosis.challenge.measures import Measure


def table(columns: Sequence[tuple[str, Sequence[Measure]]]) -> str:
    """The table, one column a method; shares with 95 % Wilson intervals."""
    names = list(dict.fromkeys(m.name for _, lines in columns for m in lines))
    by_name = [{m.name: m for m in lines} for _, lines in columns]
    width = max(len(name) for name in names)
    head = f"{'':<{width}}  {'asked':>8}" + "".join(f"  {title:>26}" for title, _ in columns)
    rows = [head]
    for name in names:
        found = [lines.get(name) for lines in by_name]
        bar = next(m.bar for m in found if m is not None)
        rows.append(f"{name:<{width}}  {bar:>8}" + "".join(f"  {_cell(m):>26}" for m in found))
    return "\n".join(rows)


def _cell(m: Measure | None) -> str:
    if m is None:
        return ""
    if not m.is_share:
        return f"{m.value:.3g} (n {m.number})"
    return f"{100 * m.value:.1f} % [{100 * m.low:.0f}, {100 * m.high:.0f}] (n {m.number})"


def as_json(columns: Sequence[tuple[str, Sequence[Measure]]]) -> str:
    """The same numbers by method and name; null where there is no interval or no number."""
    return (
        json.dumps(
            {
                method: {
                    m.name: {
                        "value": _finite(m.value),
                        "ci95": [_finite(m.low), _finite(m.high)],
                        "count": m.number,
                        "asked": m.bar,
                    }
                    for m in lines
                }
                for method, lines in columns
            },
            indent=1,
        )
        + "\n"
    )


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None
