"""`downrange challenge`: hide effects in data sets, diagnose them blind, and score the answers."""

from pathlib import Path
from typing import Literal

import tyro

from challenge.make import make_challenge
from challenge.run import answered, run_challenge
from challenge.score import ScoredSet, match, read_sealed
from challenge.score import mistakes as missed
from challenge.score_table import as_json, measures, table
from challenge.sealed_truth import Tier
from evaluation.progress import progress_line
from machine.errors import UsageError


def make(
    *,
    seed: int,
    out: Path,
    sealed: Path,
    sets: int = 200,
    throws: int = 12,
    reference_throws: int = 12,
    tiers: tuple[Literal["null", "single", "pair", "unknown", "cross"], ...] = (
        "null",
        "single",
        "pair",
        "unknown",
        "cross",
    ),
    policies: Path = Path("policies"),
    jobs: int = 2,
) -> int:
    """Make data sets of virtual machines with hidden effects, and one sealed file with the truth.

    Every set is a folder of throw logs of one machine, with the twin profile and the calibration that were
    measured on it while it was healthy. Its hash in OUT/manifest.json proves later that the sealed file was
    not touched.

    Example: downrange challenge make --seed 7 --out challenge --sealed truth.json --sets 200

    Args:
        seed: of everything; the same seed makes the same challenge.
        out: folder for the data sets, with nothing else in it.
        sealed: file for the truth, outside of OUT.
        sets: data sets in all.
        throws: throws of each set.
        reference_throws: throws of each machine while it was healthy, for the diagnosis to compare with.
        tiers: kinds of sets; cross is single effects and pairs by another solver in finer steps.
        policies: folder of policy versions that throw.
        jobs: processes at work side by side.
    """
    if seed < 0 or throws < 3 or jobs < 1:
        raise UsageError(f"--seed {seed} --throws {throws} --jobs {jobs}: at least 0, 3 and 1")
    if reference_throws != 0 and reference_throws < 3:
        raise UsageError(f"--reference-throws {reference_throws}: 0 for none, or at least 3")
    truths = make_challenge(
        seed=seed,
        out=out,
        sealed=sealed,
        sets=sets,
        throws=throws,
        reference_throws=reference_throws,
        policies=policies,
        tiers=[Tier(name) for name in tiers],
        jobs=jobs,
        progress=progress_line("challenge make", "sets"),
    )
    counts = ", ".join(f"{sum(t.tier is tier for t in truths)} {tier.value}" for tier in Tier)
    print(f"{len(truths)} sets in {out}: {counts}; the truth is in {sealed}")
    return 0


def run_sets(
    folder: tyro.conf.Positional[Path],
    /,
    *,
    json: Path,
    method: Literal["diagnose", "largest_z", "evolution", "lag_rmse"] = "diagnose",
    jobs: int = 1,
    limit: int | None = None,
) -> int:
    """Diagnose every data set of a challenge, without the truth; an interrupted run goes on where it stopped.

    Example: downrange challenge run challenge --json answers.json --jobs 2

    Args:
        folder: of the challenge.
        json: file for the answers, written after every set.
        method: diagnose, or a baseline: largest_z fits everything and takes the largest z-score,
            evolution fits everything by CMA-ES, lag_rmse ranks channels by lag and error.
        jobs: sets diagnosed side by side.
        limit: only the first so many sets.
    """
    if jobs < 1 or (limit is not None and limit < 1) or not json.resolve().parent.is_dir():
        raise UsageError(
            f"--jobs {jobs} --limit {limit}: at least 1; and {json.parent} must be a folder"
        )
    done = run_challenge(
        folder,
        json,
        method=method,
        jobs=jobs,
        limit=limit,
        progress=progress_line("challenge run", "sets"),
    )
    print(f"{done} sets answered, all answers in {json}")
    return 0


def score(
    files: tyro.conf.Positional[tuple[Path, ...]],
    /,
    *,
    sealed: Path,
    mistakes: bool = False,
    json: Path | None = None,
) -> int:
    """Score answers against the sealed truth; several files give a column each.

    Shares have 95 % Wilson intervals. The others' columns tell how far off the first one's sizes are on the
    effects that they name. The sealed file must have the hash that the challenge published.

    Example: downrange challenge score answers.json lag.json --sealed truth.json

    Args:
        files: answers to one challenge.
        sealed: its sealed file.
        mistakes: list the sets that the first file answered wrongly.
        json: write the numbers to this file.
    """
    if not files:
        raise UsageError("give at least one file of answers")
    documents = answered(files)
    columns: list[tuple[str, list[ScoredSet]]] = []
    for path, document in zip(files, documents, strict=True):
        scored = match(document, read_sealed(sealed, str(document["sealed_sha256"])))
        if not scored:
            raise UsageError(f"{path} holds no answers yet")
        columns.append((str(document["method"]), scored))
    (method, first), *others = columns
    lines = [(method, measures(first)), *((name, measures(one, first)) for name, one in others)]
    print(table(lines))
    if json is not None:
        json.write_text(as_json(lines), encoding="utf-8")
    if mistakes:
        print()
        print("\n".join(missed(first)))
    return 0


ACTIONS = {"make": make, "run": run_sets, "score": score}
