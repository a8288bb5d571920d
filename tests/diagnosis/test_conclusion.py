"""Verdict, sentence, location and ambiguity."""

from types import SimpleNamespace
from typing import cast

from diagnosis.conclusion import ambiguity_of, rival_of, sentence_of, verdict_of
from diagnosis.hypotheses.ranking import Ranked
from diagnosis.hypotheses.unknown_check import Left
from diagnosis.linearisation.unmodelled_effects import UNMODELLED_EFFECTS
from diagnosis.location import signature_of, where
from diagnosis.verdict import Cause, Gap, Shrink, VerdictKind
from sim_twin.effects.effect import Effect


def test_an_unknown_effect_is_placed_in_words() -> None:
    best = SimpleNamespace(members=(1,), effects=())
    ranked = SimpleNamespace(
        left={"flight": Left(12.4, 3.0), "actuation.boom": Left(1.1, 0.2)},
        resembles=None,
        best=best,
    )
    causes = (Cause(effects=(), probability=0.9, name="unknown"),)
    gap = Gap(impact_rms_m=0.5, healthy_rms_m=0.1, downrange_bias_m=0.5, crossrange_bias_m=0.0)
    sentences = [
        sentence_of(VerdictKind.UNKNOWN, causes, one, None, cast("Ranked", ranked), None)
        for one in (gap, gap.model_copy(update={"healthy_rms_m": None}))
    ]
    begins = (
        "Something unknown in flight: the best known cause leaves the flight of the load 12 standard "
        "deviations above "
    )
    assert sentences[0].endswith(f"{begins}a healthy machine.")
    assert sentences[1] == (
        f"The twin's replay misses by 0.50 m. {begins}the twin; only reference throws tell whether this "
        "machine was ever otherwise."
    )


def test_an_effect_without_gain_is_not_claimed_while_none_is_probable() -> None:
    effect = Effect(effect="joint_sensor_bias", joint="boom", parameters={"bias_rad_m": -0.006})
    cases = (
        (0.07, (-0.11, -0.01), None, VerdictKind.NONE),
        (0.31, (-0.02, 0.04), "wind", VerdictKind.NONE),
        (0.002, (-0.11, -0.01), None, VerdictKind.AMBIGUOUS),
        (0.07, (-0.05, 0.20), None, VerdictKind.AMBIGUOUS),
        (0.07, (0.10, 0.20), None, VerdictKind.EXPLAINED),
        (0.07, (-0.26, 1.00), None, VerdictKind.NONE),
        (0.02, (-0.26, 1.00), None, VerdictKind.AMBIGUOUS),
        (0.02, (-0.06, 0.15), None, VerdictKind.NONE),
        (0.002, (-0.06, 0.15), None, VerdictKind.EXPLAINED),
    )
    for none, ci90, rival, verdict in cases:
        ranked = SimpleNamespace(
            best=SimpleNamespace(members=(3,), effects=(effect,)),
            is_unknown=False,
            is_doubtful=False,
            none_probability=none,
            has_jitter=False,
            rival=rival,
        )
        gain = Shrink(
            predicted_ratio=0.0,
            before_m=0.2,
            after_m=0.2,
            ratio=sum(ci90) / 2.0,
            ci90=ci90,
            held_out_throws=12,
            removable_ratio=0.1,
        )
        assert verdict_of(cast("Ranked", ranked), gain) is verdict


def test_the_location_is_that_of_the_most_probable_effect() -> None:
    delay, mass, drag = (
        Effect(effect=effect, joint=None, parameters={name: 0.1})
        for effect, name in (
            ("release_delay", "extra_delay_s"),
            ("payload_mass", "extra_mass_kg"),
            ("air_drag", "extra_drag_coefficient_ratio"),
        )
    )
    hypotheses = [
        SimpleNamespace(members=members, effects=effects)
        for members, effects in (((1, 2), (mass, delay)), ((2, 3), (delay, drag)), ((), ()))
    ]
    ranked = SimpleNamespace(
        hypotheses=hypotheses,
        probability=[0.4, 0.3, 0.2],
        best=hypotheses[0],
        left={},
        has_jitter=False,
    )
    for verdict in (VerdictKind.AMBIGUOUS, VerdictKind.NONE):
        assert where(verdict, cast("Ranked", ranked), ()) == {"stage": "release", "joint": None}


