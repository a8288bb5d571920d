"""Everything without a pointer: sign in, take control, aim, hold the space bar, read the result."""

from collections.abc import Callable

from playwright.sync_api import Page, expect

from tests.e2e.operator_page import (
    HOLD,
    gate,
    load_if_empty,
    open_step,
    result_text,
    throw_until_landed,
    without_view,
)
from tests.e2e.stack import Stack

OUTLINE = "getComputedStyle(document.activeElement).outlineStyle"


def _tab_to(page: Page, name: str, limit: int = 40) -> None:
    """Tab until the element with this name or text has the focus, which must be seen."""
    script = """() => {
        const e = document.activeElement;
        return [e.getAttribute("aria-label"), e.innerText, e.labels?.[0]?.innerText].join("|");
    }"""
    for _ in range(limit):
        page.keyboard.press("Tab")
        if name in page.evaluate(script):
            return
    raise AssertionError(f"{name!r} is not reached within {limit} tabs")


def _sign_in_by_key(page: Page, stack: Stack) -> None:
    page.goto("/operate")
    expect(page.get_by_label("Name")).to_be_focused()
    page.keyboard.type("operator")
    page.keyboard.press("Tab")
    page.keyboard.type(stack.passwords["operator"])
    page.keyboard.press("Enter")
    page.get_by_test_id("stop").wait_for()


def test_throw_without_a_pointer(demo: Stack, open_page: Callable[..., Page]) -> None:
    page = open_page(demo)
    without_view(page)
    _sign_in_by_key(page, demo)
    gate(page, "no_lease").wait_for()
    _tab_to(page, "Take control")
    assert page.evaluate(OUTLINE) != "none"
    page.keyboard.press("Enter")
    page.get_by_test_id("lease-words").filter(has_text="You are in control").wait_for()

    open_step(page, "Target")
    _tab_to(page, "Range, m")
    page.keyboard.press("ControlOrMeta+a")
    page.keyboard.type("9")
    expect(page.get_by_label("Range, m")).to_have_value("9")

    # Aside of the fields the arrow keys move the target by 5 cm.
    _tab_to(page, "Preview")
    page.keyboard.press("ArrowUp")
    page.keyboard.press("ArrowUp")
    open_step(page, "Target")
    expect(page.get_by_label("Range, m")).to_have_value("9.1")

    load_if_empty(page)
    throw_until_landed(page, "key")
    assert "Measured" in result_text(page)
    page.get_by_role("button", name="Give back control").press("Enter")


def test_letting_go_before_the_commit_point_aborts(
    demo: Stack, open_page: Callable[..., Page]
) -> None:
    page = open_page(demo)
    without_view(page)
    _sign_in_by_key(page, demo)
    gate(page, "no_lease").get_by_role("button").press("Enter")
    open_step(page, "Target")
    page.get_by_label("Range, m").press_sequentially("9")
    page.get_by_label("Azimuth, °").press_sequentially("90")
    page.get_by_label("Azimuth, °").press("Tab")
    load_if_empty(page)
    page.locator(HOLD).focus()

    # A tap is not a hold: nothing is armed.
    page.keyboard.press("Space")
    expect(page.get_by_test_id("hold-note")).to_contain_text("Hold for one second")

    # The cabin has to turn by 90 degrees first, far from the commit point.
    page.keyboard.down("Space")
    page.locator('header [data-testid="lamp"][data-phase="aligning"]').wait_for()
    page.keyboard.up("Space")
    page.locator('header [data-testid="lamp"][data-phase="disarmed"]').wait_for()
    assert "Aborted" in page.get_by_role("complementary").inner_text()
    page.get_by_role("button", name="Give back control").press("Enter")
