import json
from pathlib import Path

import pytest

from cli.main import main
from cli.preview import parse_target
from machine.errors import UsageError


def test_targets_are_forward_and_left() -> None:
    target = parse_target("9,-1.5", 0.5)
    assert (target.x_m, target.y_m, target.z_m) == (9.0, -1.5, 0.5)
    assert parse_target("9").y_m == 0.0


BAD_TARGETS = (
    ("", "no number"),
    ("9;1", "no number"),
    ("9,1,0", "3 numbers"),
    ("nan", "not finite"),
    ("9,inf", "not finite"),
    ("900", "within 60 m"),
)


def test_bad_targets_say_what_is_wrong() -> None:
    for text, words in BAD_TARGETS:
        with pytest.raises(UsageError, match=words):
            parse_target(text)


def preview(policies: Path, *more: str) -> int:
    return main(["preview", "--mode", "2d", "--policies", str(policies), *more])


def test_json_has_its_keys(swing_policies: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert preview(swing_policies, "--target", "6", "--rollouts", "6", "--json") == 0
    shown = json.loads(capsys.readouterr().out)
    assert set(shown) == {"impact", "ellipse", "seconds", "lands_on", "refused"}
    assert shown["impact"]["x_m"] == pytest.approx(6.0, abs=0.5)
    assert shown["ellipse"]["rollout_count"] == 6
    assert shown["refused"] == []


def test_words_for_people(swing_policies: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert preview(swing_policies, "--target", "6,0.5", "--rollouts", "0", "--slew", "0.3") == 0
    text = capsys.readouterr().out
    assert "impact on ground at x" in text
    assert "gripper to ground" in text


def test_a_refused_throw_ends_with_code_2_and_its_reasons(
    swing_policies: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert preview(swing_policies, "--target", "30", "--json") == 2
    shown = json.loads(capsys.readouterr().out)
    assert shown["impact"] is None
    assert shown["ellipse"] is None
    assert "reaches 10.90 m" in shown["refused"][0]


BAD_OPTIONS = (
    (["--target", "x"], "no number"),
    (["--target", "6", "--rollouts", "-1"], "0 or more"),
    (["--target", "6", "--slew", "nan"], "finite"),
    (["--target", "6", "--profile", "/nowhere.json"], "twin profile"),
)


def test_what_cannot_work_is_one_clear_line(
    swing_policies: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for options, words in BAD_OPTIONS:
        assert preview(swing_policies, *options) == 1, options
        error = capsys.readouterr().err
        assert words in error
        assert error.startswith("downrange preview: ")


def test_help_explains_itself_to_a_newcomer(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["preview", "--help"])
    text = capsys.readouterr().out
    for word in ("--target", "--rollouts", "R or R,C", "Exit code"):
        assert word in text


def test_a_site_is_read_from_a_file(
    swing_policies: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bed = {"name": "bed", "kind": "box", "x_m": 5.9, "y_m": 0.0, "length_m": 1.6, "width_m": 3.0}
    (tmp_path / "site.json").write_text(json.dumps([bed | {"height_m": 0.4}]), encoding="utf-8")
    (tmp_path / "flat.json").write_text(json.dumps([bed | {"height_m": 0.0}]), encoding="utf-8")
    wish = ("--target", "5.95", "--height", "0.4", "--rollouts", "0", "--json", "--site")
    assert preview(swing_policies, *wish, str(tmp_path / "site.json")) == 0
    assert json.loads(capsys.readouterr().out)["lands_on"] == "bed"
    assert preview(swing_policies, *wish, str(tmp_path / "flat.json")) == 1
    assert "0.height_m" in capsys.readouterr().err
