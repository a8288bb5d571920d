"""Policy versions: deployed, rolled back, validated, compared; what a machine runs is not retired."""

from collections.abc import Callable

from playwright.sync_api import Page, expect

from tests.e2e.axe_findings import findings_of_both_schemes
from tests.e2e.browser_console import Console
from tests.e2e.operator_page import sign_in, without_view
from tests.e2e.stack import Stack, client, until

OLDER, NEWER = "m545-2d-v6", "m545-2d-v7"
VALIDATION_MS = 300_000
"""Two registrations and a few throws, at low priority on a busy computer."""


def _on_board(demo: Stack) -> str:
    """The machine's own version in 2D, as its state says."""
    with client(demo, "admin") as admin:
        found = admin.get("/machines/m001/policies").json()["policies"]
    return next(one["policy_id"] for one in found if one["mode"] == "2d")


def test_a_version_is_deployed_and_rolled_back(demo: Stack, open_page: Callable[..., Page]) -> None:
    page = open_page(demo)
    without_view(page)
    sign_in(page, demo, "admin", path="/policies")
    board = page.get_by_role("region", name="On board m001")
    expect(board).to_contain_text(NEWER)
    back = board.get_by_role("button", name="Roll back 2D of m001")
    expect(back).to_be_disabled()
    expect(page.get_by_role("article", name=OLDER)).to_contain_text("Approved by the site's key")
    # What is on board is not offered again.
    expect(page.get_by_role("button", name=f"Deploy to m001: {NEWER}")).to_be_disabled()

    page.get_by_role("button", name=f"Deploy to m001: {OLDER}").click()
    page.get_by_role("dialog").get_by_label("Why").fill("compare both in the yard")
    page.get_by_role("button", name="Deploy", exact=True).click()
    expect(board.locator("tbody tr").first).to_contain_text("Switched")
    expect(board.locator("li").first).to_contain_text(OLDER)
    until(lambda: _on_board(demo) == OLDER, f"m001 throws with {OLDER}")

    expect(back).to_be_enabled()
    back.click()
    expect(page.get_by_role("dialog")).to_contain_text(f"throws in 2D with {NEWER} again")
    page.get_by_role("dialog").get_by_label("Why").fill("end of the comparison")
    page.get_by_role("button", name=f"Go back to {NEWER}").click()
    expect(board.locator("tbody tr").first).to_contain_text("(rolled back)")
    expect(board.locator("tbody tr").first).to_contain_text("Switched")
    expect(board.locator("li").first).to_contain_text(NEWER)
    until(lambda: _on_board(demo) == NEWER, f"m001 throws with {NEWER}")


def test_what_the_machine_runs_is_not_retired(
    demo: Stack, open_page: Callable[..., Page], console: Console
) -> None:
    console.allowed.append("409 (Conflict)")  # the refusal
    page = open_page(demo)
    without_view(page)
    sign_in(page, demo, "admin", path="/policies")
    page.get_by_role("button", name=f"Retire {NEWER}").click()
    page.get_by_role("dialog").get_by_label("Why").fill("a mistake")
    page.get_by_role("button", name=f"Retire {NEWER} for good").click()
    expect(page.get_by_role("dialog").get_by_role("alert")).to_contain_text("m001")


def test_a_version_is_validated_and_compared(demo: Stack, open_page: Callable[..., Page]) -> None:
    page = open_page(demo)
    without_view(page)
    sign_in(page, demo, "admin", path="/policies")
    gates = page.get_by_role("region", name="Gates of validations")
    expect(gates).to_contain_text("defaults")
    panel = page.get_by_role("region", name=f"Validation of {OLDER}")
    expect(panel).to_contain_text("Not validated yet.")

    # By keyboard: few throws, the nominal machine alone.
    panel.get_by_role("button", name=f"Validate {OLDER}").focus()
    page.keyboard.press("Enter")
    dialog = page.get_by_role("dialog")
    dialog.get_by_label("Throws at each target").fill("2")
    dialog.get_by_label("Machines that served no training").fill("0")
    dialog.get_by_role("button", name="Validate", exact=True).press("Enter")
    expect(panel.get_by_role("progressbar")).to_be_visible()
    table = panel.get_by_role("region", name=f"Gates of {OLDER}")
    expect(table).to_be_visible(timeout=VALIDATION_MS)
    expect(table).to_contain_text(f"Spread along beside {NEWER}")
    expect(table.get_by_role("row", name="Same seed, same throws")).to_contain_text("passed")
    panel.get_by_text(f"Throws with {OLDER}").click()
    expect(panel.get_by_role("region", name="virtual machine 0").first).to_contain_text("of 2")

    compare = page.get_by_role("region", name="Compare two versions")
    for label, version in (("First version", NEWER), ("Second version", OLDER)):
        compare.get_by_label(label, exact=True).and_(page.locator("input")).click()
        page.get_by_role("option", name=version).click()
        expect(page.get_by_role("option")).to_have_count(0)
    by_validation = compare.get_by_role("region", name="By validations", exact=True)
    expect(by_validation).to_contain_text("6 and 6 throws with 1 virtual machine")
    expect(by_validation).to_contain_text("cannot tell from")
    expect(by_validation.get_by_role("img", name="Impacts in throw coordinates")).to_be_visible()
    assert findings_of_both_schemes(page) == []
