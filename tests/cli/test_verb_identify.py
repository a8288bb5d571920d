"""`downrange record --test` and `downrange identify` from end to end, and what they refuse."""

import json
from pathlib import Path

import pytest

from cli.main import main
from machine.calibration import nominal_calibration
from machine.spec import load_spec
from sim_twin.twin.profile import load_profile, nominal_profile, save_profile


@pytest.fixture(scope="module")
def openings(swing_policies: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """39 openings of the nominal virtual machine, without the staircases of a calibration."""
    out = tmp_path_factory.mktemp("openings")
    valves = tmp_path_factory.mktemp("valves") / "valves.json"
    valves.write_text(nominal_calibration(load_spec()).model_dump_json(), encoding="utf-8")
    words = ["record", "--test", "release", "--plant", "virtual", "--calibration", str(valves)]
    assert main([*words, "--policies", str(swing_policies), "--seed", "3", "--out", str(out)]) == 0
    return out


def test_openings_give_the_machines_delay(
    openings: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    assert len(list(openings.glob("virtual-0-release-s3-*.mcap"))) == 39
    out, plot, profile = (tmp_path / name for name in ("r.json", "r.svg", "next.json"))
    words = ["identify", "release-delay", str(openings), "--json", str(out)]
    assert main([*words, "--plot", str(plot), "--apply", str(profile)]) == 0
    printed = capsys.readouterr().out
    assert "paper: 258 ms, sd 15 ms, 39 releases" in printed
    whole = json.loads(out.read_text(encoding="utf-8"))
    nominal = nominal_profile(load_spec())
    mean = whole["result"]["mean"]
    assert mean["count"] == 39
    assert mean["value"] == pytest.approx(nominal.release_delay_s, abs=0.012)
    assert whole["evidence"]["throws_used"]
    assert plot.stat().st_size > 1000
    after = load_profile(profile)
    assert after.release_delay_s == mean["value"]
    assert after.version_count == 2, "the profile in the logs is version 1"
    assert "release delay identified from 39 logs" in after.note


def test_logs_without_a_swing_write_no_profile(
    openings: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    profile = tmp_path / "next.json"
    few = [str(log) for log in sorted(openings.glob("*.mcap"))[:3]]
    assert main(["identify", "swing", *few, "--apply", str(profile)]) == 0
    printed = capsys.readouterr().out
    assert printed.count("cannot be known from these logs") == 6
    assert "nothing was identified" in printed
    assert not profile.exists()


def test_another_machines_profile_is_said_and_not_refused(
    openings: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    nominal = nominal_profile(load_spec())
    few = [str(log) for log in sorted(openings.glob("*.mcap"))[:3]]
    for machine_id in ("m042", "virtual-0"):
        profile = tmp_path / f"{machine_id}.json"
        save_profile(nominal.model_copy(update={"machine_id": machine_id}), profile)
        assert main(["identify", "swing", *few, "--profile", str(profile)]) == 0
        lines = capsys.readouterr().out.splitlines()
        warnings = [line for line in lines if line.startswith("warning: ")]
        if machine_id == "virtual-0":
            assert warnings == []
        else:
            (warning,) = warnings
            assert "m042.json is the profile of machine 'm042'" in warning
            assert "the logs are of 'virtual-0'" in warning


def test_what_cannot_be_identified_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    for words, why in (
        (["identify", "response"], "give throw logs"),
        (["identify", "response", str(tmp_path)], "none of the logs can be used"),
        (["identify", "swing", str(tmp_path), "--plot", "x.txt"], "must end with"),
        (["record", "--out", str(tmp_path)], "give --mode 2d, 3d or both, or --test"),
    ):
        assert main(words) == 1
        assert why in capsys.readouterr().err
