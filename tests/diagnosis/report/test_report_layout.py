"""The report in a real browser: no word and no number is broken, on a desk and on a phone."""

import pytest
from playwright.sync_api import sync_playwright

from diagnosis.report.diagnosis_page import diagnosis_html
from diagnosis.verdict import Cause, Diagnosis, FittedEffect, FittedParameter, VerdictKind
from tests.chromium import CHROMIUM, FLAGS

pytestmark = [pytest.mark.e2e, pytest.mark.timeout(180)]

EVIDENCE = {
    "throws_used": [f"challenge-5631-healthy-{number:04d}" for number in range(12)],
    "leftover_sd": {"the gripper's turning about its x axis": 0.2},
    "log_evidence": {
        "joint sensor latency of the dipper and valve dead band of the telescope drifting": 65573.1
    },
}
BROKEN = """(selector) => [...document.querySelectorAll(selector)].filter((element) => {
  const range = document.createRange();
  range.selectNodeContents(element);
  const lines = new Set([...range.getClientRects()].map((box) => Math.round(box.top)));
  return lines.size > element.textContent.trim().split(/\\s+/).length;
}).map((element) => element.textContent)"""
"""Texts of elements that take more lines than they have words."""
LINES = """(selector) => [...document.querySelectorAll(selector)].map((element) => {
  const range = document.createRange();
  range.selectNodeContents(element);
  return new Set([...range.getClientRects()].map((box) => Math.round(box.top))).size;
})"""
"""Number of lines that each element takes."""


CAUSE = Cause(
    effects=(
        FittedEffect(
            effect="speed_limit",
            joint="telescope",
            parameters={
                "spin_rad_per_s": FittedParameter(value=-3.53, ci90=(-6.3, -0.76), unit="rad/s")
            },
        ),
    ),
    probability=0.08,
)


def test_no_word_and_no_number_is_broken_on_a_desk_and_on_a_phone() -> None:
    report = diagnosis_html(Diagnosis(verdict=VerdictKind.NONE, evidence=EVIDENCE, causes=(CAUSE,)))
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        for width_px in (1100, 420):
            page = browser.new_page(viewport={"width": width_px, "height": 900})
            page.set_content(report)
            assert page.locator("dl.tree").count() > 0
            assert page.evaluate(BROKEN, "th, dl.tree dd, td.cause") == []
            whole = "strong, td.size .dim"
            assert page.evaluate(LINES, whole) == [1, 1]
            assert page.evaluate("document.documentElement.scrollWidth") <= width_px
        browser.close()
