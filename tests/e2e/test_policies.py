"""Policy versions on one machine: uploaded, approved, retired, deployed, rolled back, a rollout aborted."""

import base64
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import onnx
from onnx import numpy_helper
from playwright.sync_api import Page, expect

from machine.policy_card import POLICY_FILE
from tests.e2e.axe_findings import findings_of_both_schemes
from tests.e2e.browser_console import Console
from tests.e2e.operator_page import sign_in, without_view
from tests.e2e.retrained_policy import RETRAINED, files_of, retrained, write_card
from tests.e2e.stack import Stack, client
from tests.waiting import until

OLDER, NEWER = "m545-2d-v6", "m545-2d-v7"


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
    page.get_by_role("button", name="Deploy", exact=True).press("Enter")
    expect(board.locator("li").first).to_be_focused()
    expect(board.locator("tbody tr").first).to_contain_text("Switched")
    expect(board.locator("li").first).to_contain_text(OLDER)
    until(lambda: _on_board(demo) == OLDER, f"m001 throws with {OLDER}")

    expect(back).to_be_enabled()
    back.click()
    expect(page.get_by_role("dialog")).to_contain_text(f"throws in 2D with {NEWER} again")
    page.get_by_role("dialog").get_by_label("Why").fill("end of the comparison")
    page.get_by_role("button", name=f"Go back to {NEWER}").press("Enter")
    expect(board.locator("li").first).to_be_focused()
    expect(board.locator("tbody tr").first).to_contain_text("(rolled back)")
    expect(board.locator("tbody tr").first).to_contain_text("Switched")
    expect(board.locator("li").first).to_contain_text(NEWER)
    until(lambda: _on_board(demo) == NEWER, f"m001 throws with {NEWER}")
    # A second rollback would bring back what the first took away.
    expect(back).to_be_disabled()
    expect(board.locator("li").first).to_contain_text(f"{OLDER} was rolled back. Deploy it")


def test_a_rollout_asks_the_machine_and_an_abort_takes_it_back(
    demo: Stack, open_page: Callable[..., Page]
) -> None:
    page = open_page(demo)
    without_view(page)
    sign_in(page, demo, "admin", path="/policies")
    panel = page.get_by_role("region", name="Rollouts", exact=True)
    expect(panel).to_contain_text("No rollout is open")
    panel.get_by_role("button", name="Start a rollout").click()
    dialog = page.get_by_role("dialog")
    dialog.get_by_label("Version").select_option(label=f"{OLDER} (2D)")
    dialog.get_by_label("Why").fill("a canary")
    expect(dialog.get_by_role("button", name="Start the rollout")).to_be_disabled()
    dialog.get_by_label("Stages").fill("m001")
    dialog.get_by_role("button", name="Start the rollout").click()
    rollout = panel.get_by_role("article", name=f"Rollout of {OLDER} in 2D")
    expect(rollout).to_contain_text("Running, stage 1 of 1")
    row = rollout.get_by_role("row", name="m001")
    expect(row).to_contain_text("throws are counted")
    expect(row).to_contain_text("0 of 12")
    until(lambda: _on_board(demo) == OLDER, f"m001 throws with {OLDER}")
    assert findings_of_both_schemes(page) == []

    abort = rollout.get_by_role("button", name=f"Abort: rollout of {OLDER} in 2D")
    abort.focus()
    page.keyboard.press("Enter")
    expect(dialog).to_contain_text("goes back to the version before")
    dialog.get_by_label("Why").fill("end of the trial")
    dialog.get_by_role("button", name="Abort", exact=True).press("Enter")
    expect(panel).to_contain_text("No rollout is open")
    panel.get_by_text("Earlier rollouts").click()
    expect(rollout).to_contain_text("Aborted")
    until(lambda: _on_board(demo) == NEWER, f"m001 throws with {NEWER}")


