"""Click on the ground, see what the throw will do, hold, see where it landed, mark and correct it."""

import re
from collections.abc import Callable

from playwright.sync_api import Page, expect

from tests.e2e.operator_page import (
    click_until,
    gate,
    load_if_empty,
    metres_of,
    open_step,
    sign_in,
    take_control,
    throw_until_landed,
)
from tests.e2e.stack import Stack

GROUND = (0.5, 0.85)
"""Open ground in the 3D view of a page of 1024 by 768, as a share of it."""
POSITIVE = re.compile(r"^0?\.\d+$|^[1-9]\d*(\.\d+)?$")


def _aim(page: Page) -> None:
    """A range that 2D reaches, nudged, at the bearing of the click; then clear of the site's objects."""
    open_step(page, "Target")
    range_m, azimuth = page.get_by_label("Range, m"), page.get_by_label("Azimuth, °")
    expect(range_m).not_to_have_value("")
    clicked = azimuth.input_value()
    range_m.fill("9")
    range_m.press("Tab")
    # Arrow keys belong to a field while it has the focus.
    page.evaluate("document.activeElement.blur()")
    page.keyboard.press("ArrowUp")
    expect(range_m).to_have_value("9.05")
    assert azimuth.input_value() == clicked
    # Clear of what stands on the demo's site: the pit ends at -13 degrees, the truck bed begins at 24.
    azimuth.fill("5")
    azimuth.press("Tab")


def test_click_preview_hold_impact_history_replay(
    demo: Stack, open_page: Callable[..., Page]
) -> None:
    page = open_page(demo)
    sign_in(page, demo)
    take_control(page)
    panel = page.get_by_role("complementary")
    preview = panel.get_by_role("button", name="2 Preview", expanded=True)
    click_until(page, GROUND, preview)
    _aim(page)

    # What the operator sees before anything moves.
    load_if_empty(page)
    open_step(page, "Preview")
    numbers = page.get_by_test_id("preview-numbers")
    expect(numbers).to_contain_text("of 200")
    expect(numbers).to_contain_text("m/s")
    expect(page.get_by_role("img", name="Landing around the target")).to_be_visible()
    expect(page.get_by_role("complementary")).to_contain_text("checks passed")

    throw_until_landed(page, "pointer")
    along = metres_of(page.get_by_test_id("measured-downrange").inner_text())
    across = metres_of(page.get_by_test_id("measured-crossrange").inner_text())
    assert abs(along) < 1.0
    assert abs(across) < 1.0
    _mark_impact(page)

    # The history has it, with the same numbers.
    page.get_by_role("button", name="Give back control").click()
    page.get_by_role("navigation", name="Pages").get_by_role("link", name="Throws").click()
    row = page.locator("tbody tr[data-throw]").first
    expect(row).to_contain_text("Landed")
    expect(row).to_contain_text("9.05")
    find = page.get_by_label("Find on this page")
    find.fill("9.05 m001 nobody")
    expect(page.get_by_text("No throw of this page has these words.")).to_be_visible()
    find.fill("9.05 m001")
    row.get_by_role("link").click()

    _replay(page)
    _print(page)
    _correct_impact(page)
    _machine_page(page)


def _mark_impact(page: Page) -> None:
    """Click where the load came down: in the plot, then in the 3D view; the target stays."""
    page.get_by_role("button", name="Mark impact").click()
    form = page.get_by_role("form", name="Mark impact")
    along, across = form.get_by_label("Long +"), form.get_by_label("Left +")
    expect(along).not_to_have_value("")
    plot = form.get_by_role("img", name="Landing around the target")
    box = plot.bounding_box()
    assert box is not None
    # Right of the middle of the plot is long, its upper half is left of the line.
    plot.click(position={"x": 0.75 * box["width"], "y": 0.25 * box["height"]})
    expect(along).to_have_value(POSITIVE)
    expect(across).to_have_value(POSITIVE)
    # Empty, it cannot be saved until the ground was clicked.
    along.fill("")
    save = form.get_by_role("button", name="Save as a new record", disabled=False)
    click_until(page, GROUND, save)
    along_m, across_m = float(along.input_value()), float(across.input_value())
    save.click()
    expect(form).to_have_count(0)
    shown = page.get_by_test_id("measured-downrange")
    expect(shown).to_contain_text(f"{abs(along_m):.2f} m")
    expect(page.get_by_test_id("measured-crossrange")).to_contain_text(f"{abs(across_m):.2f} m")
    open_step(page, "Target")
    expect(page.get_by_label("Range, m")).to_have_value("9.05")
    expect(page.get_by_label("Azimuth, °")).to_have_value("5")


