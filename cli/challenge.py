"""`downrange challenge`: hide effects in data sets, diagnose them blind, and score what was said."""

from pathlib import Path
from typing import Literal

from cli.evaluate import progress_line
from diagnosis.challenge_make import make_challenge
from diagnosis.challenge_truth import Tier
from machine.errors import UsageError


def make(
    *,
    seed: int,
    out: Path,
    sealed: Path,
    sets: int = 200,
    throws: int = 12,
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
        tiers: kinds of sets; cross is single effects and pairs by another solver in finer steps.
        policies: folder of policy versions that throw.
        jobs: processes at work side by side.
    """
    if seed < 0 or throws < 3 or jobs < 1:
        raise UsageError(f"--seed {seed} --throws {throws} --jobs {jobs}: at least 0, 3 and 1")
    truths = make_challenge(
        seed=seed,
        out=out,
        sealed=sealed,
        sets=sets,
        throws=throws,
        policies=policies,
        tiers=[Tier(name) for name in tiers],
        jobs=jobs,
        progress=progress_line("challenge make", "sets"),
    )
    counts = ", ".join(f"{sum(t.tier is tier for t in truths)} {tier.value}" for tier in Tier)
    print(f"{len(truths)} sets in {out}: {counts}; the truth is in {sealed}")
    return 0


ACTIONS = {"make": make}
