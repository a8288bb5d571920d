"""Compares answers with the sealed truth, set by set.

An answer is right when the most probable cause is exactly what was hidden. An ambiguous verdict is right when
the truth is one of at most two members and a motion that separates them is named.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from challenge.sealed_truth import SetTruth, Tier
from diagnosis.verdict import Cause, Diagnosis, VerdictKind
from machine.errors import UsageError
from sim_twin.faults.fault import DRIFT

Label = frozenset[tuple[str, str | None]]
"""Effects and joints; drifts as ``warm_up_drift:<effect>``."""
UNKNOWN_LABEL: Final[Label] = frozenset({("unknown", None)})
NONE_LABEL: Final[Label] = frozenset()


class ScoredSet(NamedTuple):
    """One set and its answer."""

    truth: SetTruth
    diagnosis: Diagnosis | None
    """None: the program failed."""
    seconds: float
    memory_mib: float = float("nan")
    """Peak memory of the process when the set was done."""

    @property
    def label(self) -> Label:
        """The right answer."""
        if self.truth.tier is Tier.UNKNOWN:
            return UNKNOWN_LABEL
        return frozenset(
            effect_key(effect.effect, effect.joint, effect.parameters)
            for effect in self.truth.effects
        )

    @property
    def multiple_ratio(self) -> float:
        """Of the weakest hidden effect."""
        return min((effect.multiple_ratio for effect in self.truth.effects), default=0.0)

    @property
    def ranked(self) -> list[tuple[Label, float]]:
        """Answers, the most probable first."""
        if self.diagnosis is None:
            return []
        ranked = [(cause_label(cause), cause.probability) for cause in self.diagnosis.causes]
        return sorted(ranked, key=lambda pair: -pair[1])

    @property
    def top(self) -> Label | None:
        """The most probable answer that is consistent with the verdict."""
        if self.diagnosis is None or self.diagnosis.verdict is VerdictKind.BAD_DATA:
            return None
        if self.diagnosis.verdict is VerdictKind.NONE:
            return NONE_LABEL
        if self.diagnosis.verdict is VerdictKind.UNKNOWN:
            return UNKNOWN_LABEL
        named = [label for label, _ in self.ranked if label not in (NONE_LABEL, UNKNOWN_LABEL)]
        return named[0] if named else None

    @property
    def is_right(self) -> bool:
        """Whether the most probable answer is the truth."""
        return self.top == self.label

    @property
    def is_right_or_ambiguous(self) -> bool:
        """Whether it is right, or the truth is in an ambiguity of two with a separating motion."""
        if self.diagnosis is None or self.diagnosis.verdict is not VerdictKind.AMBIGUOUS:
            return self.is_right
        group = self.diagnosis.ambiguity
        if group is None or len(group.members) > 2 or not group.separating_motion:
            return False
        labels = [cause_label(c) for c in self.diagnosis.causes if c.name in group.members]
        return self.label in labels

    @property
    def truth_probability(self) -> float:
        """Probability that was given to the truth."""
        return min(sum(p for label, p in self.ranked if label == self.label), 1.0)

    @property
    def where(self) -> str | None:
        """The stage that was named."""
        if self.diagnosis is None:
            return None
        named = self.diagnosis.evidence.get("where")
        if isinstance(named, Mapping) and "stage" in named:
            return str(named["stage"])
        largest = max(self.diagnosis.stages, key=lambda s: s.share_ratio, default=None)
        return None if largest is None else str(largest.stage)


def effect_key(
    effect: str, joint: str | None, parameters: Mapping[str, Any]
) -> tuple[str, str | None]:
    """Effect and joint; a drift is named by the drifting effect."""
    if effect == DRIFT:
        return f"{DRIFT}:{next(iter(parameters)).partition('.')[0]}", joint
    return effect, joint


def cause_label(cause: Cause) -> Label:
    """Effects and joints of a cause."""
    if cause.name == "unknown":
        return UNKNOWN_LABEL
    return frozenset(effect_key(e.effect, e.joint, e.parameters) for e in cause.effects)


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


def match(answers: Mapping[str, Any], truths: Sequence[SetTruth]) -> list[ScoredSet]:
    """Pair each answered set with its truth."""
    scored: list[ScoredSet] = []
    for truth in truths:
        given = answers["sets"].get(truth.set_id)
        if given is None:
            continue
        said = given["said"]
        said = None if "error" in said else Diagnosis.model_validate(said)
        memory = float(given.get("memory_mib", float("nan")))
        scored.append(ScoredSet(truth, said, float(given["seconds"]), memory))
    return scored


def mistakes(scored: Sequence[ScoredSet]) -> list[str]:
    """One line for each wrong answer: what was hidden and what was answered."""
    lines: list[str] = []
    for s in scored:
        if s.is_right_or_ambiguous:
            continue
        hidden = " + ".join(
            f"{e.effect}{'.' + e.joint if e.joint else ''} x{e.multiple_ratio:.1f}"
            for e in s.truth.effects
        )
        answer = "failed" if s.diagnosis is None else f"{s.diagnosis.verdict.value}: {_say(s.top)}"
        share = f"p(truth) {s.truth_probability:.2f}"
        lines.append(
            f"{s.truth.set_id} {s.truth.tier.value:<8} {hidden or '-':<60} {answer} {share}"
        )
    return lines


def _say(label: Label | None) -> str:
    if label is None:
        return "-"
    return " + ".join(f"{e}{'.' + j if j else ''}" for e, j in sorted(label, key=str)) or "none"
