"""Tables and cells of the evaluation page; contents are markup."""

from collections.abc import Sequence

from diagnosis.evaluation.measures import Estimate
from diagnosis.report.report_words import NONE, fixed


def table(heads: Sequence[str], rows: Sequence[Sequence[tuple[str, str]]]) -> str:
    """A table that scrolls by itself where it is too wide; cells are (class, content).

    A head stands as the cells below it do: numbers at the right.
    """
    kinds = [css for css, _ in rows[0]] if rows else [""] * len(heads)
    head = "".join(
        f'<th class="number">{words}</th>' if kind.startswith("number") else f"<th>{words}</th>"
        for words, kind in zip(heads, kinds, strict=True)
    )
    body = "".join(
        "<tr>"
        + "".join(f'<td class="{css}">{content}</td>' if css else f"<td>{content}</td>"
                  for css, content in row)
        + "</tr>"
        for row in rows
    )  # fmt: skip
    return f'<div class="scroll"><table><tr>{head}</tr>{body}</table></div>'


def height(value_m: float) -> str:
    """Height of a target, signed off the ground."""
    return "0 m" if value_m == 0.0 else f"{value_m:+g} m".replace("-", "\u2212")


def share(ratio: float) -> str:
    """A share, to a tenth of a percent: 1599 of 1600 are not all."""
    return f"{fixed(100.0 * ratio, 1)} %"


def cell(estimate: Estimate, unit: str) -> str:
    """A value over its interval."""
    if estimate.value is None:
        return NONE
    digits = 2 if unit == "s" else 3
    text = f"{fixed(estimate.value, digits)} {unit}"
    if estimate.ci95 is None:
        return text
    low, high = (fixed(v, digits) for v in estimate.ci95)
    return f'{text}<br><span class="dim">{low} to {high}</span>'
