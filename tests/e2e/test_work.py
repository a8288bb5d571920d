"""A bulk job by a person: begun, a load aimed and held, seen on the surface, taken back, reported, ended."""

import re
from collections.abc import Callable

import pytest
from playwright.sync_api import Page, expect

from tests.e2e.axe_findings import findings_of_both_schemes
from tests.e2e.operator_page import sign_in, take_control, throw_until_landed, without_view
from tests.e2e.stack import Stack, client


def _volumes(demo: Stack, job_id: str) -> tuple[float, float]:
    """Growth of the surface since the start, and what the loads brought, m3."""
    with client(demo, "operator") as api:
        surface = api.get(f"/jobs/{job_id}/surface").json()
        loads = api.get(f"/jobs/{job_id}").json()["loads"]
    cell = surface["x_m"][1] - surface["x_m"][0]
    rows = zip(surface["height_m"], surface["start_m"], strict=True)
    grown = sum(sum(now) - sum(start) for now, start in rows) * cell**2
    return grown, sum(load["volume_m3"] for load in loads if not load["is_withdrawn"])


def test_a_truck_bed_is_filled_load_by_load(demo: Stack, open_page: Callable[..., Page]) -> None:
    page = open_page(demo, 1280, 800)
    page.emulate_media(color_scheme="light")
    without_view(page)
    sign_in(page, demo, path="/work")
    page.get_by_role("button", name="New job").click()
    page.get_by_label("Goal").select_option("truck:truck bed")
    page.get_by_label("Name").fill("truck 7")
    page.get_by_role("button", name="Start the job").click()
    figures, loads = page.get_by_test_id("job-figures"), page.locator("tr[data-load]")
    expect(page.get_by_role("heading", name="truck 7")).to_be_visible()
    expect(figures).to_contain_text("Filled0.0 %")
    job_id = page.url.split("job=")[-1]

    page.get_by_role("link", name="Aim at load 1").click()
    page.wait_for_url(re.compile(r"/operate\?.*range="))
    take_control(page)
    throw_until_landed(page, "key")
    page.get_by_role("link", name="Next load").click()
    expect(loads).to_have_count(1)
    expect(figures).to_contain_text("Thrown in 1 load")
    grown_m3, thrown_m3 = _volumes(demo, job_id)
    assert grown_m3 == pytest.approx(thrown_m3, rel=1e-2) and thrown_m3 > 0.0
    with page.expect_popup() as opened:
        page.get_by_role("link", name="Report").click()
    expect(opened.value.locator("body")).to_contain_text("truck 7")
    opened.value.close()
    page.get_by_role("link", name="Aim at load 1").wait_for()
    assert findings_of_both_schemes(page) == []

    page.get_by_role("button", name="Undo last load").click()
    expect(loads).to_contain_text("taken back")
    expect(figures).to_contain_text("Filled0.0 %")
    page.get_by_role("button", name="Give back control").click()
    page.get_by_role("button", name="End job").click()
    page.get_by_role("button", name="End the job").click()
    expect(page.get_by_role("button", name="New job")).to_be_enabled()
    expect(page.get_by_role("link", name="Report")).to_be_visible()

    # The history has the height of the bed, aimed at and measured.
    page.get_by_role("navigation", name="Pages").get_by_role("link", name="Throws").click()
    row = page.locator("tbody tr[data-throw]").first
    expect(row).to_contain_text("Landed")
    expect(row).to_contain_text("+1.20")
    row.get_by_role("link").click()
    records = page.get_by_role("complementary").get_by_role("listitem")
    expect(records).to_contain_text("m high")
