"""Comparison of two measured accuracies, target by target: better, worse, or cannot tell."""

import math
from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import NamedTuple

from pydantic import TypeAdapter, ValidationError
from scipy.special import fdtri, stdtrit

from machine.errors import UsageError
from sim_twin.confidence_intervals import Interval, proportion_interval
from sim_twin.throws.accuracy import AccuracyReport, TargetAccuracy

FALSE_CLAIM_RATIO = 0.05
"""Largest chance that two policies of equal accuracy get any "better" or "worse" in one comparison."""


class Verdict(StrEnum):
    """What the throws say about the second policy beside the first."""

    BETTER = "better"
    WORSE = "worse"
    CANNOT_TELL = "cannot tell"


class Difference(NamedTuple):
    """One quantity at one target."""

    range_m: float
    height_m: float
    quantity: str
    first: float | None
    second: float | None
    """m, or a ratio for the landed share; None where too few throws landed."""
    difference: Interval | None
    """Second minus first; for standard deviations second over first."""
    verdict: Verdict
    counts: tuple[int, int]
    """Throws that the verdict rests on."""


QUANTITIES = ("landed", "mean down", "sd down", "mean cross", "sd cross")


def read_accuracy(path: Path) -> AccuracyReport:
    """Read a result of `downrange evaluate --json`.

    Raises:
        UsageError: no such file, or another content.
    """
    try:
        report = TypeAdapter(AccuracyReport).validate_json(path.read_bytes())
        if not all(0 <= row["landed"] <= row["throws"] > 0 for row in report["targets"]):
            raise UsageError(f"{path}: a target has no throws, or more landed than were thrown")
        return report
    except OSError as error:
        raise UsageError(f"cannot read {path}: {error.strerror}") from error
    except ValidationError as error:
        raise UsageError(f"{path} is no result of `downrange evaluate --json`") from error


def compare_accuracy(first: AccuracyReport, second: AccuracyReport) -> list[Difference]:
    """Compare the targets that both reports hold.

    The intervals are simultaneous over all rows (Bonferroni): their confidence is 1 - 0.05 / rows. Throws of
    the two reports count as independent, and landing errors at one target as normal.

    Raises:
        UsageError: other mode, plant or registration, or no common target.
    """
    for key in ("mode", "plant", "is_registered"):
        if first[key] != second[key]:
            raise UsageError(
                f"the results cannot be compared: {key} is {first[key]} in the first, "
                f"{second[key]} in the second"
            )
    others = {(row["range_m"], row["height_m"]): row for row in second["targets"]}
    pairs = [
        (row, others[row["range_m"], row["height_m"]])
        for row in first["targets"]
        if (row["range_m"], row["height_m"]) in others
    ]
    if not pairs:
        raise UsageError("the results cannot be compared: they have no target in common")
    confidence_ratio = 1.0 - FALSE_CLAIM_RATIO / (len(pairs) * len(QUANTITIES))
    return [row for a, b in pairs for row in _at_target(a, b, confidence_ratio)]


def _at_target(a: TargetAccuracy, b: TargetAccuracy, confidence_ratio: float) -> list[Difference]:
    where, landed = (a["range_m"], a["height_m"]), (a["landed"], b["landed"])
    share = share_difference(landed, (a["throws"], b["throws"]), confidence_ratio)
    rows = [
        Difference(
            *where, "landed", a["success_ratio"], b["success_ratio"], share,
            _verdict(share, 0.0, is_less_better=False), (a["throws"], b["throws"]),
        )
    ]  # fmt: skip
    for name, means, sds in (
        (
            "down",
            (a["mean_downrange_error_m"], b["mean_downrange_error_m"]),
            (a["sd_downrange_m"], b["sd_downrange_m"]),
        ),
        (
            "cross",
            (a["mean_crossrange_error_m"], b["mean_crossrange_error_m"]),
            (a["sd_crossrange_m"], b["sd_crossrange_m"]),
        ),
    ):
        gap = ratio = None
        verdicts = [Verdict.CANNOT_TELL] * 2
        known_means, known_sds = _both(means), _both(sds)
        if known_means and known_sds and min(landed) >= 2:
            gap = mean_difference(known_means, known_sds, landed, confidence_ratio)
            total = mean_difference(
                (-known_means[0], known_means[1]), known_sds, landed, confidence_ratio
            )
            verdicts[0] = _verdict_of_means(gap, total)
            if min(known_sds) > 0.0:
                ratio = deviation_ratio(known_sds, landed, confidence_ratio)
                verdicts[1] = _verdict(ratio, 1.0, is_less_better=True)
        rows += [
            Difference(*where, f"mean {name}", *means, gap, verdicts[0], landed),
            Difference(*where, f"sd {name}", *sds, ratio, verdicts[1], landed),
        ]
    return rows


