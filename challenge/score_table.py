"""The table of scores: every measure with the count of sets behind it and its interval, as text and JSON."""

import json
from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from challenge.score import (
    NONE_LABEL,
    UNKNOWN_LABEL,
    Label,
    ScoredSet,
    cause_label,
    effect_key,
)
from challenge.sealed_truth import Tier
from sim_twin.confidence_intervals import proportion_interval

STRONG_RATIO: Final = 2.0
CLEAR_RATIO: Final = 0.97
"""Sizes are clipped at bounds: slightly less than twice the limit counts as twice the limit."""
TOP_COUNT: Final = 3
ECE_BINS: Final = 10
CONFIDENCE_RATIO: Final = 0.95
LEAST_PROBABILITY: Final = 1e-3
"""Floor of the probability in the log score."""
_NO: Final = (float("nan"), float("nan"))


class Measure(NamedTuple):
    """One line of the table."""

    name: str
    number: int
    """Sets, or effects, that it stands on."""
    value: float
    low: float
    high: float
    bar: str = ""
    """The target."""
    is_share: bool = True


def share_interval(hits: int, count: int) -> tuple[float, float]:
    """95 % interval of a share; NaN of nothing."""
    return proportion_interval(hits, count, CONFIDENCE_RATIO) if count else _NO


def measures(scored: Sequence[ScoredSet], beside: Sequence[ScoredSet] = ()) -> list[Measure]:
    """All lines of the table.

    Args:
        scored: answers of one method.
        beside: those of another one, whose sizes are compared on the effects that both name.
    """
    tier = {t: [s for s in scored if s.truth.tier is t] for t in Tier}
    singles = tier[Tier.SINGLE]
    strong = [s for s in singles if s.multiple_ratio >= CLEAR_RATIO * STRONG_RATIO]
    weak = [s for s in singles if s.multiple_ratio < CLEAR_RATIO * STRONG_RATIO]
    cross = tier[Tier.CROSS]
    cross_single = [s for s in cross if len(s.truth.effects) == 1]
    cross_pair = [s for s in cross if len(s.truth.effects) == 2]
    hidden = [s for s in scored if s.truth.effects]
    known = [s for s in hidden if s.truth.tier is not Tier.UNKNOWN]
    lines = [
        _share("false alarms on null", tier[Tier.NULL], lambda s: s.top != NONE_LABEL, "<= 3 %"),
        _share("effect noticed, single >= 2x", strong, _noticed),
        _share("effect noticed, single < 2x", weak, _noticed),
        _share("stage named, all with an effect", hidden, _stage_right, ">= 95 %"),
        _share("stage named, single >= 2x", strong, _stage_right),
        _share("cause, single >= 2x, alone", strong, lambda s: s.is_right),
        _share("cause, single >= 2x", strong, lambda s: s.is_right_or_ambiguous, ">= 90 %"),
        _share("cause of any joint, single >= 2x", strong, _effect_right),
        _share("cause among the first 3, single >= 2x", strong, _among_first),
        _share("cause, single < 2x", weak, lambda s: s.is_right_or_ambiguous),
        _share("exact set, pairs", tier[Tier.PAIR], lambda s: s.is_right, ">= 70 %"),
        _share("exact set or one of two, pairs", tier[Tier.PAIR], _named_or_one_of_two),
        _share("cause, cross-solver single", cross_single, lambda s: s.is_right_or_ambiguous),
        _share("exact set, cross-solver pairs", cross_pair, lambda s: s.is_right),
        _share("unknown flagged", tier[Tier.UNKNOWN], lambda s: s.top == UNKNOWN_LABEL, ">= 80 %"),
        _share("known called unknown", known, lambda s: s.top == UNKNOWN_LABEL, "<= 5 %"),
        _number("F1 of effects, pairs", [_f1(s) for s in (*tier[Tier.PAIR], *cross_pair)], np.mean),
        _number("probability on the truth", [s.truth_probability for s in scored], np.mean),
        _number(
            "log score",
            [float(np.log(max(s.truth_probability, LEAST_PROBABILITY))) for s in scored],
            np.mean,
        ),
        Measure(
            "calibration error (ECE)", len(scored), calibration_error(scored), *_NO, "<= 0.1", False
        ),
        Measure("AUROC of an effect", len(scored), _effect_auroc(scored), *_NO, "", False),
        Measure("AUROC of unknown", len(scored), _unknown_auroc(scored), *_NO, "", False),
        *_sizes(scored, beside),
        *_shrinks(hidden),
        _number("seconds a set, median", [s.seconds for s in scored], np.median, "<= 60"),
        _number("seconds a set, worst", [s.seconds for s in scored], np.max),
        _number("memory, MiB, worst", [s.memory_mib for s in scored], np.max, "<= 1536"),
        _share("failed", scored, lambda s: s.diagnosis is None),
    ]
    return [line for line in lines if line.number]


def _share(
    name: str, sets: Sequence[ScoredSet], hit: Callable[[ScoredSet], bool], bar: str = ""
) -> Measure:
    hits = sum(bool(hit(s)) for s in sets)
    value = hits / len(sets) if sets else float("nan")
    return Measure(name, len(sets), value, *share_interval(hits, len(sets)), bar)


def _number(
    name: str, values: Sequence[float], of: Callable[[Sequence[float]], Any], bar: str = ""
) -> Measure:
    finite = [value for value in values if np.isfinite(value)]
    value = float(of(finite)) if finite else float("nan")
    return Measure(name, len(finite), value, *_NO, bar, False)


