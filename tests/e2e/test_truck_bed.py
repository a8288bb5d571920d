"""Off the ground: click on the truck bed and see that the load will land there; edit the site's objects."""

import re
from collections.abc import Callable

from playwright.sync_api import Page, expect

from tests.e2e.browser_console import Console
from tests.e2e.operator_page import (
    click_until,
    open_step,
    sign_in,
    take_control,
)
from tests.e2e.stack import Stack, client

BED = "truck bed"
HEIGHT_M = 1.2
ON_THE_BED = (0.53, 0.345)
"""Where the middle of the demo's truck bed is in the 3D view of a page of 1024 by 768, as a share of it."""


def _mode_that_reaches(demo: Stack) -> str:
    """A mode whose policy was trained for the height of the bed; 3D before 2D."""
    with client(demo, "operator") as api:
        modes = api.get("/machines/m001").json()["reach"]["modes"]
    able = [m["mode"] for m in modes if m["height_max_m"] >= HEIGHT_M]
    assert able, f"no active policy was trained for targets at {HEIGHT_M:+.2f} m"
    return sorted(able)[-1]


def test_a_click_on_the_truck_bed_aims_at_its_height(
    demo: Stack, open_page: Callable[..., Page]
) -> None:
    mode = _mode_that_reaches(demo)
    page = open_page(demo)
    sign_in(page, demo)
    take_control(page)
    page.get_by_text("3D with cabin" if mode == "3d" else "2D arm plane").click()
    panel = page.get_by_role("complementary")
    click_until(page, ON_THE_BED, panel.get_by_text("+1.20 m high"))
    open_step(page, "Target")
    expect(page.get_by_label("Height, m")).to_have_value("1.2")

    open_step(page, "Preview")
    numbers = page.get_by_test_id("preview-numbers")
    expect(numbers).to_contain_text("of 200")
    expect(numbers).to_contain_text(f"{BED}, +1.20 m")
    page.get_by_role("button", name="Give back control").click()


def test_the_site_is_edited_saved_and_taken_back(
    demo: Stack, open_page: Callable[..., Page], console: Console
) -> None:
    console.allowed.append("422")
    page = open_page(demo)
    page.route("**/viewer/**", lambda route: route.fulfill(body="", content_type="text/html"))
    sign_in(page, demo, path="/site")
    form = page.get_by_role("form", name="Objects of the site")
    objects = form.get_by_role("listitem")
    before = objects.count() if objects.first.wait_for() is None else 0
    page.get_by_role("button", name="Add box").click()
    page.get_by_label("Name").fill("wall")
    page.get_by_label("Range, m").fill("2")
    page.get_by_role("button", name="Save").click()
    # Too near: refused in words, and nothing of what was typed is lost.
    expect(page.get_by_role("alert")).to_contain_text("the machine turns there")
    page.get_by_label("Range, m").fill("16")
    page.get_by_label("Range, m").press("Tab")
    page.get_by_role("button", name="Save").click()
    expect(objects).to_have_count(before + 1)
    expect(form).to_contain_text(re.compile("by operator"))
    page.get_by_role("button", name="Undo the last change").click()
    expect(objects).to_have_count(before)
