"""A machine is lost: the alert reaches the page, is acknowledged, and ends when the machine is back."""

import re
from collections.abc import Callable, Iterator

import pytest
from playwright.sync_api import Locator, Page, expect

from tests.e2e.axe_findings import findings_of_both_schemes
from tests.e2e.browser_console import Console
from tests.e2e.operator_page import sign_in, without_view
from tests.e2e.stack import Command, ServerAlone, Stack


@pytest.fixture
def machines(server: ServerAlone) -> Iterator[list[Command]]:
    """Machines that a test starts."""
    started: list[Command] = []
    yield started
    for machine in started:
        machine.kill()


def test_a_lost_machine_is_told_and_acknowledged(
    server: ServerAlone, machines: list[Command], open_page: Callable[..., Page]
) -> None:
    stack = server.start()
    machines.append(server.machine())
    page = open_page(stack, 1280, 800)
    without_view(page)
    # News on the bar is for those who listen: the console opens its stream anew for the shown machine.
    with page.expect_websocket(lambda socket: "machine_id=m001" in socket.url) as stream:
        sign_in(page, stack, path="/alerts")
    stream.value.wait_for_event("framereceived")
    lamp = page.locator('header [data-testid="lamp"]')
    expect(lamp).to_have_attribute("data-phase", "disarmed")
    badge = page.get_by_test_id("alert-badge")

    machines[0].kill()
    lost = page.get_by_label("Open alerts").get_by_role("listitem", name="Machine lost m001")
    expect(lost).to_contain_text("The link is lost")
    expect(badge).to_contain_text("needs a look")
    expect(page.get_by_role("alert").filter(has_text="m001: The link is lost")).to_be_visible()

    lost.get_by_role("button", name="Acknowledge").click()
    page.get_by_label("Note").fill("the battery is being changed")
    page.get_by_role("button", name="I have seen it").click()
    expect(lost).to_contain_text("Seen by operator")
    expect(lost).to_contain_text("the battery is being changed")
    expect(badge).to_have_count(0)

    # A second person, on a tablet, sees the same.
    tablet = open_page(stack, 1024, 768)
    without_view(tablet)
    sign_in(tablet, stack, "admin", path="/alerts")
    seen = tablet.get_by_label("Open alerts").get_by_role("listitem", name="Machine lost m001")
    expect(seen).to_contain_text("Seen by operator")
    expect(seen.get_by_role("button", name="Silence")).to_be_in_viewport()

    # The fleet keeps the lost machine, and says that it is not live.
    tablet.get_by_role("link", name="Fleet").click()
    row = tablet.get_by_test_id("fleet-m001")
    expect(row).to_contain_text("Lost since")
    expect(row).to_contain_text("last seen")
    expect(row).to_contain_text("1 seen")
    expect(row.get_by_role("button", name="STOP m001")).to_be_in_viewport()
    mark = _placed_on_the_map(tablet)
    expect(mark).to_contain_text("Lost since")
    expect(mark).to_have_attribute("data-lost", "true")

    machines.append(server.machine())
    expect(mark).to_contain_text("Disarmed")
    expect(mark).not_to_have_attribute("data-lost", "true")
    expect(lamp).to_have_attribute("data-phase", "disarmed")
    expect(lost).to_have_count(0)
    page.get_by_text("Cleared", exact=True).click()
    expect(
        page.get_by_label("Cleared alerts").get_by_role("listitem", name="Machine lost m001")
    ).to_contain_text("the battery is being changed")
    expect(page).to_have_url(f"{stack.url}/alerts?state=cleared")


def test_a_machine_is_added_lost_acknowledged_and_retired(
    server: ServerAlone, machines: list[Command], open_page: Callable[..., Page]
) -> None:
    stack = server.start()
    page = open_page(stack)
    without_view(page)
    sign_in(page, stack, "admin", path="/fleet")
    page.get_by_role("button", name="Add machine").click()
    page.get_by_label("Name", exact=True).fill("South pile")
    page.get_by_role("button", name="Make a token").click()
    machines.append(server.enrolled(page.get_by_test_id("enrol-command").inner_text()))
    tests = page.get_by_role("list", name="Self-test")
    expect(tests).to_contain_text("takes the password", timeout=60_000)
    expect(tests.get_by_role("listitem")).to_have_count(6)
    page.get_by_role("dialog").get_by_text("Close", exact=True).click()

    machines.append(server.started("m001"))
    row = page.get_by_test_id("fleet-m001")
    expect(row).to_contain_text("South pile")
    expect(row).to_contain_text("Disarmed", timeout=60_000)
    assert _is_as_wide_as_the_screen(page)
    machines[-1].kill()
    page.get_by_role("link", name="Alerts").first.click()
    lost = page.get_by_label("Open alerts").get_by_role("listitem", name="Machine lost m001")
    lost.get_by_role("button", name="Acknowledge").click()
    page.get_by_label("Note").fill("sold")
    page.get_by_role("button", name="I have seen it").click()
    expect(lost).to_contain_text("Seen by admin")

    page.goto(f"{stack.url}/machines/m001")
    expect(page.get_by_role("region", name="Set-up")).to_contain_text("Added by admin")
    page.get_by_role("button", name="Retire", exact=True).click()
    page.get_by_label("Reason").fill("sold to the quarry")
    page.get_by_role("button", name="Retire m001").click()
    expect(page).to_have_url(f"{stack.url}/fleet")
    expect(row).to_have_count(0)
    page.get_by_text("Retired (1)").click()
    expect(page.get_by_label("Retired machines")).to_contain_text("South pile")


