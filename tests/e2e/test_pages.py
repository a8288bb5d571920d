"""Every page without a finding of axe and without an error in the browser's console."""

from collections.abc import Callable

from playwright.sync_api import Page

from tests.e2e.axe_findings import findings_of_both_schemes
from tests.e2e.operator_page import sign_in, without_view
from tests.e2e.stack import Stack

PAGES = ("operate", "work", "throws", "site", "policies", "gap", "fleet", "alerts", "admin")


def test_no_page_has_a_finding(demo: Stack, open_page: Callable[..., Page]) -> None:
    page = open_page(demo, 1280, 800)
    page.emulate_media(color_scheme="light")
    without_view(page)
    page.goto("/login")
    page.get_by_role("button", name="Sign in").wait_for()
    findings = findings_of_both_schemes(page)
    sign_in(page, demo, "admin")
    for name in PAGES:
        page.get_by_role("navigation", name="Pages").locator(f'a[href="/{name}"]').click()
        page.locator("main h1").first.wait_for()
        page.wait_for_load_state("networkidle")
        findings += findings_of_both_schemes(page)
    page.goto("/machines/m001")
    page.locator("main h1").first.wait_for()
    page.wait_for_load_state("networkidle")
    findings += findings_of_both_schemes(page)
    assert findings == []


DIALOGS = (
    ("work", "New job"),
    ("fleet", "Add machine"),
    ("policies", "Start a rollout"),
    ("policies", "Change the gates of 2D"),
    ("policies", "Validate m545-2d-v6"),
)
"""A page, and a button on it that opens a dialog."""


def test_no_open_dialog_has_a_finding(demo: Stack, open_page: Callable[..., Page]) -> None:
    page = open_page(demo, 1280, 800)
    page.emulate_media(color_scheme="light")
    without_view(page)
    sign_in(page, demo, "admin")
    findings: list[str] = []
    for name, button in DIALOGS:
        page.get_by_role("navigation", name="Pages").locator(f'a[href="/{name}"]').click()
        page.get_by_role("button", name=button, exact=True).first.click()
        page.get_by_role("dialog").wait_for()
        findings += [f"{button}: {found}" for found in findings_of_both_schemes(page)]
        page.keyboard.press("Escape")
        page.get_by_role("dialog").wait_for(state="detached")
    assert findings == []
