import json
from pathlib import Path
from typing import Any

import pytest

from cli.main import main
from tests.cases import each


def result(policy: str, sd_m: float, landed: int = 200) -> dict[str, Any]:
    row = {
        "range_m": 9.0, "height_m": 0.0, "throws": 200, "landed": landed,
        "success_ratio": landed / 200, "mean_downrange_error_m": 0.01, "sd_downrange_m": sd_m,
        "mean_crossrange_error_m": 0.0, "sd_crossrange_m": 0.03,
    }  # fmt: skip
    return {
        "mode": "2d", "plant": "virtual", "policy": policy, "is_registered": True, "seed": 0,
        "seconds": 1.0, "real_time_factor": 9.0, "targets": [row],
    }  # fmt: skip


def compare(folder: Path, first: object, second: object) -> int:
    files = folder / "a.json", folder / "b.json"
    for file, content in zip(files, (first, second), strict=True):
        file.write_text(json.dumps(content), encoding="utf-8")
    return main(["policy", "compare", "--a", str(files[0]), "--b", str(files[1])])


def test_compare_says_which_version_is_better(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert compare(tmp_path, result("old", 0.10), result("new", 0.05)) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "new beside old: 2d on virtual"
    assert next(line for line in lines if "sd down" in line).endswith("better")
    assert next(line for line in lines if "sd cross" in line).endswith(
        "cannot tell from 200 and 200 throws"
    )


@each(
    ("second", "words"),
    [
        ({"mode": "2d"}, "b.json is no result of `downrange evaluate --json`"),
        (result("new", 0.05, landed=201), "more landed than were thrown"),
    ],
)
def test_compare_refuses_other_files(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], second: object, words: str
) -> None:
    assert compare(tmp_path, result("old", 0.1), second) == 1
    assert words in capsys.readouterr().err


def test_compare_names_a_missing_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = str(tmp_path / "none.json")
    assert main(["policy", "compare", "--a", path, "--b", path]) == 1
    assert f"cannot read {path}" in capsys.readouterr().err
