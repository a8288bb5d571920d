"""An ended session leads to the login and back to where the person was."""

import re
from collections.abc import Callable

from playwright.sync_api import Page, expect

from tests.e2e.browser_console import Console
from tests.e2e.operator_page import sign_in, without_view
from tests.e2e.stack import Stack


def test_an_ended_session_leads_to_the_login_and_back(
    demo: Stack, open_page: Callable[..., Page], console: Console
) -> None:
    # A request is refused with 401, a socket with 403, if the page opens it after the session ended.
    console.allowed += ["401", "403"]
    page = open_page(demo)
    without_view(page)
    sign_in(page, demo, path="/throws?mode=2d&min=20")
    expect(page.get_by_text("No throw matches these filters")).to_be_visible()
    page.context.clear_cookies()
    page.reload()
    page.get_by_label("Name").fill("operator")
    page.locator("input[type=password]").fill(demo.passwords["operator"])
    page.get_by_role("button", name="Sign in").click()
    expect(page).to_have_url(f"{demo.url}/throws?mode=2d&min=20")
    expect(page.get_by_text("No throw matches these filters")).to_be_visible()


def test_a_link_cannot_lead_the_login_astray(demo: Stack, open_page: Callable[..., Page]) -> None:
    page = open_page(demo)
    without_view(page)
    sign_in(page, demo, path="/login?back=//evil.example/")
    # The page then adds machine and mode to its address.
    expect(page).to_have_url(re.compile(rf"{re.escape(demo.url)}/operate(\?|$)"))
