import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cli.main import main
from evaluation.campaigns import parse_targets
from machine.errors import UsageError

KEYS = {
    "mode",
    "plant",
    "policy",
    "is_registered",
    "seed",
    "seconds",
    "real_time_factor",
    "targets",
}
TARGET_KEYS = {
    "range_m",
    "height_m",
    "throws",
    "landed",
    "success_ratio",
    "mean_downrange_error_m",
    "sd_downrange_m",
    "mean_crossrange_error_m",
    "sd_crossrange_m",
}


@given(
    first=st.floats(1.0, 20.0).map(lambda v: round(v, 2)),
    steps=st.integers(0, 30),
    step=st.floats(0.05, 1.0).map(lambda v: round(v, 2)),
)
def test_a_range_of_targets_holds_both_ends(first: float, steps: int, step: float) -> None:
    last = round(first + steps * step, 6)
    targets = parse_targets(f"{first}:{last}:{step}")
    assert len(targets) == steps + 1
    assert targets[0] == first
    assert targets[-1] == pytest.approx(last)


def test_a_list_of_targets_keeps_its_order() -> None:
    assert parse_targets("9,7.5") == (9.0, 7.5)
    assert parse_targets("9") == (9.0,)


BAD_TARGETS = (
    ("", "no number"),
    ("nine", "no number"),
    ("7:8", "2 parts"),
    ("7:8:0.5:1", "4 parts"),
    ("8:7:0.5", "from 8 m to 7 m"),
    ("7:8:0", "steps of 0 m"),
    ("7:8:-1", "steps of -1 m"),
    ("7:nan:1", "not finite"),
    ("inf", "not finite"),
    ("-3", "between 0 and 60"),
    ("7:8:0.0001", "10001 targets"),
)


def test_bad_targets_say_what_is_wrong_and_what_is_right() -> None:
    for text, words in BAD_TARGETS:
        with pytest.raises(UsageError, match=words) as error:
            parse_targets(text)
        assert "--targets" in str(error.value), text


def evaluate(policies: Path, *more: str) -> int:
    return main(["evaluate", "--mode", "2d", "--policies", str(policies), "--throws", "3", *more])


def test_the_result_has_its_keys_and_repeats(
    swing_policies: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    reports = []
    for name in ("a", "b"):
        path = tmp_path / f"{name}.json"
        code = evaluate(
            swing_policies,
            "--targets",
            "6:6.5:0.5",
            "--seed",
            "4",
            "--json",
            str(path),
            "--plot",
            str(tmp_path / f"{name}.png"),
        )
        assert code == 0
        reports.append(json.loads(path.read_text()))
    report = reports[0]
    assert set(report) == KEYS
    assert (report["mode"], report["plant"], report["seed"]) == ("2d", "twin", 4)
    assert report["policy"] == "swing-2d"
    assert report["seconds"] > 0.0
    assert report["real_time_factor"] > 0.0
    assert [t["range_m"] for t in report["targets"]] == [6.0, 6.5]
    for target in report["targets"]:
        assert set(target) == TARGET_KEYS
        assert target["throws"] == 3
        assert target["success_ratio"] == pytest.approx(target["landed"] / 3)
    assert report["targets"] == reports[1]["targets"]
    output = capsys.readouterr()
    assert "range/m  height/m  throws  landed" in output.out
    assert "evaluate: 6 of 6 throws" in output.err
    assert (tmp_path / "a.png").stat().st_size > 10_000


BAD_OPTIONS = (
    (["--targets", "7:x"], "no number"),
    (["--targets", "20"], "Refused: target 20.00 m"),
    (["--heights", "high"], "--heights 'high'"),
    (["--heights", "0,11"], "each -5 to 10"),
    (["--heights", "2"], "Refused: target height"),
    (["--pace", "1.2"], "pace 1.2: it lies between"),
    (["--heights", "0,0.5", "--plot", "x.png"], "--plot draws one height"),
    (["--targets", "6", "--plant", "gazebo"], "no plant 'gazebo'"),
    (["--targets", "6", "--seed", "-1"], "seeds are 0 or more"),
    (["--targets", "6", "--unit-seed", "2"], "no unit 2"),
    (["--targets", "6", "--plot", "/nowhere/plot.png"], "folder /nowhere does not exist"),
    (["--targets", "6", "--json", "/nowhere/a.json"], "folder /nowhere does not exist"),
    (["--targets", "6", "--plot", "plot.bmp"], ".png"),
    (["--targets", "6", "--calibration", "/nowhere.json"], "downrange calibrate"),
    (["--targets", "6", "--profile", "/nowhere.json"], "twin profile"),
)


def test_what_cannot_work_is_one_clear_line(
    swing_policies: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for options, words in BAD_OPTIONS:
        assert evaluate(swing_policies, *options) == 1, options
        error = capsys.readouterr().err
        assert words in error
        assert error.startswith("downrange evaluate: ")
        assert "Traceback" not in error


def test_no_throws_and_missing_policies(
    swing_policies: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert evaluate(swing_policies, "--throws", "0") == 1
    assert evaluate(tmp_path) == 1
    assert main(["evaluate", "--mode", "2d", "--policy", str(swing_policies / "swing-3d")]) == 1
    error = capsys.readouterr().err
    assert "at least 1 throw" in error
    assert "active.json" in error
    assert "throws in 3d, --mode is 2d" in error


def test_help_explains_itself_to_a_newcomer(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["evaluate", "--help"])
    assert end.value.code == 0
    text = capsys.readouterr().out
    for word in ("--targets", "--unit-seed", "FIRST:LAST:STEP", "package.module:Class", "Example"):
        assert word in text