def _noticed(s: ScoredSet) -> bool:
    return s.top is not None and s.top != NONE_LABEL


def _named_or_one_of_two(s: ScoredSet) -> bool:
    """Whether the exact set was named, or is one of the two members of an ambiguity."""
    return s.is_right or s.is_right_or_ambiguous


def _stage_right(s: ScoredSet) -> bool:
    return s.where in {effect.stage for effect in s.truth.effects}


def _effect_right(s: ScoredSet) -> bool:
    return s.top is not None and {e for e, _ in s.top} == {e for e, _ in s.label}


def _among_first(s: ScoredSet) -> bool:
    return s.label in [label for label, _ in s.ranked[:TOP_COUNT]]


def _f1(s: ScoredSet) -> float:
    named = s.top or NONE_LABEL
    hits = len(named & s.label)
    return 2.0 * hits / (len(named) + len(s.label)) if named or s.label else 1.0


def calibration_error(scored: Sequence[ScoredSet]) -> float:
    """Expected calibration error of the most probable answer's probability, in 10 bins."""
    pairs = [(s.ranked[0][1], s.ranked[0][0] == s.label) for s in scored if s.ranked]
    if not pairs:
        return float("nan")
    said, right = np.array(pairs, dtype=np.float64).T
    place = np.minimum((said * ECE_BINS).astype(int), ECE_BINS - 1)
    gaps = [
        (place == b).mean() * abs(said[place == b].mean() - right[place == b].mean())
        for b in range(ECE_BINS)
        if (place == b).any()
    ]
    return float(np.sum(gaps))


def _effect_auroc(scored: Sequence[ScoredSet]) -> float:
    """Probability that a set with an effect has a lower probability of "none" than a healthy one.

    It measures alarms at all thresholds: a baseline that never alarms has no false alarms, and scores 0.5.
    """
    return _auroc(scored, NONE_LABEL, lambda s: s.truth.tier is Tier.NULL)


def _unknown_auroc(scored: Sequence[ScoredSet]) -> float:
    """Probability that an unknown set has a higher probability of "unknown" than another set."""
    return _auroc(scored, UNKNOWN_LABEL, lambda s: s.truth.tier is Tier.UNKNOWN)


def _auroc(scored: Sequence[ScoredSet], label: Label, has_it: Callable[[ScoredSet], bool]) -> float:
    """Probability that a set with the label ranks it above a set without it; ties count half."""
    chance = [(sum(p for said, p in s.ranked if said == label), has_it(s)) for s in scored]
    yes = np.array([p for p, has in chance if has])
    no = np.array([p for p, has in chance if not has])
    if not yes.size or not no.size:
        return float("nan")
    return float((yes[:, None] > no).mean() + 0.5 * (yes[:, None] == no).mean())


def _sizes(scored: Sequence[ScoredSet], beside: Sequence[ScoredSet]) -> list[Measure]:
    """Errors and intervals of the sizes of correctly named causes."""
    named = {key: fit for s in scored for key, fit in _fits(s).items()}
    covered = [hit for fit in named.values() for hit in fit.covered]
    hits = sum(covered)
    share = hits / len(covered) if covered else float("nan")
    others = {key: fit for s in beside for key, fit in _fits(s).items() if key in named}
    return [
        _number("size error, median", [fit.error for fit in named.values()], np.median, "<= 0.10"),
        _number(
            "size error of the first, same effects",
            [fit.error for fit in others.values()],
            np.median,
        ),
        Measure(
            "90 % intervals that hold",
            len(covered),
            share,
            *share_interval(hits, len(covered)),
            "85-95 %",
        ),
    ]


class _Fit(NamedTuple):
    error: float
    """Distance of the parameters from the true ones over the true ones' norm."""
    covered: list[bool]
    """Of each parameter: whether its interval holds the true one."""


def _fits(s: ScoredSet) -> dict[tuple[str, tuple[str, str | None]], _Fit]:
    """By set and effect, if the cause is right."""
    if not s.is_right or s.diagnosis is None or not s.truth.effects or s.label == UNKNOWN_LABEL:
        return {}
    cause = next(c for c in s.diagnosis.causes if cause_label(c) == s.label)
    by_key = {effect_key(e.effect, e.joint, e.parameters): e for e in cause.effects}
    fits: dict[tuple[str, tuple[str, str | None]], _Fit] = {}
    for effect in s.truth.effects:
        key = effect_key(effect.effect, effect.joint, effect.parameters)
        found = by_key[key]
        names = sorted(set(effect.parameters) | set(found.parameters))
        true = np.array([effect.parameters.get(name, 0.0) for name in names])
        fitted = [found.parameters.get(name) for name in names]
        value = np.array([0.0 if f is None else f.value for f in fitted])
        fits[s.truth.set_id, key] = _Fit(
            float(np.linalg.norm(value - true) / np.linalg.norm(true)),
            [
                f.ci90[0] <= size <= f.ci90[1]
                for f, size in zip(fitted, true, strict=True)
                if f is not None
            ],
        )
    return fits


def _shrinks(hidden: Sequence[ScoredSet]) -> list[Measure]:
    found = [
        s.diagnosis.shrink
        for s in hidden
        if s.diagnosis is not None and s.diagnosis.shrink is not None
    ]
    off = [abs(f.predicted_ratio - f.ratio) for f in found if f.predicted_ratio is not None]
    return [
        _number("removable gap closed, median", [f.ratio for f in found], np.median, ">= 0.80"),
        _number("predicted against realised shrink, median", off, np.median, "<= 0.10"),
    ]


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
