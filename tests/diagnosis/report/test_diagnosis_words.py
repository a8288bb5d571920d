"""The texts that the report and the console's Gap page show."""

from diagnosis.report.diagnosis_words import words_of
from diagnosis.report.vocabulary import compared_words, parameter_words, size_words
from diagnosis.verdict import (
    Ambiguity,
    Cause,
    Diagnosis,
    FittedEffect,
    FittedParameter,
    Gap,
    Shrink,
    VerdictKind,
)
from tests.cases import each

SHRINK = Shrink(
    before_m=0.4,
    after_m=0.1,
    ratio=0.81,
    ci90=(0.7, 0.88),
    held_out_throws=12,
    predicted_ratio=0.85,
    removable_ratio=0.9,
)


def effect(name: str, joint: str | None = None, **parameters: FittedParameter) -> FittedEffect:
    return FittedEffect(effect=name, joint=joint, parameters=parameters)


def size(value: float, unit: str) -> FittedParameter:
    return FittedParameter(value=value, ci90=(value - 0.007, value + 0.008), unit=unit)


def of_throws(**values: object) -> Diagnosis:
    return Diagnosis.model_validate({"verdict": VerdictKind.EXPLAINED, **values})


def test_causes_have_title_probability_and_sizes() -> None:
    dead_time = effect("valve_dead_time", "dipper", extra_dead_time_s=size(0.062, "s"))
    drift = effect("warm_up_drift", **{"release_delay.extra_delay_s": size(0.07, "s")})
    causes = (
        Cause(effects=(dead_time,), probability=0.9999, name="valve dead time of the dipper"),
        Cause(effects=(drift,), probability=0.42),
        Cause(effects=(), probability=0.07, name="unknown"),
        Cause(effects=(), probability=1e-9, name="none"),
    )
    words = words_of(of_throws(causes=causes)).causes
    assert [(cause.title, cause.probability) for cause in words] == [
        ("valve dead time, dipper", "> 99 %"),
        ("drift of release delay", "42 %"),
        ("something unknown", "7 %"),
        ("no effect", "< 1 %"),
    ]
    (shown,) = words[0].effects[0].sizes
    assert (shown.name, shown.value, shown.interval) == (
        "extra dead time",
        "62.0 ms",
        "55.0 to 70.0 ms",
    )


@each(
    "value, unit, text",
    [
        (-0.02, "rad", "−20.0 mrad"),
        (0.3, "1", "30.0 %"),
        (2.0, "m/s", "2.00 m/s"),
        (1.5, "s", "1.50 s"),
    ],
)
def test_sizes_are_in_units_that_a_person_would_choose(value: float, unit: str, text: str) -> None:
    assert size_words(effect("any", any=size(value, unit)))[0][1] == text


@each(
    "name, text",
    [
        ("extra_dead_time_s", "extra dead time"),
        ("half_width_ratio", "half width"),
        ("gap_rad_m", "gap"),
        ("valve_lag.extra_lag_s", "valve lag, extra lag"),
    ],
)
def test_parameters_are_named_without_their_units(name: str, text: str) -> None:
    assert parameter_words(name) == text


def test_reasons_are_read_from_evidence_whatever_else_stands_there() -> None:
    drifting = {"effect": "warm_up_drift:valve_lag.extra_lag_s", "joint": "dipper"}
    evidence = {"ruled_out": [{"effect": "wind", "joint": None, "log_odds": -4.26}, drifting, "x"]}
    assert [
        (reason.name, reason.why) for reason in words_of(of_throws(evidence=evidence)).ruled_out
    ] == [
        ("wind", "natural log odds −4.3 against no effect"),
        ("drift of valve lag, extra lag, dipper", ""),
        ("x", ""),
    ]
    assert words_of(of_throws()).ruled_out == ()


def test_how_far_the_gap_shrinks_and_on_what_that_was_measured() -> None:
    gap = Gap(impact_rms_m=0.4)
    assert words_of(of_throws(gap=gap, shrink=SHRINK)).shrink == (
        "Removes 81 % of the removable gap on 12 held-out throws, 90 % interval 70 % to 88 %. "
        "Predicted before it was added: 85 %. 90 % of the gap is removable, the rest is noise and "
        "jitter. Both values are without the error that every healthy machine of the type has against "
        "its twin."
    )
    evidence = {"shrink_measure": "channels"}
    unpredicted = SHRINK.model_copy(update={"predicted_ratio": None})
    channels = words_of(of_throws(gap=gap, shrink=unpredicted, evidence=evidence)).shrink
    assert "81 % of the gap in the channels that it moves" in channels
    assert "removable" not in channels
    worse = SHRINK.model_copy(update={"ratio": -0.89, "ci90": (-1.0, -0.65)})
    assert "Widens the removable gap by 89 %" in words_of(of_throws(gap=gap, shrink=worse)).shrink
    assert words_of(of_throws()).shrink == ""


def test_what_is_undecided() -> None:
    ambiguity = Ambiguity(members=("a", "b"), separating_motion={}, why="they look alike")
    assert (
        words_of(of_throws(ambiguity=ambiguity)).undecided == "Undecided: a or b; they look alike."
    )
    assert words_of(of_throws()).undecided == ""


def test_what_throws_were_compared_with() -> None:
    assert compared_words(0) == "healthy machines of the type"
    assert compared_words(1) == "1 healthy throw of this machine"
    assert compared_words(24) == "24 healthy throws of this machine"
