"""What axe finds on a page, in light and in dark."""

from playwright.sync_api import Page

from tests.e2e.stack import ROOT

AXE = ROOT / "web" / "node_modules" / "axe-core" / "axe.min.js"


def _findings(page: Page, rules: str = "") -> list[str]:
    """Findings of axe, one line each. Styles that still fade are let to end first."""
    page.evaluate("Promise.all(document.getAnimations().map((a) => a.finished.catch(() => 0)))")
    found = page.evaluate(f"axe.run(document, {{ iframes: false, {rules} }})")
    return [
        f"{page.url} {item['id']}: {node['html'][:200]}"
        for item in found["violations"]
        for node in item["nodes"]
    ]


def findings_of_both_schemes(page: Page) -> list[str]:
    page.evaluate(AXE.read_text(encoding="utf-8"))
    found = _findings(page)
    page.emulate_media(color_scheme="dark")
    page.locator('html[data-mantine-color-scheme="dark"]').wait_for()
    found += _findings(page, 'runOnly: ["color-contrast"]')
    page.emulate_media(color_scheme="light")
    page.locator('html[data-mantine-color-scheme="light"]').wait_for()
    return found
