"""Tests with a server of their own: its machine is lost, one is added and retired, the server itself dies."""

from collections.abc import Callable, Iterator

import pytest
from playwright.sync_api import Page, expect

from tests.e2e.browser_console import Console
from tests.e2e.fleet_page import is_as_wide_as_the_screen, placed_on_the_map
from tests.e2e.operator_page import sign_in, without_view
from tests.e2e.stack import Command, ServerAlone

pytestmark = pytest.mark.begins_first


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
    mark = placed_on_the_map(tablet)
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
    assert is_as_wide_as_the_screen(page)
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


def test_server_dies_and_comes_back(
    server: ServerAlone, open_page: Callable[..., Page], console: Console
) -> None:
    console.allowed += [
        "ERR_CONNECTION_REFUSED",
        "ERR_CONNECTION_RESET",
        "ERR_INCOMPLETE_CHUNKED_ENCODING",
        "ERR_EMPTY",
    ]
    stack = server.start()
    page = open_page(stack)
    without_view(page)
    sign_in(page, stack)
    expect(page.get_by_text("No machine has connected")).to_be_visible()
    banner = page.get_by_test_id("offline")
    expect(banner).to_have_count(0)

    server.kill()
    expect(banner).to_contain_text("Not live: last data")
    expect(banner).to_contain_text("5 s ago")  # it counts
    page.get_by_test_id("stop").click()
    expect(page.get_by_role("alert").filter(has_text="STOP not confirmed")).to_be_visible()

    server.start()
    expect(banner).to_have_count(0)
    expect(page.get_by_role("alert").filter(has_text="STOP not confirmed")).to_have_count(0)
