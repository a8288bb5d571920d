"""The sentence of a verdict is told in words, without names that only the code knows."""

from types import SimpleNamespace
from typing import cast

from diagnosis.causes.hypotheses import Hypothesis
from diagnosis.causes.ranking import Ranked, unknown_log_odds
from diagnosis.conclude import sentence_of
from diagnosis.verdict import Cause, Gap, VerdictKind
from sim_twin.effects.effect import Effect


def test_an_unknown_effect_is_placed_in_words() -> None:
    best = SimpleNamespace(effects=())
    ranked = SimpleNamespace(
        levels={"flight.ball": 12.4, "actuation.boom": 1.1}, shape=None, best=best, ahead=0.0
    )
    causes = (Cause(effects=(), probability=0.9, name="unknown"),)
    gap = Gap(impact_rms_m=0.5, downrange_bias_m=0.5, crossrange_bias_m=0.0)
    sentence = sentence_of(VerdictKind.UNKNOWN, causes, gap, None, cast("Ranked", ranked), None)
    assert sentence == (
        "The twin misses by 0.50 m. Something unknown in flight: the best known cause leaves the "
        "tracked flight of the load 12 standard deviations above a healthy machine."
    )


def test_two_effects_at_a_joint_may_leave_less_there() -> None:
    """Together they take most of what a foreign effect does."""
    two = tuple(
        Effect(effect=effect, joint="boom", parameters={name: 0.1})
        for effect, name in (("valve_hysteresis", "half_width_ratio"), ("valve_lag", "extra_lag_s"))
    )
    left = {"flight.ball": 4.0, "actuation.boom": 3.3, "actuation.slew": 3.3}
    for effects, block, is_foreign in (
        (two, "actuation.boom", True),
        (two, "actuation.slew", False),
        (two[:1], "actuation.boom", False),
    ):
        best = cast("Hypothesis", SimpleNamespace(effects=effects))
        assert (unknown_log_odds(best, 0.0, block, left[block]) > 0.0) is is_foreign
    ranked = SimpleNamespace(levels=left, shape=None, best=SimpleNamespace(effects=two), ahead=0.0)
    causes = (Cause(effects=(), probability=0.9, name="unknown"),)
    gap = Gap(impact_rms_m=0.5, downrange_bias_m=0.5, crossrange_bias_m=0.0)
    sentence = sentence_of(VerdictKind.UNKNOWN, causes, gap, None, cast("Ranked", ranked), None)
    assert "Something unknown in actuation of the boom" in sentence


def test_a_large_effect_may_leave_more() -> None:
    """A pump 2000 ahead of no effect leaves 6 sd at a joint by its form alone."""
    best = cast("Hypothesis", SimpleNamespace(effects=()))
    block = "actuation.telescope"
    for ahead, level, is_foreign in ((100.0, 6.0, True), (2000.0, 6.0, False), (9e4, 8.0, True)):
        assert (unknown_log_odds(best, ahead, block, level) > 0.0) is is_foreign
