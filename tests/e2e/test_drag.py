"""The target is dragged in the 3D view."""

import contextlib
import re
from collections.abc import Callable

import pytest
from playwright.sync_api import Page, expect

from tests.e2e.operator_page import (
    click_until,
    open_step,
    sign_in,
    take_control,
)
from tests.e2e.stack import Stack

GROUND = (0.45, 0.8)
"""Open ground within reach in the 3D view of a page of 1024 by 768, as a share of it."""
DRAG_PX = (60.0, 20.0)
TARGET = re.compile(r"Target.*?(\d+\.\d+)\s*m", re.DOTALL)
LEAST_M, REACH_M = 6.2, 10.7
"""Ranges of 2D throws, with something to spare."""


COUNT_ESTIMATES = """() => {
  window.estimates = 0;
  const count = () => {
    if (document.querySelector('[data-testid="estimate"]')) window.estimates += 1;
  };
  new MutationObserver(count).observe(document.body, { subtree: true, childList: true });
}"""


def _polar(page: Page) -> tuple[str, str]:
    return (
        page.get_by_label("Range, m").input_value(),
        page.get_by_label("Azimuth, °").input_value(),
    )


def _click_within_reach(page: Page) -> tuple[float, float]:
    """The pixel of a target on the ground.

    The camera may still be on its way when the first picture is drawn: what is clicked then lies elsewhere.
    """
    panel = page.get_by_role("complementary")
    at = click_until(page, GROUND, panel.get_by_role("button", name="2 Preview", expanded=True))
    heading = panel.get_by_role("button", name=TARGET)
    for _ in range(4):
        text = heading.inner_text()
        found = TARGET.search(text)
        if found is not None and LEAST_M < float(found.group(1)) < REACH_M:
            return at
        page.mouse.click(*at)
        with contextlib.suppress(AssertionError):
            expect(heading).not_to_have_text(text, timeout=15_000.0)
    raise AssertionError(f"four clicks on the ground and none within reach; the last: {text}")


def _let_go_within_reach(page: Page, start: tuple[float, float]) -> None:
    """Drag the held target on until it lies within reach, and let go.

    The camera may have turned, so that what lies under a pixel is known from the page alone.
    """
    range_m = page.get_by_label("Range, m")
    for x_px in (-DRAG_PX[0], 0.0, 0.5 * DRAG_PX[0], DRAG_PX[0]):
        for y_px in (0.0, -DRAG_PX[1], DRAG_PX[1]):
            before = range_m.input_value()
            page.mouse.move(start[0] + x_px, start[1] + y_px, steps=12)
            with contextlib.suppress(AssertionError):
                expect(range_m).not_to_have_value(before, timeout=5_000.0)
            if LEAST_M < float(range_m.input_value()) < REACH_M:
                page.mouse.up()
                return
    raise AssertionError("the target was dragged about and never lay within reach")


def _drag(page: Page, start: tuple[float, float]) -> None:
    """Drag the target and keep it held.

    Where its mark was not drawn yet the camera turns instead, and the mark is elsewhere in the picture: then
    a click puts the target under the pointer again.
    """
    range_m = page.get_by_label("Range, m")
    for _ in range(4):
        before = range_m.input_value()
        page.mouse.move(*start)
        page.mouse.down()
        page.mouse.move(start[0] + DRAG_PX[0], start[1] + DRAG_PX[1], steps=12)
        with contextlib.suppress(AssertionError):
            expect(range_m).not_to_have_value(before, timeout=15_000.0)
            return
        page.mouse.up()
        page.mouse.click(*start)
        with contextlib.suppress(AssertionError):
            expect(range_m).not_to_have_value(before, timeout=15_000.0)
    raise AssertionError("four drags and the target stayed")


# A drag that begins before the mark is drawn turns the camera: a busy computer without graphics may never get
# hold of the mark.
@pytest.mark.long
def test_the_target_is_dragged_and_its_ellipse_follows(
    demo: Stack, open_page: Callable[..., Page]
) -> None:
    page = open_page(demo)
    sign_in(page, demo)
    take_control(page)
    at = _click_within_reach(page)
    numbers = page.get_by_test_id("preview-numbers")
    # The ellipse from which that of a target nearby is estimated.
    expect(numbers).to_contain_text("of 200")
    open_step(page, "Target")
    before = _polar(page)
    page.evaluate(COUNT_ESTIMATES)

    _drag(page, at)
    held = _polar(page)
    assert held != before
    page.wait_for_function("window.estimates > 0")
    _let_go_within_reach(page, at)
    expect(page.get_by_label("Azimuth, °")).not_to_have_value(held[1])

    # Where it was let go it is previewed in full.
    expect(numbers).to_contain_text("of 200")
    page.get_by_role("button", name="Give back control").click()
