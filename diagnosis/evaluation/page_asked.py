"""The evaluation page's first answer: what is asked of the policies, and whether it holds."""

from collections.abc import Sequence

from diagnosis.evaluation.goals import THROW_COUNT, Verdict, shortfalls, verdicts
from diagnosis.evaluation.measures import ModeEvaluation
from diagnosis.evaluation.page_cells import share, table
from diagnosis.report.evidence_html import section
from diagnosis.report.report_words import NONE, fixed


def asked_section(parts: Sequence[ModeEvaluation]) -> str:
    """One row for each thing that is asked, with the worst figure measured."""
    rows: list[list[tuple[str, str]]] = []
    missed: list[str] = []
    for part in parts:
        for verdict in verdicts(part):
            mark = "" if verdict.holds else " large"
            if not verdict.holds:
                missed.append(f"{part.mode.upper()}, {verdict.asked}")
            rows.append(
                [
                    ("", part.mode.upper()),
                    ("name", verdict.asked),
                    (
                        "number",
                        f"{'at least' if verdict.is_least else 'at most'} {_number(verdict, verdict.limit)}",
                    ),
                    (f"number{mark}", _number(verdict, verdict.worst)),
                    ("", verdict.where),
                    ("verdict", "holds" if verdict.holds else "<b>does not hold</b>"),
                ]
            )
    held = len(rows) - len(missed)
    words = f"{held} of {len(rows)} hold."
    if missed:
        words += f" Not: {'; '.join(missed)}."
    if any(shortfalls(part.mode, target) for part in parts for target in part.targets):
        words += " What holds the machine back is measured below, where a figure is exceeded most."
    fewest = min(target.throws for part in parts for target in part.targets)
    if fewest < THROW_COUNT:
        words += f" {fewest} throws a target decide little: {THROW_COUNT} are asked for."
    bare = [part.mode.upper() for part in parts if not part.is_registered]
    if bare:
        words += (
            f" The machine of {' and '.join(bare)} is <b>not registered</b>: its mean errors are what a "
            "registration takes away."
        )
    return section(
        "What is asked, and whether it holds",
        f"<p>{words}</p>" + table(("mode", "asked", "limit", "worst here", "where", ""), rows),
    )


def _number(verdict: Verdict, value: float | None) -> str:
    if value is None:
        return NONE
    if verdict.unit == "%":
        return share(value)
    if verdict.unit == "x":
        return f"{fixed(value)} times"
    return f"{fixed(value, 3)} m"
