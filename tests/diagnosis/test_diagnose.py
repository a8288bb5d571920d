"""From throws to a verdict, end to end."""

from dataclasses import replace

import pytest

from diagnosis import diagnose
from diagnosis.conclusion import Findings, conclude
from diagnosis.diagnose import CancelledError, diagnose_throws
from diagnosis.verdict import Diagnosis, VerdictKind
from sim_twin.effects.effect import Effect
from tests.diagnosis.twin_throws import health, profile, throws

LAG = Effect(effect="valve_lag", joint="boom", parameters={"extra_lag_s": 0.12})


@pytest.fixture(scope="module")
def diagnosed() -> tuple[Diagnosis, Findings]:
    """A diagnosis of throws with a lag, and what its verdict depends on."""
    seen: list[Findings] = []

    def noted(findings: Findings) -> Diagnosis:
        seen.append(findings)
        return conclude(findings)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(diagnose, "conclude", noted)
        found = diagnose_throws(throws((LAG,), 5), profile(), health=health())
    return found, seen[0]


def test_one_effect_is_named_sized_and_removed(diagnosed: tuple[Diagnosis, Findings]) -> None:
    found, _ = diagnosed
    assert found.verdict is VerdictKind.EXPLAINED
    named = {(e.effect, e.joint): e.parameters for e in found.causes[0].effects}
    # Small companions at the same joint may be named beside it; another joint may not.
    assert {joint for _, joint in named} == {"boom"}
    size = named["valve_lag", "boom"]["extra_lag_s"]
    assert size.value == pytest.approx(0.12, rel=0.2)
    assert size.ci90[0] <= size.value <= size.ci90[1]
    assert size.unit == "s"
    assert found.evidence["where"] == {"stage": "actuation", "joint": "boom"}
    assert found.shrink is not None
    assert found.shrink.after_m < 0.4 * found.shrink.before_m
    assert {cause.name for cause in found.causes} >= {"none", "unknown"}
    assert sum(cause.probability for cause in found.causes) <= 1.0 + 1e-9
    # The result is what the file holds.
    assert Diagnosis.model_validate_json(found.model_dump_json()) == found


def test_an_effect_that_moves_the_impact_too_little_is_seen_and_not_claimed(
    diagnosed: tuple[Diagnosis, Findings],
) -> None:
    found = conclude(replace(diagnosed[1], material_m=9.0))
    assert found.verdict is VerdictKind.NONE
    assert "No effect that matters. Small change seen: valve lag of the boom" in found.sentence
    assert "less than the 9 m asked for" in found.sentence
    assert found.shrink is None
    # What was seen stays in the file.
    assert {e.effect for e in found.causes[0].effects} >= {"valve_lag"}


def test_too_few_throws_are_refused() -> None:
    loaded = throws((), 5)
    found = diagnose_throws(replace(loaded, throws=loaded.throws[:2]), profile(), health=health())
    assert found.verdict is VerdictKind.BAD_DATA


def test_it_can_be_cancelled() -> None:
    texts: list[str] = []
    with pytest.raises(CancelledError):
        diagnose_throws(
            throws((), 5),
            profile(),
            progress=lambda _, text: texts.append(text),
            cancel=lambda: len(texts) >= 2,
            health=health(),
        )
    assert len(texts) == 2
