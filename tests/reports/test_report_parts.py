"""What all reports share: numbers, SVG elements, and templates that escape what comes from data."""

import math
from pathlib import Path

import pytest
from jinja2 import UndefinedError

from reports.html import render_page
from reports.number_format import crossrange, downrange, fixed, metres, percent, probability
from reports.svg import Axes, Margins, drawing, element, round_ticks, tick_label


def test_numbers_have_fixed_digits_a_unit_and_a_word_for_their_sign() -> None:
    assert [fixed(v) for v in (1.0, -0.126, -0.001, None, math.nan)] == [
        "1.00", "−0.13", "0.00", "–", "–",
    ]  # fmt: skip
    assert (metres(-0.5), metres(None), metres(0.1234, 3)) == ("−0.50 m", "–", "0.123 m")
    assert (percent(0.815), percent(1.0, 1), percent(math.inf)) == ("82 %", "100.0 %", "–")
    assert (probability(0.999), probability(1e-9), probability(0.5)) == ("> 99 %", "< 1 %", "50 %")
    assert (downrange(0.124), downrange(0.001)) == ("+0.12 m long", "0.00 m on range")
    assert (crossrange(-0.05), crossrange(math.nan)) == ("−0.05 m right", "–")


def test_drawings_escape_words_and_round_coordinates() -> None:
    line = element("line", class_="grid", x1=1.0, x2=2.345, text_anchor='"end"')
    assert line == '<line class="grid" x1="1" x2="2.3" text-anchor="&#34;end&#34;"/>'
    drawn = drawing(10.0, 20.0, "a < b", [line])
    assert "<title>a &lt; b</title>" in drawn and 'viewBox="0 0 10 20"' in drawn


def test_axes_have_round_ticks_and_y_points_up() -> None:
    axes = Axes((0.0, 2.0), (-1.0, 1.0), 100.0, 50.0, Margins(10.0, 10.0, 5.0, 5.0))
    assert axes.at(0.0, -1.0) == (10.0, 45.0)
    assert axes.at(2.0, 1.0) == (90.0, 5.0)
    assert round_ticks(-0.11, 0.32, 4) == pytest.approx([-0.1, 0.0, 0.1, 0.2, 0.3])
    assert tick_label(-0.5) == "−0.5"


def test_a_template_escapes_data_and_refuses_a_name_that_is_missing(tmp_path: Path) -> None:
    (tmp_path / "page.html.j2").write_text(
        '{% extends "base.html.j2" %}{% block main %}<p>{{ words }}</p>{% endblock %}'
    )
    page = render_page(tmp_path, "page.html.j2", words="<script>")
    assert page.startswith("<!doctype html>")
    assert "<p>&lt;script&gt;</p>" in page
    assert "prefers-color-scheme: dark" in page and "@media print" in page
    assert "default-src 'none'" in page
    with pytest.raises(UndefinedError, match="words"):
        render_page(tmp_path, "page.html.j2")
