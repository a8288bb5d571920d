"""Which reference throws a diagnosis on the command line takes: those given, those kept, or none."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from diagnosis.healthy.health_store import HealthStore, health_store
from diagnosis.loading.kept_reference import (
    LEAST_REFERENCE_COUNT,
    LEAST_USABLE_COUNT,
    advice,
    kept_reference,
    words_of_days,
)
from diagnosis.loading.logs import load_throws
from diagnosis.loading.throw_data import LoadedSet
from machine.errors import UsageError

NONE = "none"


class ReferenceChoice(NamedTuple):
    """Reference throws, and what is said about them."""

    throws: LoadedSet | None
    words: str
    days: Mapping[str, int]
    """Number of throws by day, where it is known."""
    store: HealthStore | None = None
    """Keeps the model of the healthy machine for the next diagnosis."""


def choose_reference(
    given: Sequence[str], diagnosed: LoadedSet, folders: Sequence[Path]
) -> ReferenceChoice:
    """Reference throws for a diagnosis.

    Args:
        given: logs or folders, ``none`` alone, or nothing: those that are kept.
        diagnosed: the throws to be diagnosed; those among the kept ones are left out.
        folders: of machines, searched in order for kept throws.

    Raises:
        UsageError: ``none`` beside others, or too few usable throws among those given.
    """
    if NONE in given:
        if len(given) > 1:
            raise UsageError("--reference none stands alone: give it, or logs and folders")
        return ReferenceChoice(None, "reference throws: none, as asked", {})
    if given:
        loaded = load_throws([Path(path) for path in given])
        count = len(loaded.throws)
        if count < LEAST_USABLE_COUNT:
            why = "; ".join(f"{path.name}: {reason}" for path, reason in loaded.refused[:3])
            raise UsageError(
                f"{count} usable reference throws, at least {LEAST_USABLE_COUNT} are needed. {why}".strip()
            )
        more = (
            f"; {LEAST_REFERENCE_COUNT} or more are better" if count < LEAST_REFERENCE_COUNT else ""
        )
        words = f"compared with {count} reference throws{more}"
        # Only where machines are kept already: a diagnosis makes no folder that was not asked for.
        machines = next((folder for folder in folders if folder.is_dir()), None)
        store = (
            health_store(machines, diagnosed.throws[0].machine_id)
            if machines is not None and diagnosed.throws
            else None
        )
        return ReferenceChoice(loaded, words, {}, store)
    if not diagnosed.throws:
        return ReferenceChoice(None, "", {})
    return _kept(diagnosed, folders)


def _kept(diagnosed: LoadedSet, folders: Sequence[Path]) -> ReferenceChoice:
    machine_id = diagnosed.throws[0].machine_id
    inside = {throw.throw_id for throw in diagnosed.throws}
    for folder in dict.fromkeys(folders):
        kept = kept_reference(folder, machine_id)
        logs = {
            day: [path for path in paths if path.stem not in inside]
            for day, paths in kept.logs().items()
        }
        days = {day: len(paths) for day, paths in logs.items() if paths}
        if not days:
            continue
        more = advice(days)
        if sum(days.values()) < LEAST_REFERENCE_COUNT:
            return ReferenceChoice(None, f"reference throws: not compared, {more}", {})
        loaded = load_throws([path for paths in logs.values() for path in paths])
        words = f"compared with {words_of_days(days)} ({kept.folder})"
        store = health_store(folder, machine_id)
        return ReferenceChoice(loaded, f"{words}; {more}" if more else words, days, store)
    return ReferenceChoice(
        None,
        f"reference throws: none of {machine_id} are kept; `downrange commission` records them",
        {},
    )
