"""Every effect has a sentence with its size and interval, and a place to look at."""

from string import Formatter

from diagnosis.report.effect_sentences import DOES, INSPECT, effect_sentence, inspection
from diagnosis.verdict import FittedEffect, FittedParameter
from sim_twin.effects.schema import DRIFT, parameter_unit
from sim_twin.effects.table import EFFECTS


def fitted(name: str, joint: str | None = None, **sizes: float) -> FittedEffect:
    parameters = {
        key.replace("__", "."): FittedParameter(
            value=value, ci90=(value - 0.01, value + 0.01), unit=parameter_unit(key, joint)
        )
        for key, value in sizes.items()
    }
    return FittedEffect(effect=name, joint=joint, parameters=parameters)


def test_every_parameter_has_words_and_every_effect_a_place() -> None:
    effects = {name: spec for name, spec in EFFECTS.items() if name != DRIFT}
    assert {n: set(d) for n, d in DOES.items()} == {
        n: {p.name for p in spec.parameters} for n, spec in effects.items()
    }
    assert set(INSPECT) == set(effects)
    for name, spec in effects.items():
        joint = spec.joints[0] if spec.joints else None
        for parameter in spec.parameters:
            does = DOES[name][parameter.name]
            # A size that may be negative reads well either way, but for turns, which have no word for a side.
            assert (
                does.less or parameter.low >= 0.0 or "off in" in does.more or "ed by" in does.more
            )
            for clause in filter(None, does):
                fields = {field for _, field, _, _ in Formatter().parse(clause) if field}
                assert fields == ({"joint", "size"} if joint else {"size"})
        assert "{" not in inspection(fitted(name, joint))


def test_a_size_is_a_sentence_with_unit_interval_and_bound() -> None:
    faster = effect_sentence(fitted("valve_gain", "slew", positive_ratio=0.24, negative_ratio=-0.2))
    assert faster == (
        "the slew moves 24.0 % faster than in the twin where its command is positive (90 % interval 23.0 to "
        "25.0 %), and the slew moves 20.0 % slower than in the twin where its command is negative (90 % "
        "interval 19.0 to 21.0 %)"
    )
    at_end = effect_sentence(fitted("valve_dead_time", "boom", extra_dead_time_s=0.3))
    assert "starts 300 ms later than in the twin" in at_end
    assert "at the end of the range that is searched: it may be more" in at_end
    assert "at the end" not in effect_sentence(
        fitted("valve_dead_band", "boom", positive_ratio=0.0)
    )
    unsure = effect_sentence(fitted("valve_lag", "boom", extra_lag_s=-0.005))
    assert unsure == (
        "the boom takes 5.0 ms less to come up to speed than in the twin (90 % interval −5.0 to 15.0 ms)"
    )
    drift = effect_sentence(fitted(DRIFT, "boom", valve_lag__extra_lag_s=0.05))
    assert drift.startswith("from the first throw to the last, the boom takes 50.0 ms longer")
    assert inspection(fitted(DRIFT, "boom", valve_lag__extra_lag_s=0.05)).startswith(
        "the pilot valve"
    )
