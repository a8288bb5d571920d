"""What a challenge draws: reproducible, within bounds, every kind in its share, takable by the plant."""

from collections import Counter

import numpy as np
import pytest

from challenge.detection_limits import load_limits
from challenge.sealed_truth import Tier, draw_truths, weaker
from machine.errors import UsageError
from sim_twin.effects.pairs import CONFUSABLE_PAIRS
from sim_twin.effects.schema import DRIFT
from sim_twin.faults.fault import EffectSizes
from sim_twin.faults.fault_tables import FAULTS

LIMITS = load_limits()
TRUTHS = draw_truths(11, 400, LIMITS)
CONFUSED = [(pair.first, pair.second) for pair in CONFUSABLE_PAIRS if pair.is_hidden]


def test_the_same_seed_makes_the_same_challenge_and_another_another() -> None:
    assert draw_truths(11, 400, LIMITS) == TRUTHS
    assert draw_truths(12, 400, LIMITS) != TRUTHS


def test_tiers_come_in_their_shares_and_in_no_order() -> None:
    counts = Counter(truth.tier for truth in TRUTHS)
    assert counts == {
        Tier.NULL: 80,
        Tier.SINGLE: 160,
        Tier.PAIR: 60,
        Tier.UNKNOWN: 50,
        Tier.CROSS: 50,
    }
    first = Counter(truth.tier for truth in TRUTHS[:100])
    assert len(first) == 5
    assert [t.set_id for t in TRUTHS] == sorted(t.set_id for t in TRUTHS)


def test_some_tiers_alone() -> None:
    assert {t.tier for t in draw_truths(1, 9, LIMITS, [Tier.NULL, Tier.PAIR])} == {
        Tier.NULL,
        Tier.PAIR,
    }
    with pytest.raises(UsageError, match="at least 1 set"):
        draw_truths(1, 0, LIMITS)


def test_healthy_sets_need_no_limits() -> None:
    truths = draw_truths(1, 4, {}, [Tier.NULL])
    assert [t.effects for t in truths] == [()] * 4


def test_half_of_the_singles_are_strong() -> None:
    multiples = np.array([t.effects[0].multiple_ratio for t in TRUTHS if t.tier is Tier.SINGLE])
    assert 0.4 < np.mean(multiples >= 1.94) < 0.6
    assert multiples.max() <= 10.0
    assert multiples.min() > 0.9


def test_every_effect_appears() -> None:
    drawn = {e.effect for t in TRUTHS for e in t.effects}
    assert drawn >= set(FAULTS) | {DRIFT}


def test_sizes_lie_within_bounds_and_the_plant_takes_them() -> None:
    for truth in TRUTHS:
        for effect in truth.effects:
            EffectSizes([effect.in_plant()], np.zeros(3))
            for name, size in effect.parameters.items():
                owner, _, parameter = (
                    name.partition(".") if effect.effect == DRIFT else (effect.effect, "", name)
                )
                low, high = FAULTS[owner].bounds[parameter]
                assert low <= size <= high
                assert size != 0.0


def test_half_of_the_pairs_are_hard_to_tell_apart() -> None:
    pairs = [frozenset(e.effect for e in t.effects) for t in TRUTHS if t.tier is Tier.PAIR]
    confounded = sum(pair in {frozenset(c) for c in CONFUSED} for pair in pairs)
    assert all(len(pair) == 2 for pair in pairs)
    assert confounded >= 0.45 * len(pairs)


def test_confounded_effects_sit_on_one_joint() -> None:
    pairs = [
        {e.joint for e in truth.effects if e.joint is not None}
        for truth in TRUTHS
        if truth.tier is Tier.PAIR and tuple(e.effect for e in truth.effects) in CONFUSED
    ]
    # Any two effects may meet by chance, too.
    assert sum(len(joints) > 1 for joints in pairs) <= 0.1 * len(pairs)


def test_weaker_keeps_the_kind_of_an_effect() -> None:
    truth = next(t for t in TRUTHS if t.effects and t.effects[0].effect == "gain_oscillation")
    before, after = truth.effects[0], weaker(truth, 0.5).effects[0]
    assert after.parameters["frequency_hz"] == before.parameters["frequency_hz"]
    assert after.parameters["amplitude_ratio"] == 0.5 * before.parameters["amplitude_ratio"]
    assert after.multiple_ratio == 0.5 * before.multiple_ratio
