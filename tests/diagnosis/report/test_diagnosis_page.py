"""The report: one page, every verdict, nothing from data runs or is fetched."""

import json
import math
import re
from html import unescape
from html.parser import HTMLParser
from typing import Any

from diagnosis.report.curves import figure
from diagnosis.report.diagnosis_page import diagnosis_html
from diagnosis.report.vocabulary import channel_words, vocabulary_tables
from diagnosis.verdict import (
    Ambiguity,
    Cause,
    Diagnosis,
    FittedEffect,
    FittedParameter,
    Gap,
    Miss,
    Shrink,
    Stage,
    StageGap,
    VerdictKind,
)

HOSTILE = '"><script>alert(1)</script><img src=x onerror=alert(2)>'
VOID = {"meta", "br", "img", "line"}


def dead_time(value: float = 0.062) -> Cause:
    parameter = FittedParameter(value=value, ci90=(0.055, 0.07), unit="s")
    effect = FittedEffect(
        effect="valve_dead_time", joint="dipper", parameters={"extra_dead_time_s": parameter}
    )
    return Cause(effects=(effect,), probability=0.93, name="valve dead time of the dipper")


def diagnosis(verdict: VerdictKind = VerdictKind.EXPLAINED, **changes: Any) -> Diagnosis:
    """Twelve throws with a late dipper."""
    values: dict[str, Any] = {
        "verdict": verdict,
        "sentence": "The dipper is late.",
        "gap": Gap(impact_rms_m=0.41, downrange_bias_m=-0.39, crossrange_bias_m=0.02),
        "stages": (
            StageGap(
                stage=Stage.ACTUATION,
                joint="dipper",
                miss_m=Miss(downrange=-0.37, crossrange=0.01),
                share_ratio=0.8,
                ci90_m=(-0.42, -0.31),
            ),
            StageGap(
                stage=Stage.FLIGHT,
                miss_m=Miss(downrange=0.05, crossrange=-0.03),
                share_ratio=0.2,
                ci90_m=(0.01, 0.09),
            ),
        ),
        "causes": (
            dead_time(),
            Cause(effects=(), probability=0.05, name="unknown"),
            Cause(effects=(), probability=0.02, name="none"),
        ),
        "shrink": Shrink(
            predicted_ratio=0.85,
            before_m=0.41,
            after_m=0.09,
            ratio=0.81,
            ci90=(0.7, 0.88),
            held_out_throws=4,
            removable_ratio=0.95,
        ),
        "evidence": {
            "throws_used": ["t1", "t2"],
            "where": {"stage": "actuation", "joint": "dipper"},
            "ruled_out": [{"effect": "wind", "joint": None, "log_odds": -4.2}],
            "refused": [{"path": "/logs/bad.mcap", "reason": "10 Hz, at least 25 Hz are needed"}],
        },
        "plots": {
            "t1 dipper": {
                "x": [0.0, 0.01, 0.02],
                "x_unit": "s",
                "unit": "rad/s",
                "measured": [0.0, 0.1, 0.3],
                "twin_before": [0.0, 0.2, 0.4],
                "twin_after": [0.0, 0.1, 0.3],
            }
        },
    }
    return Diagnosis.model_validate({**values, **changes})


