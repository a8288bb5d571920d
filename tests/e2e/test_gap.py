"""The Gap page in one test: a diagnosis with progress, one cancelled, the verdict, previews, apply, undo.

The history holds throws of a machine whose load leaves 80 ms later than its twin believes, so that the gap is
known. The demo is one of its own: other tests find no throws and no twin versions of this one.
"""

import re
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from cli.record import run as record
from machine.calibration import nominal_calibration
from machine.spec import load_spec
from server.services import assemble, prepare_database
from server.settings import load_settings
from server.viewer.scene import ViewerScene
from sim_twin.effects.effect import Effect
from sim_twin.twin.profile import nominal_profile, save_profile
from tests.e2e.operator_page import sign_in
from tests.e2e.stack import ROOT, Stack, running_demo
from tests.server.gap_bench import add_throws

LATE_S = 0.08
THROWS_COUNT = 8


@pytest.fixture
def gap_demo(tmp_path: Path) -> Iterator[Stack]:
    """A demo with a nominal twin and throws of a machine that opens later."""
    spec = load_spec()
    nominal = nominal_profile(spec)
    late = Effect(effect="release_delay", parameters={"extra_delay_s": LATE_S})
    save_profile(nominal.model_copy(update={"effects": (late,)}), tmp_path / "late.json")
    logs = tmp_path / "logs-of-throws"
    record(
        mode="3d",
        out=logs,
        plant="twin",
        throws=THROWS_COUNT,
        targets="8:9.5:0.5",
        policies=ROOT / "policies",
        profile=tmp_path / "late.json",
    )
    data = tmp_path / "demo"
    machines = data / "machines"
    machines.mkdir(parents=True)
    # What is measured already is not measured again when the demo starts.
    save_profile(nominal, machines / "m001.profile.json")
    calibration = nominal_calibration(spec, "m001")
    (machines / "m001.calibration.json").write_text(calibration.model_dump_json())
    settings = load_settings({}, data_dir=data, policies_dir=ROOT / "policies")
    database = prepare_database(settings)
    services, _ = assemble(settings, database, ViewerScene(spec, lambda *_: None))
    services.registry.provision(settings.machine_slot_count)
    add_throws(services, THROWS_COUNT, logs=sorted(logs.glob("*.mcap")))
    database.close()
    with running_demo(data) as stack:
        yield stack


def open_gap(page: Page, stack: Stack) -> None:
    sign_in(page, stack, "admin", "/gap")
    panel = page.get_by_role("form", name="New diagnosis")
    expect(panel).to_contain_text(f"{THROWS_COUNT} throws of this machine landed")


def start(page: Page) -> None:
    button = page.get_by_role("button", name="Start diagnosis")
    expect(button).to_be_enabled()
    button.click()
    expect(page.get_by_label("Progress of the diagnosis")).to_be_visible()


def cancel_one(page: Page) -> None:
    start(page)
    page.get_by_role("button", name="Cancel", exact=True).click()
    runs = page.get_by_role("region", name="Diagnoses")
    expect(runs.get_by_role("button").first).to_contain_text("Cancelled")
    expect(page.get_by_role("button", name="Cancel", exact=True)).to_have_count(0)


def diagnose(page: Page) -> None:
    """Start, see percentages go by, read the verdict."""
    start(page)
    main = page.locator("main")
    expect(main).to_contain_text(re.compile(r"[1-9]\d? %"))
    expect(page.get_by_role("region", name="Which")).to_be_visible()
    expect(main).to_contain_text("Explained")
    causes = page.get_by_role("region", name="Which")
    expect(causes.get_by_role("row").nth(1)).to_contain_text("release delay")
    expect(page.get_by_role("region", name="Where")).to_contain_text(re.compile("release", re.I))


def preview_both(page: Page) -> None:
    """The same target before and after: a load that leaves later flies another way."""
    page.get_by_role("button", name="Preview both").click()
    apply = page.get_by_role("region", name="Apply")
    along = apply.get_by_role("row", name=re.compile("^Along"))
    cells = along.get_by_role("cell")
    expect(cells).to_have_count(2)
    before, after = cells.all_inner_texts()
    assert re.search(r"\d\.\d\d m (long|short)", before)
    assert re.search(r"\d\.\d\d m (long|short)", after)
    assert before != after


def apply_and_undo(page: Page) -> None:
    apply = page.get_by_role("region", name="Apply")
    page.get_by_role("button", name="Apply to the twin").click()
    page.get_by_role("button", name="Apply as version").click()
    expect(apply).to_contain_text("in use.")
    page.get_by_role("button", name="Undo", exact=True).click()
    page.get_by_role("button", name="Undo it").click()
    expect(page.get_by_role("button", name="Apply to the twin")).to_be_visible()


def test_diagnose_cancel_apply_and_undo(gap_demo: Stack, open_page: Callable[..., Page]) -> None:
    page = open_page(gap_demo, 1280, 800)
    open_gap(page, gap_demo)
    cancel_one(page)
    diagnose(page)
    preview_both(page)
    apply_and_undo(page)
