"""Scores answers against the sealed truth: every number with how many sets it stands on and its interval.

A set counts as right when the most probable answer is exactly what was hidden. An ambiguous verdict is
right when the truth is one of at most two members and a motion that separates them is named.
"""

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from diagnosis.challenge.truth import SetTruth, Tier
from diagnosis.verdict import Cause, Diagnosis, VerdictKind
from machine.errors import UsageError
from sim_twin.faults.fault import DRIFT

Label = frozenset[tuple[str, str | None]]
"""Effects and joints; drifts as ``warm_up_drift:<effect>``."""
UNKNOWN_LABEL: Final[Label] = frozenset({("unknown", None)})
NONE_LABEL: Final[Label] = frozenset()
STRONG_RATIO: Final = 2.0
CLEAR_RATIO: Final = 0.97
"""Sizes were cut at bounds: a hair below twice the limit is twice the limit."""
TOP_COUNT: Final = 3
ECE_BINS: Final = 10
NORMAL_95: Final = 1.96
LEAST_PROBABILITY: Final = 1e-3
"""An answer that gives the truth no chance scores no worse than this in the log score."""


class Scored(NamedTuple):
    """One set and what was said about it."""

    truth: SetTruth
    said: Diagnosis | None
    """None: the program failed."""
    seconds: float
    memory_mib: float = float("nan")
    """Most that the process had used by then."""

    @property
    def label(self) -> Label:
        """What would be right."""
        if self.truth.tier is Tier.UNKNOWN:
            return UNKNOWN_LABEL
        return frozenset(
            _key(effect.effect, effect.joint, effect.parameters) for effect in self.truth.effects
        )

    @property
    def multiple_ratio(self) -> float:
        """Of the weakest hidden effect."""
        return min((effect.multiple_ratio for effect in self.truth.effects), default=0.0)

    @property
    def ranked(self) -> list[tuple[Label, float]]:
        """Answers, the most probable first."""
        if self.said is None:
            return []
        ranked = [(cause_label(cause), cause.probability) for cause in self.said.causes]
        return sorted(ranked, key=lambda pair: -pair[1])

    @property
    def top(self) -> Label | None:
        """The most probable answer, in keeping with the verdict."""
        if self.said is None or self.said.verdict is VerdictKind.BAD_DATA:
            return None
        if self.said.verdict is VerdictKind.NONE:
            return NONE_LABEL
        if self.said.verdict is VerdictKind.UNKNOWN:
            return UNKNOWN_LABEL
        named = [label for label, _ in self.ranked if label not in (NONE_LABEL, UNKNOWN_LABEL)]
        return named[0] if named else None

    @property
    def is_right(self) -> bool:
        """Whether the most probable answer is the truth."""
        return self.top == self.label

    @property
    def is_right_or_ambiguous(self) -> bool:
        """Whether it is, or the truth is one of two members of an ambiguity with a separating motion."""
        if self.said is None or self.said.verdict is not VerdictKind.AMBIGUOUS:
            return self.is_right
        group = self.said.ambiguity
        if group is None or len(group.members) > 2 or not group.separating_motion:
            return False
        labels = [cause_label(c) for c in self.said.causes if c.name in group.members]
        return self.label in labels

    @property
    def truth_probability(self) -> float:
        """Probability that was given to the truth."""
        return min(sum(p for label, p in self.ranked if label == self.label), 1.0)

    @property
    def where(self) -> str | None:
        """The stage that was named."""
        if self.said is None:
            return None
        named = self.said.evidence.get("where")
        if isinstance(named, Mapping) and "stage" in named:
            return str(named["stage"])
        largest = max(self.said.stages, key=lambda s: s.share_ratio, default=None)
        return None if largest is None else str(largest.stage)


class Measure(NamedTuple):
    """One line of the table."""

    name: str
    number: int
    """Sets, or effects, that it stands on."""
    value: float
    low: float
    high: float
    bar: str = ""
    """What was asked for."""
    is_share: bool = True


def _key(effect: str, joint: str | None, parameters: Mapping[str, Any]) -> tuple[str, str | None]:
    if effect == DRIFT:
        return f"{DRIFT}:{next(iter(parameters)).partition('.')[0]}", joint
    return effect, joint


def cause_label(cause: Cause) -> Label:
    """What a cause says."""
    if cause.name == "unknown":
        return UNKNOWN_LABEL
    return frozenset(_key(e.effect, e.joint, e.parameters) for e in cause.effects)


def wilson(hits: int, count: int, normal: float = NORMAL_95) -> tuple[float, float]:
    """95 % interval of a share (Wilson 1927)."""
    if count == 0:
        return float("nan"), float("nan")
    share, z2 = hits / count, normal**2
    middle = (share + z2 / (2 * count)) / (1 + z2 / count)
    half = normal / (1 + z2 / count) * np.sqrt(share * (1 - share) / count + z2 / (4 * count**2))
    return max(float(middle - half), 0.0), min(float(middle + half), 1.0)


def read_sealed(path: Path, sha256: str) -> list[SetTruth]:
    """The truth of a challenge.

    Raises:
        UsageError: missing, broken, or not the file that was sealed.
    """
    try:
        text = path.read_text(encoding="utf-8")
        sets = [SetTruth.model_validate(item) for item in json.loads(text)["sets"]]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UsageError(f"sealed file {path} cannot be read: {error}") from error
    found = hashlib.sha256(text.encode()).hexdigest()
    if found != sha256:
        raise UsageError(
            f"sealed file {path} has sha256 {found[:12]}..., the challenge published {sha256[:12]}...: "
            "it was changed, or belongs to another challenge"
        )
    return sets


