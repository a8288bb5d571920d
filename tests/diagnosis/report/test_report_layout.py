"""The report in a real browser: no word and no number is broken, on a desk and on a phone."""

import pytest
from playwright.sync_api import sync_playwright

from diagnosis.report.report_html import report_html
from diagnosis.verdict import Diagnosis, VerdictKind
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


@pytest.mark.parametrize("width_px", [1100, 420])
def test_no_word_and_no_number_of_the_evidence_is_broken(width_px: int) -> None:
    report = report_html(Diagnosis(verdict=VerdictKind.NONE, evidence=EVIDENCE))
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        page = browser.new_page(viewport={"width": width_px, "height": 900})
        page.set_content(report)
        assert page.locator("th").count() == len(EVIDENCE)
        assert page.evaluate(BROKEN, "th, dl.tree dd") == []
        assert page.evaluate("document.documentElement.scrollWidth") <= width_px
        browser.close()
