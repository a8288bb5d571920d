"""Every page without a finding of axe and without an error in the browser's console."""

from collections.abc import Callable

from playwright.sync_api import Page

from tests.e2e.operator_page import sign_in, without_view
from tests.e2e.stack import ROOT, Stack

AXE = ROOT / "web" / "node_modules" / "axe-core" / "axe.min.js"
PAGES = ("operate", "throws", "site", "policies", "gap", "fleet", "admin")


def _findings(page: Page, rules: str = "") -> list[str]:
    """Findings of axe, one line each. Styles that still fade are let to end first."""
    page.evaluate("Promise.all(document.getAnimations().map((a) => a.finished.catch(() => 0)))")
    found = page.evaluate(f"axe.run(document, {{ iframes: false, {rules} }})")
    return [
        f"{page.url} {item['id']}: {node['html'][:200]}"
        for item in found["violations"]
        for node in item["nodes"]
    ]


def _findings_of_both_schemes(page: Page) -> list[str]:
    page.evaluate(AXE.read_text(encoding="utf-8"))
    found = _findings(page)
    page.emulate_media(color_scheme="dark")
    page.locator('html[data-mantine-color-scheme="dark"]').wait_for()
    found += _findings(page, 'runOnly: ["color-contrast"]')
    page.emulate_media(color_scheme="light")
    page.locator('html[data-mantine-color-scheme="light"]').wait_for()
    return found


def test_no_page_has_a_finding(demo: Stack, open_page: Callable[..., Page]) -> None:
    page = open_page(demo, 1280, 800)
    page.emulate_media(color_scheme="light")
    without_view(page)
    page.goto("/login")
    page.get_by_role("button", name="Sign in").wait_for()
    findings = _findings_of_both_schemes(page)
    sign_in(page, demo, "admin")
    for name in PAGES:
        page.get_by_role("navigation", name="Pages").locator(f'a[href="/{name}"]').click()
        page.locator("main h1").first.wait_for()
        page.wait_for_load_state("networkidle")
        findings += _findings_of_both_schemes(page)
    assert findings == []
