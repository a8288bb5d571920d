"""Exclusion zones: drawn in the 3D view, approved, obeyed by clicks and throws, changed."""

import contextlib
from collections.abc import Callable, Iterator

import pytest
from playwright.sync_api import Page, expect
from playwright.sync_api import TimeoutError as BrowserTimeoutError

from tests.e2e.operator_page import (
    click_until,
    gate,
    open_step,
    sign_in,
    take_control,
    throw_until_landed,
    without_view,
)
from tests.e2e.stack import Stack, client
from tests.waiting import until

ZONES = "/machines/m001/zones"
CORNERS = ((0.70, 0.62), (0.80, 0.52))
"""Two points of the ground in the 3D view of a page of 1024 by 768, as shares of it."""


@pytest.fixture(autouse=True)
def without_zones(demo: Stack) -> Iterator[None]:
    """The other tests of the demo throw where they like."""
    yield
    with client(demo, "admin") as admin:
        version = admin.get(ZONES).json()["version_count"]
        body = {"zones": [], "from_version_count": version, "reason": "end of the test"}
        admin.put(ZONES, json=body).raise_for_status()
        admin.post(f"{ZONES}/approve", json={"version_count": version + 1}).raise_for_status()


TAPS = ((0.70, 0.72), (0.86, 0.70), (0.88, 0.88), (0.72, 0.90))
"""Four points of the ground in the 3D view of a tablet held upright, in the order of a walk around."""
SLIP = (0.30, 0.90)


def _tap_corner(page: Page, share: tuple[float, float], count: int) -> None:
    """Tap the view until the panel has `count` corners; a busy computer may answer an earlier tap late."""
    box = page.get_by_test_id("viewer").bounding_box()
    assert box is not None
    shown = page.get_by_text(f"{count} corners.")
    for _ in range(4):
        page.touchscreen.tap(
            box["x"] + share[0] * box["width"], box["y"] + share[1] * box["height"]
        )
        with contextlib.suppress(BrowserTimeoutError):
            shown.wait_for(timeout=15_000.0)
            return
    raise AssertionError(f"four taps and no corner {count}: {page.inner_text('form')}")


def _approve(page: Page, reason: str) -> None:
    page.get_by_label("Why it is changed").fill(reason)
    page.get_by_role("button", name="Save draft").click()
    page.get_by_role("button", name="Approve version").click()
    expect(page.get_by_test_id("zones-in-force")).to_contain_text("m001 has them")


def _aim(page: Page, range_m: float, azimuth_deg: float) -> None:
    open_step(page, "Target")
    page.get_by_label("Range, m").fill(f"{range_m:g}")
    page.get_by_label("Azimuth, °").fill(f"{azimuth_deg:g}")


def test_a_zone_is_drawn_approved_obeyed_and_changed(
    demo: Stack, open_page: Callable[..., Page]
) -> None:
    page = open_page(demo)
    sign_in(page, demo, "admin", path="/site")
    page.get_by_text("Zones", exact=True).click()
    page.get_by_role("button", name="Draw box").click()
    click_until(page, CORNERS[0], page.get_by_text("Click or tap the opposite corner.").first)
    click_until(page, CORNERS[1], page.get_by_text("4 corners, 0.0 m to 3.0 m").first)
    # By keyboard to where the throws go: a box around 9 m ahead.
    page.get_by_role("textbox", name="Name", exact=True).fill("Office")
    page.get_by_role("textbox", name="What is there").fill("people work there")
    for index, (x, y) in enumerate(((8, -1.5), (10, -1.5), (10, 1.5), (8, 1.5)), 1):
        page.get_by_label(f"x {index}, m").fill(str(x))
        page.get_by_label(f"y {index}, m").fill(str(y))
    _approve(page, "the office was moved")

    # Quicker without the 3D view: these throws are aimed by numbers.
    without_view(page)
    page.get_by_role("navigation", name="Pages").get_by_role("link", name="Operate").click()
    take_control(page)
    _aim(page, 9.0, 0.0)
    refused = gate(page, "refused")
    expect(refused).to_contain_text("into zone 'Office', which is kept free up to 3.0 m")
    _aim(page, 8.5, -60.0)
    throw_until_landed(page, "key")

    page.get_by_role("navigation", name="Pages").get_by_role("link", name="Site").click()
    page.get_by_text("Zones", exact=True).click()
    page.get_by_role("button", name="zone Office").click()
    page.get_by_label("To, m", exact=True).fill("2.5")
    _approve(page, "it is lower than that")
    with client(demo, "admin") as api:
        active = api.get(ZONES).json()["approved"]
        assert [(zone["name"], zone["top_m"]) for zone in active] == [("Office", 2.5)]
        sha256 = api.get(ZONES).json()["approved_sha256"]
        until(
            lambda: api.get("/machines/m001").json()["state"]["zones_sha256"] == sha256,
            "the machine to have the zone",
        )
        api.delete("/machines/m001/lease")


def test_a_polygon_is_drawn_with_a_finger(demo: Stack, open_page: Callable[..., Page]) -> None:
    page = open_page(demo, 834, 1112, touch=True)
    sign_in(page, demo, path="/site")
    page.get_by_text("Zones", exact=True).tap()
    page.get_by_role("button", name="Draw polygon").tap()
    page.locator('[data-testid="viewer"][data-state="drawn"]').wait_for()
    _tap_corner(page, TAPS[0], 1)
    _tap_corner(page, TAPS[1], 2)
    _tap_corner(page, SLIP, 3)
    page.get_by_role("button", name="Take back the last corner").tap()
    expect(page.get_by_text("2 corners.")).to_be_visible()
    _tap_corner(page, TAPS[2], 3)
    _tap_corner(page, TAPS[3], 4)
    # What a finger needs beside the view is in sight and large enough, without scrolling.
    for name in ("Finish", "Take back the last corner", "Cancel"):
        button = page.get_by_role("button", name=name)
        expect(button).to_be_in_viewport(ratio=1.0)
        box = button.bounding_box()
        assert box is not None and box["height"] >= 36.0
    page.get_by_role("button", name="Finish").tap()
    page.get_by_role("textbox", name="What is there").fill("a shed")
    page.get_by_label("Why it is changed").fill("it was built")
    page.get_by_role("button", name="Save draft").tap()
    expect(page.get_by_text("In force once a supervisor approves it.")).to_be_visible()
    with client(demo, "admin") as api:
        (zone,) = api.get(ZONES).json()["zones"]
    xs, ys = zip(*zone["corners_m"], strict=True)
    assert len(xs) == 4 and max(xs) - min(xs) > 1.0 and max(ys) - min(ys) > 1.0
