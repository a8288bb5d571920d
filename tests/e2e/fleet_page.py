"""What several tests do on the fleet page and its map."""

from playwright.sync_api import Locator, Page, expect


def is_as_wide_as_the_screen(page: Page) -> bool:
    """Whether nothing has to be scrolled sideways."""
    return page.evaluate(
        "[...document.querySelectorAll('main, main > div')]"
        ".every((box) => box.scrollWidth <= box.clientWidth + 1)"
    )


def placed_on_the_map(page: Page) -> Locator:
    """Put m001 on the plan, by the keyboard; returns its mark."""
    page.get_by_text("Map", exact=True).click()
    plan = page.get_by_role("region", name="Yard map")
    mark = plan.get_by_test_id("map-m001")
    mark.focus()
    page.keyboard.press("Enter")
    form = plan.get_by_role("form", name="Place of m001")
    form.get_by_label("Right, m").fill("12.5")
    form.get_by_label("Up, m").fill("-3")
    form.get_by_label("Heading").fill("90")
    page.keyboard.press("Enter")
    expect(form.get_by_role("button", name="Take off the plan")).to_be_visible()
    expect(plan.get_by_role("group", name="Without a place")).to_have_count(0)
    expect(mark).to_be_in_viewport()
    expect(plan.get_by_role("button", name="STOP m001")).to_be_visible()
    return mark
