"""Scores of made-up answers: every measure says what it should; the sealed file must be the sealed one."""

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest

from challenge.score import ScoredSet, match, mistakes, read_sealed
from challenge.score_table import Measure, calibration_error, measures, share_interval, table
from challenge.sealed_truth import SetTruth, Tier, TrueEffect
from diagnosis.verdict import (
    Ambiguity,
    Cause,
    Diagnosis,
    FittedEffect,
    FittedParameter,
    Shrink,
    VerdictKind,
)
from machine.errors import UsageError


def hidden(
    effect: str, joint: str | None = None, multiple: float = 3.0, **sizes: float
) -> TrueEffect:
    return TrueEffect(
        effect=effect,
        joint=joint,
        parameters=sizes,
        stage="actuation" if joint else "flight",
        multiple_ratio=multiple,
    )


def truth(tier: Tier, *effects: TrueEffect, name: str = "set-0001") -> SetTruth:
    return SetTruth(set_id=name, tier=tier, unit_seed=0, seed=1, effects=effects)


def cause(probability: float, *effects: FittedEffect, name: str = "") -> Cause:
    text = name or " and ".join(f"{e.effect} {e.joint}" for e in effects)
    return Cause(effects=effects, probability=probability, name=text)


def fitted(
    effect: str, joint: str | None = None, half: float = 0.01, **sizes: float
) -> FittedEffect:
    parameters = {
        name: FittedParameter(value=v, ci90=(v - half, v + half), unit="")
        for name, v in sizes.items()
    }
    return FittedEffect(effect=effect, joint=joint, parameters=parameters)


def said(
    verdict: VerdictKind, *causes: Cause, stage: str | None = None, **more: object
) -> Diagnosis:
    evidence = {} if stage is None else {"where": {"stage": stage, "joint": None}}
    return Diagnosis.model_validate(
        {"verdict": verdict, "causes": causes, "evidence": evidence, **more}
    )


DELAY = hidden("valve_dead_time", "boom", extra_dead_time_s=0.10)
RIGHT = fitted("valve_dead_time", "boom", extra_dead_time_s=0.105)
WRONG_JOINT = fitted("valve_dead_time", "dipper", extra_dead_time_s=0.1)
NONE = cause(0.1, name="none")


def value(scored: list[ScoredSet], name: str) -> Measure:
    return next(m for m in measures(scored) if m.name == name)


def test_a_share_of_nothing_has_no_interval() -> None:
    assert share_interval(196, 200) == pytest.approx((0.9497, 0.9922), abs=1e-3)
    assert np.isnan(share_interval(0, 0)).all()


def test_a_right_cause_counts_with_size_and_interval() -> None:
    shrink = Shrink(
        predicted_ratio=0.9,
        before_m=1.0,
        after_m=0.1,
        ratio=0.85,
        ci90=(0.8, 0.9),
        held_out_throws=4,
        removable_ratio=1.0,
    )
    right = ScoredSet(
        truth(Tier.SINGLE, DELAY),
        said(VerdictKind.EXPLAINED, cause(0.9, RIGHT), NONE, stage="actuation", shrink=shrink),
        4.0,
    )
    assert right.is_right
    assert right.truth_probability == 0.9
    for name in ("cause, single >= 2x", "stage named, single >= 2x", "90 % intervals that hold"):
        assert value([right], name).value == 1.0
    assert value([right], "size error, median").value == pytest.approx(0.05)
    assert value([right], "removable gap closed, median").value == 0.85
    assert value([right], "predicted against realised shrink, median").value == pytest.approx(0.05)
    assert value([right], "seconds a set, worst").value == 4.0


def test_the_wrong_joint_is_wrong_but_the_effect_is_right() -> None:
    wrong = ScoredSet(
        truth(Tier.SINGLE, DELAY), said(VerdictKind.EXPLAINED, cause(0.9, WRONG_JOINT), NONE), 1.0
    )
    assert not wrong.is_right
    assert value([wrong], "cause of any joint, single >= 2x").value == 1.0
    assert value([wrong], "cause, single >= 2x").value == 0.0
    assert value([wrong], "log score").value == pytest.approx(np.log(1e-3))
    assert "valve_dead_time.dipper" in mistakes([wrong])[0]


