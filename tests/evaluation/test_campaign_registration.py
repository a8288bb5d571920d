"""The machine of an evaluation is registered before it throws, or the report says that it is not."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from cli.main import main
from evaluation.campaign_registration import RegisteredCampaign, is_registered, open_registered
from evaluation.campaigns import Campaign, CampaignOptions
from machine.calibration import nominal_calibration
from machine.errors import UsageError
from machine.policy_card import load_card
from machine.registration import Registration
from machine.spec import load_spec
from sim_twin.twin.twin import Twin

SPEC = load_spec()
PLANT = f"{__name__}:own_plant"


def own_plant(count: int, unit_seed: int) -> Twin:
    """A plant of somebody else's: a machine, not the twin, as far as the command line knows."""
    return Twin.for_plant(count=count, unit_seed=0)


def of_policy(folder: Path) -> Registration:
    return Registration(
        policy_sha256=load_card(folder).policy_sha256,
        throw_count=160,
        range_m=(7.0,),
        downrange_m=(0.2,),
        crossrange_m=(0.0,),
    )


@pytest.fixture
def seeds(swing_policies: Path, monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Seeds of registrations, with stand-ins for them and the valves: 240 throws are not for a quick test."""
    seen: list[int] = []

    def note(plant, params, spec, seed):
        seen.append(seed)
        return of_policy(swing_policies / "swing-2d")

    monkeypatch.setattr("evaluation.campaign_registration.register_machine", note)
    monkeypatch.setattr("evaluation.campaigns.plant_calibration", valves)
    return seen


def valves(name, make, *, unit_seed, spec, path):
    if path is None:
        return nominal_calibration(spec)
    return nominal_calibration(spec).model_validate_json(path.read_text(encoding="utf-8"))


def opened(
    policies: Path, plant: str = PLANT, calibration: Path | None = None
) -> RegisteredCampaign:
    options = CampaignOptions(plant, "6", 2, 3, 0, policies, None, calibration, None)
    return open_registered(options, "2d", "6")


def calibration_file(folder: Path, *registrations: Registration) -> Path:
    tables = nominal_calibration(SPEC).model_copy(update={"registrations": registrations})
    path = folder / "m.calibration.json"
    path.write_text(tables.model_dump_json(), encoding="utf-8")
    return path


def test_a_machine_without_a_calibration_is_registered_before_it_throws(
    swing_policies: Path, seeds: list[int]
):
    campaign, words = opened(swing_policies)
    assert seeds == [3]
    assert campaign.params.calibration.registrations == (of_policy(swing_policies / "swing-2d"),)
    assert is_registered(campaign)
    assert words.startswith("registered with 240 throws of its own")


def test_a_file_without_this_policys_registration_is_named_with_the_remedy(
    swing_policies: Path, tmp_path: Path, seeds: list[int]
):
    of_the_other_mode = of_policy(swing_policies / "swing-3d")
    path = calibration_file(tmp_path, of_the_other_mode)
    campaign, words = opened(swing_policies, calibration=path)
    assert not is_registered(campaign)
    assert words.startswith(f"NOT REGISTERED: {path} holds no registration of swing-2d")
    assert "leave --calibration out" in words and "downrange calibrate" in words
    path = calibration_file(tmp_path, of_policy(swing_policies / "swing-2d"))
    campaign, words = opened(swing_policies, calibration=path)
    assert is_registered(campaign)
    assert words == f"aims by its registration in {path}"
    assert seeds == []


def test_the_nominal_twin_stands_for_no_machine_and_is_not_registered(
    swing_policies: Path, seeds: list[int]
):
    campaign, words = opened(swing_policies, plant="twin")
    assert not is_registered(campaign) and seeds == []
    assert words.startswith("the nominal twin, not registered")


def test_a_policy_that_misses_too_far_to_be_registered_is_thrown_as_it_is(
    swing_policies: Path, seeds: list[int], monkeypatch: pytest.MonkeyPatch
):
    def refuse(*_: object) -> Registration:
        raise UsageError("a mean miss of 1.20 m is more than the 0.6 m that aiming may correct")

    monkeypatch.setattr("evaluation.campaign_registration.register_machine", refuse)
    campaign, words = opened(swing_policies)
    assert not is_registered(campaign)
    assert words.startswith("NOT REGISTERED: a mean miss of 1.20 m")


def test_table_json_and_page_say_whether_it_is_registered(
    swing_policies: Path,
    tmp_path: Path,
    seeds: list[int],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    for name, result in (("pace_rows", []), ("height_rows", []), ("measure_spread_parts", None)):
        monkeypatch.setattr(f"evaluation.mode_campaign.{name}", lambda *_, found=result: found)
    thrown = ["evaluate", "--mode", "2d", "--plant", PLANT, "--policies", str(swing_policies)]
    thrown += ["--throws", "2", "--targets", "6"]
    bare = ["--calibration", str(calibration_file(tmp_path))]
    for words, known in (([], True), (bare, False)):
        out = tmp_path / f"{known}.json"
        assert main([*thrown, *words, "--json", str(out)]) == 0
        assert json.loads(out.read_text(encoding="utf-8"))["is_registered"] is known
        printed = capsys.readouterr().out
        assert ("registered with 240 throws" in printed) is known
        assert ("NOT REGISTERED" in printed) is not known
        folder = tmp_path / f"report-{known}"
        assert main([*thrown, *words, "--report", str(folder), "--jobs", "1"]) == 0
        page = (folder / "report.html").read_text(encoding="utf-8")
        assert ("is <b>not registered</b>" in page) is not known
        assert ("NOT REGISTERED" in capsys.readouterr().out) is not known
    # The campaign's own seed is 0 if none is given; the report's is drawn.
    part = json.loads((tmp_path / "report-True/report.json").read_text(encoding="utf-8"))["modes"][
        0
    ]
    assert part["seed_is_drawn"] is True
    assert seeds == [0, part["seed"]]
    page = (tmp_path / "report-True/report.html").read_text(encoding="utf-8")
    assert f"Seed {part['seed']} was drawn when this evaluation began" in page
    assert part["policy_sha256"][:12] in page
    assert "2 throws per target are too few for a verdict: 200 are required" in page


def test_the_report_throws_everything_with_the_registered_machine(
    swing_policies: Path, tmp_path: Path, seeds: list[int], monkeypatch: pytest.MonkeyPatch
):
    """Stand-ins for what is thrown besides: each must be given the machine that aims."""
    known: dict[str, bool] = {}

    def saw(name: str, result: object):
        def look(campaign: Campaign, *_: object) -> object:
            known[name] = is_registered(campaign)
            return result

        return look

    for name, result in (("pace_rows", []), ("height_rows", []), ("measure_spread_parts", None)):
        monkeypatch.setattr(f"evaluation.mode_campaign.{name}", saw(name, result))

    def shifts(make, params, *_):
        known["sensitivity"] = bool(params.calibration.registrations)
        return []

    monkeypatch.setattr("evaluation.mode_campaign.measure_sensitivity", shifts)
    monkeypatch.setattr("evaluation.mode_campaign._maker", lambda campaign, options: object())
    words = ["--plant", PLANT, "--policies", str(swing_policies), "--throws", "2", "--targets", "6"]
    trainings = ["--trainings", str(swing_policies / "swing-2d")]
    folder = tmp_path / "report"
    assert (
        main(
            ["evaluate", "--mode", "2d", *words, "--report", str(folder), *trainings, "--jobs", "1"]
        )
        == 0
    )
    assert known == dict.fromkeys(
        ("pace_rows", "height_rows", "measure_spread_parts", "sensitivity"), True
    )
    part = json.loads((folder / "report.json").read_text(encoding="utf-8"))["modes"][0]
    assert part["is_registered"] is True
    assert [row["is_registered"] for row in part["trainings"]] == [True]


def test_a_report_needs_no_matplotlib():
    code = "import sys, cli.evaluate; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
