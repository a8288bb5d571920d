"""What the console remembers of an operator's choices: address of a target, its name, the time zone."""

import re
from collections.abc import Callable

from playwright.sync_api import Page, expect

from tests.e2e.operator_page import open_step, sign_in, without_view
from tests.e2e.stack import Stack


def _open_target(page: Page, range_m: str) -> None:
    """Open step Target once the target is there: its arrival opens the step after it."""
    words = re.compile(f"Target.*{re.escape(range_m)} m")
    expect(page.get_by_role("complementary").get_by_role("button", name=words)).to_be_visible()
    open_step(page, "Target")


def test_an_address_aims_and_a_named_target_comes_back(
    demo: Stack, open_page: Callable[..., Page]
) -> None:
    page = open_page(demo, 1280, 800)
    without_view(page)
    sign_in(page, demo, path="/operate?machine=m001&mode=3d&range=8.5&azimuth=-20")
    _open_target(page, "8.50")
    range_m, azimuth = page.get_by_label("Range, m"), page.get_by_label("Azimuth, °")
    expect(range_m).to_have_value("8.5")
    expect(azimuth).to_have_value("-20")
    expect(page.get_by_label("3D with cabin")).to_be_checked()

    page.get_by_text("Named and recent targets").click()
    page.get_by_label("Name of this target").fill("pile")
    page.get_by_role("button", name="Keep", exact=True).click()
    range_m.fill("7")
    range_m.press("Tab")
    page.get_by_text("2D arm plane").click()
    expect(page).to_have_url(re.compile(r"mode=2d&range=7&azimuth=-20"))
    page.get_by_role("button", name="pile 8.50 m, 20.0° right").click()
    expect(range_m).to_have_value("8.5")
    expect(page).to_have_url(re.compile(r"mode=2d&range=8\.5&azimuth=-20"))

    page.reload()
    _open_target(page, "8.50")
    expect(range_m).to_have_value("8.5")
    page.get_by_text("Named and recent targets").click()
    page.get_by_role("button", name="Forget pile").click()
    expect(page.get_by_role("button", name="Forget pile")).to_have_count(0)

    # The address of the target that was just set must not come back over that of the next page.
    range_m.fill("7.5")
    range_m.press("Tab")
    page.get_by_role("link", name="Throws").click()
    expect(page.get_by_role("region", name="History")).to_be_visible()
    page.get_by_role("link", name="Site").click()
    expect(page.get_by_role("heading", name="Site")).to_have_count(1)
    expect(page).to_have_url(re.compile("/site$"))


def test_times_turn_to_the_chosen_zone(demo: Stack, open_page: Callable[..., Page]) -> None:
    page = open_page(demo, 1280, 800)
    without_view(page)
    sign_in(page, demo, path="/fleet")
    page.get_by_role("button", name="Signed in as operator").click()
    page.get_by_label("Times in").select_option("Asia/Tokyo")
    expect(page.get_by_role("banner").get_by_text("GMT+9")).to_be_visible()
    page.reload()
    expect(page.get_by_role("banner").get_by_text("GMT+9")).to_be_visible()
