"""Fleet and machine pages, the yard map, webhooks."""

import re
from collections.abc import Callable

from playwright.sync_api import Page, expect

from tests.e2e.axe_findings import findings_of_both_schemes
from tests.e2e.browser_console import Console
from tests.e2e.fleet_page import is_as_wide_as_the_screen, placed_on_the_map
from tests.e2e.operator_page import sign_in, without_view
from tests.e2e.stack import Stack

SIZES = ((1024, 768), (390, 844))
"""Of a tablet and of a phone."""


def test_fleet_and_map_fit_a_tablet_and_a_phone(
    demo: Stack, open_page: Callable[..., Page]
) -> None:
    page = open_page(demo, *SIZES[0])
    page.emulate_media(color_scheme="light")
    without_view(page)
    sign_in(page, demo, "admin", path="/fleet")
    row = page.get_by_test_id("fleet-m001")
    for width, height in SIZES:
        page.set_viewport_size({"width": width, "height": height})
        expect(row).to_contain_text("Disarmed")
        expect(row).to_contain_text("m545-3d-v7")
        expect(row.get_by_role("button", name="STOP m001")).to_be_in_viewport()
        assert is_as_wide_as_the_screen(page)
    mark = placed_on_the_map(page)
    for width, height in SIZES:
        page.set_viewport_size({"width": width, "height": height})
        page.reload()
        expect(mark).to_be_in_viewport()
        expect(mark).to_contain_text("Disarmed")
        assert is_as_wide_as_the_screen(page)
        assert findings_of_both_schemes(page) == []
    mark.click()
    page.get_by_role("button", name="Take off the plan").click()
    expect(page.get_by_role("group", name="Without a place")).to_contain_text("m001")
    page.get_by_text("List", exact=True).click()
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
