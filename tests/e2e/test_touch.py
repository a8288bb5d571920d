"""A whole throw with a finger: the browser gets touch events, not a mouse."""

from collections.abc import Callable

from playwright.sync_api import CDPSession, Page, expect

from tests.e2e.operator_page import (
    HOLD,
    STARVED,
    gate,
    load_if_empty,
    open_step,
    outcome,
    sign_in,
    without_view,
)
from tests.e2e.stack import Stack


class Finger:
    """One finger on the screen of a page."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._devtools: CDPSession = page.context.new_cdp_session(page)

    def down(self, selector: str) -> None:
        box = self._page.locator(selector).bounding_box()
        assert box is not None
        point = {"x": box["x"] + box["width"] / 2, "y": box["y"] + box["height"] / 2}
        self._send("touchStart", [point])

    def lift(self) -> None:
        self._send("touchEnd", [])

    def _send(self, kind: str, points: list[dict[str, float]]) -> None:
        self._devtools.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})


def _aim(page: Page) -> None:
    open_step(page, "Target")
    page.get_by_label("Range, m").fill("9")
    page.get_by_label("Azimuth, °").fill("5")
    page.get_by_label("Azimuth, °").press("Tab")


def _throw_and_keep_the_finger_down(page: Page, finger: Finger) -> None:
    """Until the result shows; again where this computer starved the signal of the hold."""
    for _ in range(4):
        load_if_empty(page)
        finger.down(HOLD)
        text = outcome(page, while_held=True)
        if not any(words in text for words in STARVED):
            return
        finger.lift()
        again = page.get_by_role("button", name="Throw again")
        if again.count():
            again.tap()
    raise AssertionError(f"no throw landed; the last said: {text}")


def test_lifting_the_finger_after_a_throw_presses_nothing(
    demo: Stack, open_page: Callable[..., Page]
) -> None:
    page = open_page(demo, 834, 1112, touch=True)
    without_view(page)
    sign_in(page, demo)
    gate(page, "no_lease").get_by_role("button", name="Take control").tap()
    _aim(page)
    finger = Finger(page)
    _throw_and_keep_the_finger_down(page, finger)

    # The button is still under the finger, and dead; "Throw again" is somewhere else.
    button = page.locator(HOLD)
    expect(button).to_have_attribute("aria-disabled", "true")
    expect(button).to_contain_text("lift the finger")
    held, again = button.bounding_box(), page.get_by_role("button", name="Throw again")
    box = again.bounding_box()
    assert held is not None and box is not None
    assert box["y"] + box["height"] <= held["y"] or box["y"] >= held["y"] + held["height"]

    finger.lift()
    expect(button).to_have_count(0)
    expect(page.get_by_test_id("result")).to_contain_text("Measured")
    again.tap()
    expect(page.get_by_test_id("result")).to_have_count(0)
    page.get_by_role("button", name="Give back control").tap()

    # The note of a plot ("n = 1") stays in one line beside its title, also where three plots share the width.
    page.goto(f"{demo.url}/throws")
    heads = page.get_by_role("region", name="Accuracy").locator("section > header")
    expect(heads).to_have_count(3)
    for head in heads.all():
        height_px, font_px = head.evaluate(
            """head => {
                head.style.width = "260px";
                const note = head.querySelector("span");
                return [note.offsetHeight, parseFloat(getComputedStyle(note).fontSize)];
            }"""
        )
        assert height_px < 2 * font_px, head.inner_text()