def match(answers: Mapping[str, Any], truths: Sequence[SetTruth]) -> list[Scored]:
    """Sets that were answered."""
    scored: list[Scored] = []
    for truth in truths:
        given = answers["sets"].get(truth.set_id)
        if given is None:
            continue
        said = given["said"]
        said = None if "error" in said else Diagnosis.model_validate(said)
        memory = float(given.get("memory_mib", float("nan")))
        scored.append(Scored(truth, said, float(given["seconds"]), memory))
    return scored


def measures(scored: Sequence[Scored]) -> list[Measure]:
    """All lines of the table."""
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
        Measure("AUROC of unknown", len(scored), _auroc(scored), *_NO, "", False),
        *_sizes(scored),
        *_shrinks(hidden),
        _number("seconds a set, median", [s.seconds for s in scored], np.median, "<= 60"),
        _number("seconds a set, worst", [s.seconds for s in scored], np.max),
        _number("memory, MiB, worst", [s.memory_mib for s in scored], np.max, "<= 1536"),
        _share("failed", scored, lambda s: s.said is None),
    ]
    return [line for line in lines if line.number]


_NO: Final = (float("nan"), float("nan"))


def _share(
    name: str, sets: Sequence[Scored], hit: Callable[[Scored], bool], bar: str = ""
) -> Measure:
    hits = sum(bool(hit(s)) for s in sets)
    value = hits / len(sets) if sets else float("nan")
    return Measure(name, len(sets), value, *wilson(hits, len(sets)), bar)


def _number(
    name: str, values: Sequence[float], of: Callable[[Sequence[float]], Any], bar: str = ""
) -> Measure:
    finite = [value for value in values if np.isfinite(value)]
    value = float(of(finite)) if finite else float("nan")
    return Measure(name, len(finite), value, *_NO, bar, False)


def _noticed(s: Scored) -> bool:
    return s.top is not None and s.top != NONE_LABEL


def _named_or_one_of_two(s: Scored) -> bool:
    """Whether the exact set was named, or is one of two that the throws are said not to tell apart."""
    return s.is_right or s.is_right_or_ambiguous


def _stage_right(s: Scored) -> bool:
    return s.where in {effect.stage for effect in s.truth.effects}


def _effect_right(s: Scored) -> bool:
    return s.top is not None and {e for e, _ in s.top} == {e for e, _ in s.label}


def _among_first(s: Scored) -> bool:
    return s.label in [label for label, _ in s.ranked[:TOP_COUNT]]


def _f1(s: Scored) -> float:
    named = s.top or NONE_LABEL
    hits = len(named & s.label)
    return 2.0 * hits / (len(named) + len(s.label)) if named or s.label else 1.0


def calibration_error(scored: Sequence[Scored]) -> float:
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


def _auroc(scored: Sequence[Scored]) -> float:
    """Chance that an unknown set got a higher probability of "unknown" than another one."""
    chance = [
        (sum(p for label, p in s.ranked if label == UNKNOWN_LABEL), s.truth.tier is Tier.UNKNOWN)
        for s in scored
    ]
    yes = np.array([p for p, unknown in chance if unknown])
    no = np.array([p for p, unknown in chance if not unknown])
    if not yes.size or not no.size:
        return float("nan")
    higher = (yes[:, None] > no).mean() + 0.5 * (yes[:, None] == no).mean()
    return float(higher)


def _sizes(scored: Sequence[Scored]) -> list[Measure]:
    """Errors and intervals of the magnitudes of causes that were named rightly."""
    errors: list[float] = []
    covered: list[bool] = []
    for s in scored:
        if not s.is_right or s.said is None or not s.truth.effects or s.label == UNKNOWN_LABEL:
            continue
        cause = next(c for c in s.said.causes if cause_label(c) == s.label)
        for effect in s.truth.effects:
            key = _key(effect.effect, effect.joint, effect.parameters)
            found = next(e for e in cause.effects if _key(e.effect, e.joint, e.parameters) == key)
            names = set(effect.parameters) | set(found.parameters)
            true = np.array([effect.parameters.get(name, 0.0) for name in sorted(names)])
            fitted = [found.parameters.get(name) for name in sorted(names)]
            value = np.array([0.0 if f is None else f.value for f in fitted])
            errors.append(float(np.linalg.norm(value - true) / np.linalg.norm(true)))
            covered += [
                f.ci90[0] <= size <= f.ci90[1]
                for f, size in zip(fitted, true, strict=True)
                if f is not None
            ]
    hits = sum(covered)
    share = hits / len(covered) if covered else float("nan")
    return [
        _number("size error, median", errors, np.median, "<= 0.10"),
        Measure(
            "90 % intervals that hold", len(covered), share, *wilson(hits, len(covered)), "85-95 %"
        ),
    ]


def _shrinks(hidden: Sequence[Scored]) -> list[Measure]:
    found = [s.said.shrink for s in hidden if s.said is not None and s.said.shrink is not None]
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


def mistakes(scored: Sequence[Scored]) -> list[str]:
    """One line for each set that was answered wrongly: what was hidden, what was said."""
    lines: list[str] = []
    for s in scored:
        if s.is_right_or_ambiguous:
            continue
        hidden = " + ".join(
            f"{e.effect}{'.' + e.joint if e.joint else ''} x{e.multiple_ratio:.1f}"
            for e in s.truth.effects
        )
        answer = "failed" if s.said is None else f"{s.said.verdict.value}: {_say(s.top)}"
        share = f"p(truth) {s.truth_probability:.2f}"
        lines.append(
            f"{s.truth.set_id} {s.truth.tier.value:<8} {hidden or '-':<60} {answer} {share}"
        )
    return lines


def _say(label: Label | None) -> str:
    if label is None:
        return "-"
    return " + ".join(f"{e}{'.' + j if j else ''}" for e, j in sorted(label, key=str)) or "none"