def _both(values: tuple[float | None, float | None]) -> tuple[float, float] | None:
    first, second = values
    return None if first is None or second is None else (first, second)


def mean_difference(
    means: tuple[float, float],
    sds: tuple[float, float],
    counts: tuple[int, int],
    confidence_ratio: float,
) -> Interval:
    """Interval of the second mean minus the first, by Welch's unequal-variances t; counts from 2."""
    parts = [sd * sd / n for sd, n in zip(sds, counts, strict=True)]
    middle = means[1] - means[0]
    if sum(parts) == 0.0:
        return middle, middle
    freedom = sum(parts) ** 2 / sum(p * p / (n - 1) for p, n in zip(parts, counts, strict=True))
    half = float(stdtrit(freedom, 0.5 + 0.5 * confidence_ratio)) * math.sqrt(sum(parts))
    return middle - half, middle + half


def deviation_ratio(
    sds: tuple[float, float], counts: tuple[int, int], confidence_ratio: float
) -> Interval:
    """Interval of the second standard deviation over the first, by Fisher's F; positive, counts from 2."""
    tail = 0.5 - 0.5 * confidence_ratio
    low, high = fdtri(counts[1] - 1, counts[0] - 1, [tail, 1.0 - tail])
    ratio = sds[1] / sds[0]
    return ratio / math.sqrt(float(high)), ratio / math.sqrt(float(low))


def share_difference(
    hits: tuple[int, int], counts: tuple[int, int], confidence_ratio: float
) -> Interval:
    """Interval of the second share minus the first (Newcombe 1998, Statistics in Medicine 17, method 10)."""
    first, second = (h / n for h, n in zip(hits, counts, strict=True))
    (low_1, high_1), (low_2, high_2) = (
        proportion_interval(h, n, confidence_ratio) for h, n in zip(hits, counts, strict=True)
    )
    middle = second - first
    return (
        middle - math.hypot(second - low_2, high_1 - first),
        middle + math.hypot(high_2 - second, first - low_1),
    )


def _verdict(interval: Interval, equal: float, *, is_less_better: bool) -> Verdict:
    low, high = interval
    if low <= equal <= high:
        return Verdict.CANNOT_TELL
    return Verdict.BETTER if (high < equal) == is_less_better else Verdict.WORSE


def _verdict_of_means(difference: Interval, total: Interval) -> Verdict:
    """Whether the second mean is nearer to the target.

    The squares differ by (second - first) * (second + first): the sign is known when both factors' are.
    """
    if difference[0] <= 0.0 <= difference[1] or total[0] <= 0.0 <= total[1]:
        return Verdict.CANNOT_TELL
    return Verdict.BETTER if (difference[0] > 0.0) != (total[0] > 0.0) else Verdict.WORSE


def comparison_table(
    first: AccuracyReport, second: AccuracyReport, rows: Sequence[Difference]
) -> str:
    """The rows as a table, with one sentence on what the words mean."""
    lines = [
        f"{second['policy']} beside {first['policy']}: {first['mode']} on {first['plant']}",
        "range/m  height/m  quantity     first  second  second - first (sd: ratio)  verdict",
    ]
    for row in rows:
        words = str(row.verdict)
        if row.verdict is Verdict.CANNOT_TELL:
            words += f" from {row.counts[0]} and {row.counts[1]} throws"
        interval = (
            "-"
            if row.difference is None
            else f"{row.difference[0]:+.3f} to {row.difference[1]:+.3f}"
        )
        lines.append(
            f"{row.range_m:7.2f}  {row.height_m:8.1f}  {row.quantity:<10}  {_cell(row.first):>6}  "
            f"{_cell(row.second):>6}  {interval:>26}  {words}"
        )
    lines.append(
        "Intervals hold together at 95 %: equal policies get any `better` or `worse` in at most 5 of 100 "
        "comparisons."
    )
    return "\n".join(lines)


def _cell(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"