class Page(HTMLParser):
    """Checks that tags close in order, and keeps their names and attributes."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.opened: list[str] = []
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str | None]] = []
        self.feed(text)
        assert self.opened == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += attrs
        if tag not in VOID:
            self.opened.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += attrs

    def handle_endtag(self, tag: str) -> None:
        assert self.opened.pop() == tag


def compact(page: str) -> str:
    """The page without white space between tags."""
    return re.sub(r">\s+<", "><", page)


def text_of(page: str) -> str:
    """What a person reads."""
    return re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", page.split("<main>")[1]))


def test_the_page_says_where_which_and_how_far() -> None:
    page = compact(diagnosis_html(diagnosis(), "m001"))
    text = text_of(page)
    assert "The dipper is late." in text
    assert "−0.37 m short" in text
    assert "short, 90 % interval −0.42 m to −0.31 m" in page
    assert "93 % valve dead time, dipper" in text
    assert "62.0 ms (55.0 to 70.0 ms)" in text
    assert "Removes 81 % of the removable gap on 4 held-out throws" in text
    assert "Predicted before it was added: 85 %" in text
    assert "wind natural log odds −4.2 against no effect" in text
    assert "10 Hz, at least 25 Hz are needed" in text
    assert page.count("<polyline") >= 5
    assert 'data-here="true"><h3>Actuation' in page
    assert page.count('<li data-here="true"') == 1


def test_the_page_needs_no_network_and_no_script() -> None:
    page = diagnosis_html(diagnosis())
    found = Page(page)
    assert not {"script", "link", "img", "iframe", "object"} & set(found.tags)
    assert not [name for name, _ in found.attributes if name in {"src", "href"}]
    assert "url(" not in page and "@import" not in page
    assert "http://" not in page and "https://" not in page


def test_the_page_says_what_was_compared_with() -> None:
    cases: list[tuple[dict[str, Any], str | None]] = [
        ({"reference": {"throws_count": 24}}, "24 healthy throws of this machine"),
        ({"reference": None}, "healthy machines of the type"),
        ({}, None),
    ]
    for evidence, said in cases:
        page = diagnosis_html(diagnosis(evidence=evidence))
        assert ("Compared with" in page) == (said is not None)
        assert said is None or f"<dt>Compared with</dt><dd>{said}</dd>" in page


def test_hostile_text_stays_text() -> None:
    cause = FittedEffect(
        effect=HOSTILE,
        joint=HOSTILE,
        parameters={HOSTILE: FittedParameter(value=1.0, ci90=(0.0, 2.0), unit=HOSTILE)},
    )
    evidence = {
        HOSTILE: [{HOSTILE: HOSTILE}],
        "refused": [{"path": HOSTILE, "reason": HOSTILE}],
        "ruled_out": [{"effect": HOSTILE, "joint": HOSTILE, "why": HOSTILE}],
        "parts": {HOSTILE: {"sentence": HOSTILE}},
        "unknown": {"stage": HOSTILE},
        "residual_unit": HOSTILE,
    }
    ambiguity = Ambiguity(
        members=(HOSTILE, HOSTILE), separating_motion={"words": HOSTILE, HOSTILE: 1}, why=HOSTILE
    )
    plots = {HOSTILE: {"x": [0, 1], HOSTILE: [0, 1], "unit": HOSTILE, "x_unit": HOSTILE}}
    cases: list[dict[str, Any]] = [
        {"sentence": HOSTILE},
        {"evidence": evidence},
        {"ambiguity": ambiguity},
        {"plots": plots},
        {"causes": (Cause(effects=(cause,), probability=1.0, name=HOSTILE),)},
    ]
    pages = [diagnosis_html(diagnosis(**changes)) for changes in cases]
    for page in [*pages, diagnosis_html(diagnosis(), HOSTILE)]:
        found = Page(page)
        assert not {"script", "img"} & set(found.tags)
        assert not [name for name, _ in found.attributes if name.startswith("on")]
        assert "alert(1)" in page
        assert "&amp;lt;" not in page, "escaped twice"


def test_every_verdict_has_a_page_even_with_nothing_else() -> None:
    for verdict in VerdictKind:
        page = diagnosis_html(Diagnosis(verdict=verdict))
        Page(page)
        assert "<h2>Which" not in page


def test_channels_are_named_in_words() -> None:
    cases = {
        "actuation.boom": "the speed of the boom",
        "swing": "the swing of the gripper",
        "flight": "the flight of the load",
        "some.other_thing": "some other thing",
    }
    assert {channel: channel_words(channel) for channel in cases} == cases
    signature = {"stage": "flight", "channel": "flight", "leftover_sd": 7.0, "nearest": "wind"}
    evidence = {"unknown": signature, "leftover_sd": {"flight": 7.0}}
    text = unescape(text_of(diagnosis_html(diagnosis(VerdictKind.UNKNOWN, evidence=evidence))))
    assert text.count(cases["flight"]) == 2
    assert "flight.ball" not in text


def test_an_ambiguous_result_names_the_next_experiment() -> None:
    ambiguity = Ambiguity(
        members=("valve lag", "valve dead time"),
        separating_motion={"kind": "valve_steps", "hold_s": 1.5, "words": "steps of several sizes"},
        why="they differ by 0.1",
    )
    text = text_of(diagnosis_html(diagnosis(VerdictKind.AMBIGUOUS, ambiguity=ambiguity)))
    assert "valve lag or valve dead time" in text
    assert "steps of several sizes" in text
    assert "hold s 1.5" in text


def test_a_shrink_of_channels_is_no_shrink_of_the_miss() -> None:
    text = text_of(diagnosis_html(diagnosis(evidence={"shrink_measure": "channels"})))
    assert "81 % of the gap in the channels that it moves" in text
    assert "removable" not in text


def test_without_a_gap_nothing_is_pointed_at() -> None:
    page = diagnosis_html(diagnosis(VerdictKind.NONE))
    assert '<li data-here="true"' not in page


def test_bad_data_opens_what_was_refused() -> None:
    page = diagnosis_html(
        diagnosis(VerdictKind.BAD_DATA, stages=(), causes=(), shrink=None, plots={})
    )
    assert "<details open><summary>1 logs were not used" in page


def test_evidence_without_entries_says_so() -> None:
    page = diagnosis_html(diagnosis(evidence={"reference": {"refused": [], "notes": {}}}))
    assert page.count("<dd>–</dd>") == 2


def test_one_stage_alone_has_no_metres() -> None:
    stage = StageGap(
        stage=Stage.SWING,
        miss_m=Miss(downrange=0.0, crossrange=0.0),
        share_ratio=1.0,
        ci90_m=(0.0, 0.0),
    )
    page = diagnosis_html(
        diagnosis(stages=(stage,), gap=Gap(), evidence={"residual_unit": "rad"}), "Swing"
    )
    assert "One stage was recorded on its own" in page
    assert 'data-here="true"><h3>Swing' in page
    assert "held-out pieces" in page
    assert "0.41 rad" in page


def pictures(plot: dict[str, Any]) -> str:
    """Every drawing of a plot."""
    drawn = figure("plot", plot)
    assert drawn is not None
    return "".join(str(panel.picture) for panel in drawn.panels)


def test_figures_leave_out_what_does_not_fit() -> None:
    assert figure("empty", {"x": [], "measured": []}) is None
    assert figure("no mapping", 3) is None
    drawn = pictures({"x": [0, 1, 2, 3, 4], "measured": [0, 1, math.nan, 2, 3], "other": [1]})
    assert drawn.count('<polyline class="measured"') == 2  # two pieces
    assert "other" not in drawn
    assert "nan" not in drawn
    # The difference of measurement and twin is drawn with the line of zero, even where they never meet.
    apart = pictures({"x": [0, 1, 2], "measured": [5, 6, 7], "twin": [1, 1, 2]})
    assert apart.count('class="axis"') == 1
    nothing = {"x": [0, 1], "measured": [math.nan, None]}
    assert pictures(nothing) == "None"
    assert "No finite values" in diagnosis_html(diagnosis(plots={"nothing": nothing}))
    assert "<polyline" in pictures({"x": [0, 1], "measured": [2.0, 2.0]})


def test_a_panel_about_zero_has_numbers_on_both_sides() -> None:
    drawn = pictures({"x": [0, 1, 2], "measured": [0.0, 0.16, 0.0], "ideal": [0.16, 0, 0.16]})
    assert ">−0.1</text>" in drawn
    assert ">0.1</text>" in drawn


def test_long_evidence_is_cut_and_folded() -> None:
    page = diagnosis_html(diagnosis(evidence={"many": [{"value": v} for v in range(100)]}))
    assert "… and 40 more" in page
    assert "<summary>show</summary>" in page


def test_the_vocabulary_names_every_verdict_and_every_stage_and_is_json() -> None:
    tables = json.loads(json.dumps(vocabulary_tables()))
    assert set(tables["verdicts"]) == set(VerdictKind)
    assert [row["stage"] for row in tables["stages"]] == list(Stage)