def test_an_ambiguity_is_right_with_two_members_and_a_motion() -> None:
    causes = (cause(0.5, WRONG_JOINT, name="a"), cause(0.4, RIGHT, name="b"), NONE)

    def answer(members: tuple[str, ...], motion: dict[str, str]) -> ScoredSet:
        group = Ambiguity(members=members, separating_motion=motion, why="")
        return ScoredSet(
            truth(Tier.SINGLE, DELAY), said(VerdictKind.AMBIGUOUS, *causes, ambiguity=group), 1.0
        )

    good = answer(("a", "b"), {"kind": "step"})
    assert good.is_right_or_ambiguous
    assert not good.is_right
    assert not answer(("a", "b"), {}).is_right_or_ambiguous
    assert not answer(("a", "c"), {"kind": "step"}).is_right_or_ambiguous
    assert not answer(("a", "b", "c"), {"kind": "step"}).is_right_or_ambiguous


def test_null_and_unknown_follow_the_verdict() -> None:
    quiet = ScoredSet(truth(Tier.NULL), said(VerdictKind.NONE, cause(0.9, name="none")), 1.0)
    alarm = ScoredSet(truth(Tier.NULL), said(VerdictKind.EXPLAINED, cause(0.9, RIGHT), NONE), 1.0)
    failed = ScoredSet(truth(Tier.NULL), None, 1.0)
    assert value([quiet, alarm, failed], "false alarms on null").value == pytest.approx(2 / 3)
    odd = truth(Tier.UNKNOWN, hidden("gust", speed_m_per_s=5.0))
    flagged = ScoredSet(
        odd, said(VerdictKind.UNKNOWN, cause(0.9, name="unknown"), NONE, stage="flight"), 1.0
    )
    missed = ScoredSet(odd, said(VerdictKind.NONE, cause(1.0, name="none")), 1.0)
    assert value([flagged, missed], "unknown flagged").value == 0.5
    assert value([flagged, missed, quiet], "AUROC of unknown").value == pytest.approx(0.75)
    known = ScoredSet(
        truth(Tier.SINGLE, DELAY), said(VerdictKind.UNKNOWN, cause(0.9, name="unknown")), 1.0
    )
    assert value([known, flagged], "known called unknown").value == 1.0


def test_pairs_need_both_effects() -> None:
    other = hidden("wind", x_m_per_s=2.0, y_m_per_s=0.0)
    both = truth(Tier.PAIR, DELAY, other)
    found = fitted("wind", x_m_per_s=2.2, y_m_per_s=0.0)
    exact = ScoredSet(both, said(VerdictKind.EXPLAINED, cause(0.8, found, RIGHT)), 1.0)
    half = ScoredSet(both, said(VerdictKind.EXPLAINED, cause(0.8, RIGHT)), 1.0)
    assert value([exact, half], "exact set, pairs").value == 0.5
    causes = (cause(0.5, found, WRONG_JOINT, name="a"), cause(0.4, found, RIGHT, name="b"), NONE)
    group = Ambiguity(members=("a", "b"), separating_motion={"kind": "step"}, why="")
    either = ScoredSet(both, said(VerdictKind.AMBIGUOUS, *causes, ambiguity=group), 1.0)
    assert value([exact, half, either], "exact set, pairs").value == pytest.approx(1 / 3)
    assert value([exact, half, either], "exact set or one of two, pairs").value == pytest.approx(
        2 / 3
    )
    assert value([half], "F1 of effects, pairs").value == pytest.approx(2 / 3)
    assert value([exact], "size error, median").value == pytest.approx(0.075)