def _permute_inputs(folder: Path) -> None:
    """As an exporter that sorts its inputs: the file is sound, its golden vectors tell."""
    model = onnx.load(str(folder / POLICY_FILE))
    for tensor in model.graph.initializer:
        if tensor.name in ("mean", "scale", "weights_0"):
            values = np.roll(numpy_helper.to_array(tensor), 1, axis=0)
            tensor.CopyFrom(numpy_helper.from_array(values.copy(), tensor.name))
    (folder / POLICY_FILE).write_bytes(model.SerializeToString())
    write_card(folder)


def _drop(page: Page, files: list[Path]) -> None:
    """Drop files on the panel as a file manager does."""
    contents = [[file.name, base64.b64encode(file.read_bytes()).decode()] for file in files]
    dropped = page.evaluate_handle(
        """(files) => {
            const transfer = new DataTransfer();
            for (const [name, text] of files) {
                const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
                transfer.items.add(new File([bytes], name));
            }
            return transfer;
        }""",
        contents,
    )
    page.get_by_test_id("drop-policy").dispatch_event("drop", {"dataTransfer": dropped})


def test_a_version_is_uploaded_approved_and_retired(
    demo: Stack, open_page: Callable[..., Page], console: Console, tmp_path: Path
) -> None:
    console.allowed.append("400 (Bad Request)")  # the refused upload
    good = retrained(tmp_path / "good")
    bad = Path(shutil.copytree(good, tmp_path / "bad"))
    _permute_inputs(bad)
    page = open_page(demo)
    without_view(page)
    sign_in(page, demo, "admin", path="/policies")
    panel = page.get_by_role("region", name="Upload a version")
    send = panel.get_by_role("button", name="Upload", exact=True)
    card = page.get_by_role("article", name=RETRAINED)

    # Not all files: said before anything is sent.
    _drop(page, files_of(bad)[:2])
    expect(panel).to_contain_text("golden_vectors.json is missing")
    expect(send).to_be_disabled()
    _drop(page, files_of(bad))
    panel.get_by_label("Why").fill("retrained in the yard")
    send.click()
    expect(panel.get_by_role("alert")).to_contain_text("not those that it was trained with")
    expect(card).to_have_count(0)

    panel.locator("input[type=file]").set_input_files(files_of(good))
    send.click()
    expect(panel.get_by_role("status")).to_contain_text(f"{RETRAINED} is uploaded")
    expect(card).to_contain_text("Not approved")
    steps = card.get_by_role("list", name=f"Life of {RETRAINED}")
    now = steps.locator("[aria-current=step]")
    expect(now).to_have_text("Uploaded")

    card.get_by_role("button", name="Approve").click()
    dialog = page.get_by_role("dialog")
    expect(dialog.get_by_test_id("approval-basis")).to_contain_text("has no finished validation")
    dialog.get_by_label("Why").fill("looks right")
    expect(dialog.get_by_role("button", name="Approve", exact=True)).to_be_disabled()
    dialog.get_by_label("Approve it without a validation").check()
    dialog.get_by_role("button", name="Approve without a validation").click()
    expect(now).to_have_text("Approved")
    expect(card.get_by_role("button", name=f"Deploy to m001: {RETRAINED}")).to_be_enabled()

    card.get_by_role("button", name=f"Retire {RETRAINED}").click()
    page.get_by_role("dialog").get_by_label("Why").fill("only a try")
    page.get_by_role("button", name=f"Retire {RETRAINED} for good").click()
    expect(now).to_have_text("Retired")
    card.get_by_text("Who, when and why").click()
    for words in (
        "by admin: retrained in the yard",
        "Approved without a validation",
        "by admin: looks right",
        "by admin: only a try",
    ):
        expect(card).to_contain_text(words)
    with client(demo, "admin") as admin:
        found = admin.get("/policies").json()
        assert [one["state"] for one in found if one["policy_id"] == RETRAINED] == ["retired"]


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
