"""Reference throws that are kept for a machine: throw logs in ``FOLDER/MACHINE.reference/DAY/``."""

from collections.abc import Mapping
from pathlib import Path
from typing import Final, NamedTuple

from diagnosis.verdict import Diagnosis, VerdictKind

LEAST_REFERENCE_COUNT: Final = 12
"""Reference throws to record at least (docs/diagnosis.md)."""
LEAST_USABLE_COUNT: Final = 8
"""Usable ones of them, below which a machine has no baseline: some throws end early or lack their impact."""
ADVISED_REFERENCE_COUNT: Final = 24
"""Reference throws, over two days, that are recommended."""


WITHOUT_REFERENCE = "Without reference throws of this machine only large effects show."
"""First sentence of an answer without them."""


class KeptReference(NamedTuple):
    """Reference throws of one machine."""

    folder: Path
    """``MACHINE.reference``, with a folder for each day."""

    def logs(self) -> dict[str, list[Path]]:
        """Logs by day, oldest day first."""
        days = sorted(p for p in self.folder.glob("*") if p.is_dir())
        found = {day.name: sorted(day.glob("*.mcap")) for day in days}
        return {day: logs for day, logs in found.items() if logs}

    def days(self) -> dict[str, int]:
        """Number of throws by day."""
        return {day: len(logs) for day, logs in self.logs().items()}


def kept_reference(machines: Path, machine_id: str) -> KeptReference:
    """Where a folder of machines keeps the reference throws of one; there may be none."""
    return KeptReference(machines / f"{machine_id}.reference")


def words_of_days(days: Mapping[str, int]) -> str:
    """What there is, such as ``24 reference throws of 2026-05-01 and 2026-05-02``."""
    if not days:
        return "no reference throws"
    *first, last = days
    listed = f"{', '.join(first)} and {last}" if first else last
    return f"{sum(days.values())} reference throws of {listed}"


def advice(days: Mapping[str, int]) -> str:
    """What more reference throws would give; empty where there are enough."""
    count = sum(days.values())
    if not days:
        return f"At least {LEAST_REFERENCE_COUNT} are needed: run `downrange commission`"
    if count < LEAST_REFERENCE_COUNT:
        return (
            f"{count} reference throws are too few, at least {LEAST_REFERENCE_COUNT} are needed: "
            "run `downrange commission` again"
        )
    if count < ADVISED_REFERENCE_COUNT or len(days) < 2:
        return (
            f"{ADVISED_REFERENCE_COUNT} over two days are recommended: run `downrange commission` again "
            "on another day"
        )
    return ""


def with_reference_stated(found: Diagnosis, days: Mapping[str, int]) -> Diagnosis:
    """The answer with the days of its reference throws, or with what it lacks without any said first.

    Args:
        found: answer about throws.
        days: reference throws by day, YYYY-MM-DD, where it is known.
    """
    reference = found.evidence.get("reference")
    if found.verdict is VerdictKind.BAD_DATA or "reference" not in found.evidence:
        return found
    if reference is None:
        return found.model_copy(update={"sentence": f"{WITHOUT_REFERENCE} {found.sentence}"})
    if not days:
        return found
    evidence = {**found.evidence, "reference": {**reference, "days": dict(days)}}
    return found.model_copy(update={"evidence": evidence})