def test_jitter_is_claimed_where_all_else_is_doubtful() -> None:
    slow = Effect(effect="speed_limit", joint="slew", parameters={"reduction_ratio": 0.2})
    best = SimpleNamespace(members=(3,), effects=(slow,))
    none = SimpleNamespace(members=(), effects=())
    for share, verdict, stage in (
        (0.99, VerdictKind.AMBIGUOUS, "release"),
        (0.3, VerdictKind.NONE, "actuation"),
    ):
        ranked = cast(
            "Ranked",
            SimpleNamespace(
                hypotheses=[best, none],
                probability=[0.55, 0.45],
                best=best,
                rival=none,
                is_unknown=False,
                is_doubtful=True,
                none_probability=0.45,
                has_jitter=share > 0.5,
                jitter_probability=share,
                jitter=_jitter_of(0.07),
            ),
        )
        assert verdict_of(ranked, None) is verdict
        assert where(verdict, ranked, ()) == {
            "stage": stage,
            "joint": None if stage == "release" else "slew",
        }
        if verdict is VerdictKind.AMBIGUOUS:
            members = ambiguity_of(ranked, None).members
            assert members == ("speed limit of the slew and release jitter", "release jitter")


def _jitter_of(size_s: float) -> SimpleNamespace:
    effect = Effect(effect="release_jitter", parameters={"extra_sd_s": size_s})
    return SimpleNamespace(effect=lambda: effect)


def test_jitter_is_part_of_both_rivals() -> None:
    load = Effect(effect="load_dependent_speed", joint="boom", parameters={"loss_ratio": 0.1})
    gain = Effect(effect="valve_gain", joint="boom", parameters={"positive_ratio": 0.1})
    best, rival = (
        SimpleNamespace(members=(place,), effects=(effect,))
        for place, effect in enumerate((load, gain))
    )
    for share, either, members in (
        (
            0.9,
            rival,
            (
                "load dependent speed of the boom and release jitter",
                "valve gain of the boom and release jitter",
            ),
        ),
        (0.1, rival, ("load dependent speed of the boom", "valve gain of the boom")),
        (
            0.9,
            None,
            ("load dependent speed of the boom and release jitter", "release jitter"),
        ),
        (0.1, None, ("load dependent speed of the boom", "none")),
    ):
        ranked = SimpleNamespace(
            best=best,
            rival=either,
            rival_log_odds=1.0,
            is_doubtful=False,
            none_probability=0.0,
            has_jitter=share > 0.5,
            jitter=_jitter_of(0.07),
        )
        assert ambiguity_of(cast("Ranked", ranked), None).members == members
        assert rival_of(cast("Ranked", ranked), None) is either


def test_an_unknown_effect_says_what_it_resembles_and_where_that_acts() -> None:
    best = SimpleNamespace(members=(), effects=())
    left = {"actuation.dipper": Left(9.0, 2.0), "actuation": Left(0.0, 2.5, 2.5)}
    for resembles, stage, joint in (
        (("unmodelled:neighbours", "dipper"), "actuation", "dipper"),
        (("unmodelled:opening", None), "release", None),
        (None, "actuation", None),
    ):
        ranked = SimpleNamespace(left=left, resembles=resembles, best=best)
        found = signature_of(cast("Ranked", ranked))
        assert (found["stage"], found["joint"]) == (stage, joint)
        shape = None if resembles is None else UNMODELLED_EFFECTS[resembles[0].partition(":")[2]]
        assert found["looks_like"] == (None if shape is None else shape.description)
