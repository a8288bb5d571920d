"""The sentence of a verdict is told in words, without names that only the code knows."""

from types import SimpleNamespace
from typing import cast

from diagnosis.causes.ranking import Ranked
from diagnosis.conclude import _sentence  # pyright: ignore[reportPrivateUsage]
from diagnosis.verdict import Cause, Gap, VerdictKind


def test_an_unknown_effect_is_placed_in_words() -> None:
    best = SimpleNamespace(effects=())
    ranked = SimpleNamespace(
        levels={"flight.ball": 12.4, "actuation.boom": 1.1}, shape=None, best=best
    )
    causes = (Cause(effects=(), probability=0.9, name="unknown"),)
    gap = Gap(impact_rms_m=0.5, downrange_bias_m=0.5, crossrange_bias_m=0.0)
    sentence = _sentence(VerdictKind.UNKNOWN, causes, gap, None, cast("Ranked", ranked), None)
    assert sentence == (
        "The twin misses by 0.50 m. Something unknown in flight: the best known cause leaves the "
        "tracked flight of the load 12 standard deviations above a healthy machine."
    )