def _machine_page(page: Page) -> None:
    """The machine's page shows the throw in its charts and lists it."""
    page.goto("/machines/m001")
    for title in ("Miss along over time", "Miss across over time"):
        chart = page.get_by_role("img", name=title)
        expect(chart).to_be_visible()
        expect(chart.locator("circle")).not_to_have_count(0)


def _replay(page: Page) -> None:
    page.get_by_test_id("play").wait_for()
    expect(page.locator(".uplot")).to_have_count(10)
    slider = page.get_by_role("slider", name="Time of the replay")
    page.get_by_test_id("play").click()
    expect(slider).not_to_have_value("0")
    page.get_by_role("button", name="Pause the replay").click()
    held = slider.input_value()
    slider.press("ArrowRight")
    assert float(slider.input_value()) > float(held)
    log = page.get_by_role("link", name="Throw log, MCAP")
    answer = page.request.get(log.get_attribute("href") or "")
    assert answer.ok
    assert answer.body().startswith(b"\x89MCAP")


def _print(page: Page) -> None:
    """On paper stands the throw alone."""
    page.emulate_media(media="print")
    expect(page.get_by_role("heading", name="Predicted and measured")).to_be_visible()
    expect(page.get_by_test_id("stop")).to_be_hidden()
    expect(page.get_by_test_id("play")).to_be_hidden()
    page.emulate_media(media="screen")
    expect(page.get_by_test_id("stop")).to_be_visible()


def _correct_impact(page: Page) -> None:
    records = page.get_by_role("complementary").get_by_role("listitem")
    expect(records).to_have_count(2)
    page.get_by_role("button", name="Correct impact").click()
    page.get_by_label("Long +").fill("0.25")
    page.get_by_label("Left +").fill("-0.1")
    page.get_by_label("Note").fill("tape measure")
    page.get_by_role("button", name="Save as a new record").click()
    expect(records).to_have_count(3)
    expect(page.get_by_test_id("measured-downrange")).to_have_text("+0.25 m long")
    expect(page.get_by_test_id("measured-crossrange")).to_have_text("\u22120.10 m right")
    expect(records.filter(has_text="tape measure")).to_contain_text("counts")


def _load_without_target(page: Page) -> None:
    """An empty gripper, as an earlier throw leaves it, is what the console asks about first."""
    empty, aimless = gate(page, "no_payload"), gate(page, "no_target")
    empty.or_(aimless).first.wait_for()
    if empty.count():
        empty.get_by_role("button", name="Load").click()
    aimless.wait_for()


def test_a_target_out_of_reach_is_refused_with_its_numbers(
    demo: Stack, open_page: Callable[..., Page]
) -> None:
    page = open_page(demo)
    page.route("**/viewer/**", lambda route: route.fulfill(body="", content_type="text/html"))
    sign_in(page, demo)
    take_control(page)
    _load_without_target(page)
    open_step(page, "Target")
    # Digit by digit, as a person types: "1" is a target already, and the fields stay open.
    page.get_by_label("Range, m").press_sequentially("14")
    page.get_by_label("Azimuth, °").press_sequentially("10")
    expect(page.get_by_label("Range, m")).to_have_value("14")
    panel = page.get_by_role("complementary")
    expect(panel).to_contain_text("14.00 m")
    expect(panel).to_contain_text("reaches")
    expect(gate(page, "refused").or_(gate(page, "plan_error"))).to_be_visible()
    page.get_by_role("button", name="Give back control").click()
