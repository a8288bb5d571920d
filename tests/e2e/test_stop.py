"""STOP: on every page, one press or Shift+S, latched until somebody with the right to clear it does."""

from collections.abc import Callable, Iterator

import pytest
from playwright.sync_api import Page, expect

from tests.e2e.operator_page import gate, lamp, sign_in, take_control, without_view
from tests.e2e.stack import Stack, client
from tests.waiting import until

PAGES = ("/operate", "/throws", "/policies", "/fleet")


@pytest.fixture(autouse=True)
def cleared(demo: Stack) -> Iterator[None]:
    """Every test begins and ends with a machine that is not stopped."""
    yield
    clear(demo)


def clear(demo: Stack) -> None:
    with client(demo, "admin") as admin:
        admin.post("/machines/m001/lease").raise_for_status()

        def is_cleared() -> bool:
            # Each press is a latch of its own: a clear that names an earlier one is refused.
            latch_id = admin.get("/machines/m001").json()["state"]["latch_id"]
            body = {"latch_id": latch_id or "none", "is_sighted": True, "reason": "after a test"}
            admin.post("/machines/m001/stop/clear", json=body)
            return admin.get("/machines/m001").json()["lamp"] == "disarmed"

        until(is_cleared, "the stop to be cleared")
        admin.delete("/machines/m001/lease")


def test_one_press_on_every_page(demo: Stack, open_page: Callable[..., Page]) -> None:
    page = open_page(demo)
    without_view(page)
    sign_in(page, demo, path=PAGES[0])
    for path in PAGES:
        page.goto(path)
        lamp(page, "disarmed").wait_for()
        button = page.get_by_test_id("stop")
        box, bar = button.bounding_box(), page.locator("header").first.bounding_box()
        assert box is not None and bar is not None
        assert box["height"] >= 48.0
        assert abs((box["x"] + box["width"]) - (bar["x"] + bar["width"])) < 1.0  # the far right
        expect(button).to_contain_text("STOP m001")
        expect(button).to_contain_text("Shift+S")
        button.click()
        lamp(page, "stopped").wait_for()
        expect(page.get_by_role("dialog")).to_have_count(0)
        clear(demo)
    # A dialog and its backdrop do not cover it.
    lamp(page, "disarmed").wait_for()
    page.keyboard.press("?")
    expect(page.get_by_role("dialog")).to_be_visible()
    page.get_by_test_id("stop").click()
    lamp(page, "stopped").wait_for()


def test_key_stops_and_only_the_right_person_clears(
    demo: Stack, open_page: Callable[..., Page]
) -> None:
    page = open_page(demo)
    without_view(page)
    sign_in(page, demo)
    take_control(page)
    page.keyboard.press("Shift+S")
    lamp(page, "stopped").wait_for()
    expect(gate(page, "stopped")).to_contain_text("supervisor clears it")
    expect(gate(page, "stopped").get_by_role("button")).to_have_count(0)
    page.get_by_role("button", name="Give back control").click()

    admin = open_page(demo)
    without_view(admin)
    sign_in(admin, demo, "admin")
    take_control(admin)
    admin.get_by_role("button", name="Clear STOP").click()
    dialog = admin.get_by_role("dialog")
    expect(dialog).to_contain_text("STOP by operator")
    clear = dialog.get_by_role("button", name="Clear", exact=True)
    dialog.get_by_label("Why it may move again").fill("looked, nobody near")
    expect(clear).to_be_disabled()
    dialog.get_by_label("I see m001 and nobody is in reach of it").check()
    # Another stop while the dialog is open: it has to be read first.
    page.keyboard.press("Shift+S")
    dialog.get_by_role("button", name="I have read the new reason").click()
    dialog.get_by_label("I see m001 and nobody is in reach of it").check()
    clear.click()
    lamp(admin, "disarmed").wait_for()
    lamp(page, "disarmed").wait_for()  # the other browser sees it too
    admin.get_by_role("button", name="Give back control").click()


def test_typing_a_capital_s_into_a_field_does_not_swallow_stop(
    demo: Stack, open_page: Callable[..., Page]
) -> None:
    page = open_page(demo)
    without_view(page)
    sign_in(page, demo, path="/throws")
    page.get_by_label("Person").focus()
    page.keyboard.press("Shift+S")
    lamp(page, "stopped").wait_for()


def test_stop_while_the_3d_view_has_the_keyboard(
    demo: Stack, open_page: Callable[..., Page]
) -> None:
    page = open_page(demo)
    sign_in(page, demo)
    page.locator('[data-testid="viewer"][data-state="drawn"]').wait_for()
    before = page.get_by_test_id("viewer").bounding_box()
    page.frame_locator("iframe").locator("body").focus()
    page.keyboard.press("Shift+S")
    lamp(page, "stopped").wait_for()
    # The news lies over the page and does not move the ground under the cursor.
    expect(page.get_by_role("alert").first).to_be_visible()
    assert page.get_by_test_id("viewer").bounding_box() == before


def test_stop_with_more_pages_open_than_a_browser_has_connections(
    demo: Stack, open_page: Callable[..., Page]
) -> None:
    """A browser opens six HTTP connections to a server for all its pages together."""
    first = open_page(demo)
    without_view(first)
    sign_in(first, demo, path="/throws")
    pages = [first]
    for _ in range(6):
        page = first.context.new_page()
        without_view(page)
        page.goto("/throws")
        lamp(page, "disarmed").wait_for()
        pages.append(page)
    first.bring_to_front()
    first.keyboard.press("Shift+S")
    for page in pages:
        lamp(page, "stopped").wait_for()