def _is_as_wide_as_the_screen(page: Page) -> bool:
    return page.evaluate(
        "[...document.querySelectorAll('main, main > div')]"
        ".every((box) => box.scrollWidth <= box.clientWidth + 1)"
    )


def _placed_on_the_map(page: Page) -> Locator:
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


@pytest.mark.parametrize(("width", "height"), [(1024, 768), (390, 844)])
def test_the_yard_map_fits_a_tablet_and_a_phone(
    demo: Stack, open_page: Callable[..., Page], width: int, height: int
) -> None:
    page = open_page(demo, width, height)
    page.emulate_media(color_scheme="light")
    without_view(page)
    sign_in(page, demo, "admin", path="/fleet")
    mark = _placed_on_the_map(page)
    expect(mark).to_contain_text("Disarmed")
    assert _is_as_wide_as_the_screen(page)
    assert findings_of_both_schemes(page) == []
    page.reload()
    expect(mark).to_be_in_viewport()
    mark.click()
    page.get_by_role("button", name="Take off the plan").click()
    expect(page.get_by_role("group", name="Without a place")).to_contain_text("m001")


@pytest.mark.parametrize(("width", "height"), [(1024, 768), (390, 844)])
def test_the_fleet_fits_a_tablet_and_a_phone(
    demo: Stack, open_page: Callable[..., Page], width: int, height: int
) -> None:
    page = open_page(demo, width, height)
    without_view(page)
    sign_in(page, demo, path="/fleet")
    row = page.get_by_test_id("fleet-m001")
    expect(row).to_contain_text("Disarmed")
    expect(row).to_contain_text("m545-3d-v7")
    expect(row.get_by_role("button", name="STOP m001")).to_be_in_viewport()
    assert _is_as_wide_as_the_screen(page)
    page.get_by_label("Find a machine").fill("no such machine")
    expect(page.get_by_text("No machine matches")).to_be_visible()
    expect(page).to_have_url(re.compile("find=no"))


def test_a_machine_has_a_page_a_name_and_a_stop(
    demo: Stack, open_page: Callable[..., Page]
) -> None:
    page = open_page(demo, 1280, 800)
    without_view(page)
    sign_in(page, demo, "admin", path="/fleet")
    page.get_by_test_id("fleet-m001").get_by_role("link", name="m001").click()
    expect(page).to_have_url(f"{demo.url}/machines/m001")
    expect(page.get_by_role("heading", name="m001", exact=True)).to_be_visible()
    expect(page.get_by_role("region", name="On board", exact=True)).to_contain_text("m545-2d-v7")
    for name in ("Machine", "Alerts", "Throws", "Diagnoses", "Commissioning"):
        expect(page.get_by_role("region", name=name, exact=True)).to_be_visible()
    dossier = page.get_by_role("region", name="Dossier", exact=True)
    dossier.get_by_label("First day").fill("2020-01-02")
    dossier.get_by_label("Last day").fill("2020-01-01")
    expect(dossier).to_contain_text("lies before the first")
    dossier.get_by_label("Last day").fill("2020-01-02")
    expect(dossier).to_contain_text("has no ended throw in this time")
    expect(dossier.get_by_role("link", name="Export")).to_have_count(0)
    _call_it(page, "North digger")
    expect(page.get_by_role("heading", name="North digger")).to_be_visible()
    _call_it(page, "")
    expect(page.get_by_role("heading", name="m001", exact=True)).to_be_visible()
    expect(page.get_by_role("main").get_by_role("button", name="STOP m001")).to_be_in_viewport()


def _call_it(page: Page, name: str) -> None:
    page.get_by_role("button", name="Name and tags").click()
    page.get_by_label("Name", exact=True).fill(name)
    page.get_by_role("button", name="Keep").click()
    expect(page.get_by_role("dialog")).to_have_count(0)


def test_an_admin_adds_and_removes_a_webhook(
    demo: Stack, open_page: Callable[..., Page], console: Console
) -> None:
    console.allowed += ["400 (Bad Request)"]
    page = open_page(demo, 1280, 800)
    without_view(page)
    sign_in(page, demo, "admin", path="/alerts?state=webhooks")
    address = page.get_by_label("Address of the other system")
    add = page.get_by_role("button", name="Add webhook")
    address.fill("https://127.0.0.1/hook")
    add.click()
    expect(page.get_by_role("alert").filter(has_text="inside a network")).to_be_visible()
    address.fill("https://8.8.8.8/hook")
    add.click()
    secret = page.get_by_test_id("webhook-secret")
    expect(secret).to_contain_text("whsec_")
    item = page.get_by_role("listitem", name="https://8.8.8.8/hook")
    expect(item).to_contain_text("Added by admin")
    page.reload()
    expect(item).to_be_visible()
    expect(secret).to_have_count(0)
    item.get_by_role("button", name="Remove").click()
    page.get_by_role("dialog").get_by_role("button", name="Remove").click()
    expect(item).to_have_count(0)