def test_who_never_alarms_or_names_little_is_compared_fairly() -> None:
    """Alarms by rank, sizes on the effects that both name."""
    quiet, loud = said(VerdictKind.NONE, cause(0.9, name="none")), (cause(0.9, RIGHT), NONE)
    healthy, faulty = truth(Tier.NULL), truth(Tier.SINGLE, DELAY, name="set-0002")
    ours = [
        ScoredSet(healthy, quiet, 1.0),
        ScoredSet(faulty, said(VerdictKind.EXPLAINED, *loud), 1.0),
    ]
    mute = [ScoredSet(one, quiet, 1.0) for one in (healthy, faulty)]
    assert value(mute, "false alarms on null").value == 0.0
    assert value(mute, "AUROC of an effect").value == 0.5
    assert value(ours, "AUROC of an effect").value == 1.0
    rough = cause(0.9, fitted("valve_dead_time", "boom", extra_dead_time_s=0.13))
    theirs = [ScoredSet(faulty, said(VerdictKind.EXPLAINED, rough), 1.0)]
    name = "size error of the first, same effects"
    assert [m for m in measures(ours) if m.name == name] == []
    by_name = {m.name: m for m in measures(theirs, ours)}
    assert by_name["size error, median"].value == pytest.approx(0.3)
    assert (by_name[name].value, by_name[name].number) == (pytest.approx(0.05), 1)
    assert [m for m in measures(mute, ours) if m.name == name] == []


def test_drifts_are_told_by_what_drifts() -> None:
    drift = hidden("warm_up_drift", "boom", **{"valve_gain.positive_ratio": 0.2})
    named = fitted("warm_up_drift", "boom", **{"valve_gain.negative_ratio": 0.2})
    other = fitted("warm_up_drift", "boom", **{"valve_lag.extra_lag_s": 0.2})
    assert ScoredSet(
        truth(Tier.SINGLE, drift), said(VerdictKind.EXPLAINED, cause(0.9, named)), 1.0
    ).is_right
    assert not ScoredSet(
        truth(Tier.SINGLE, drift), said(VerdictKind.EXPLAINED, cause(0.9, other)), 1.0
    ).is_right


def test_calibration_error_is_zero_for_honest_probabilities() -> None:
    def answers(probability: float, right: int, count: int) -> list[ScoredSet]:
        return [
            ScoredSet(
                truth(Tier.SINGLE, DELAY),
                said(
                    VerdictKind.EXPLAINED, cause(probability, RIGHT if i < right else WRONG_JOINT)
                ),
                1.0,
            )
            for i in range(count)
        ]

    assert calibration_error(answers(0.75, 15, 20)) == pytest.approx(0.0)
    assert calibration_error(answers(0.95, 9, 20)) == pytest.approx(0.5)


def test_only_the_sealed_file_is_taken(tmp_path: Path) -> None:
    path = tmp_path / "truth.json"
    sets = [truth(Tier.SINGLE, DELAY).model_dump(mode="json")]
    path.write_text(json.dumps({"sets": sets}))
    sha256 = hashlib.sha256(path.read_bytes()).hexdigest()
    truths = read_sealed(path, sha256)
    assert truths == [truth(Tier.SINGLE, DELAY)]
    answers = {"sets": {"set-0001": {"seconds": 1.0, "said": {"error": "x"}}}}
    assert match(answers, truths)[0].diagnosis is None
    assert match({"sets": {}}, truths) == []
    path.write_text(path.read_text() + " ")
    with pytest.raises(UsageError, match="was changed"):
        read_sealed(path, sha256)
    with pytest.raises(UsageError, match="cannot be read"):
        read_sealed(tmp_path / "missing.json", sha256)


def test_the_table_has_a_column_for_each_method() -> None:
    right = [
        ScoredSet(truth(Tier.SINGLE, DELAY), said(VerdictKind.EXPLAINED, cause(0.9, RIGHT)), 4.0)
    ]
    wrong = [ScoredSet(truth(Tier.NULL), None, 4.0)]
    text = table([("diagnose", measures(right)), ("lag_rmse", measures(wrong))])
    head, *rows = text.splitlines()
    assert "diagnose" in head
    assert "lag_rmse" in head
    assert any(row.startswith("cause, single >= 2x ") and "100.0 %" in row for row in rows)
    assert any(row.startswith("false alarms on null") and "100.0 %" in row for row in rows)
