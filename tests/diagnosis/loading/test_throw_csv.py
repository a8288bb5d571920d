"""A throw as CSV: the same data as from its MCAP, what may be missing, what is refused."""

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from diagnosis.loading.logs import LoadedSet, load_throws
from diagnosis.loading.throw_csv import throw_csv
from runtime.records.recorder import write_throw_log
from tests.diagnosis.loading.test_logs import make_log


def both(folder: Path, text: str | None = None) -> tuple[LoadedSet, LoadedSet]:
    """The same throw from MCAP and from CSV."""
    log = make_log()
    write_throw_log(folder / "a.mcap", log)
    (folder / "csv").mkdir()
    (folder / "csv" / "a.csv").write_text(throw_csv(log) if text is None else text)
    return load_throws([folder / "a.mcap"]), load_throws([folder / "csv"])


def without(text: str, *words: str) -> str:
    """The file without the columns whose names hold one of the words."""
    lines = text.splitlines()
    start = next(k for k, line in enumerate(lines) if not line.startswith("#"))
    rows = [line.split(",") for line in lines[start:]]
    kept = [k for k, name in enumerate(rows[0]) if not any(word in name for word in words)]
    return "\n".join([*lines[:start], *(",".join(row[k] for k in kept) for row in rows)])


def test_csv_and_mcap_load_alike(tmp_path: Path) -> None:
    (first,), (second,) = (loaded.throws for loaded in both(tmp_path))
    for field in fields(first):
        ours, theirs = getattr(first, field.name), getattr(second, field.name)
        if isinstance(ours, np.ndarray):
            assert ours.shape == theirs.shape, field.name
            np.testing.assert_allclose(theirs, ours, atol=1e-9, err_msg=field.name)
        elif field.name != "path":
            assert theirs == ours, field.name


def test_ball_switch_and_pressure_may_be_missing(tmp_path: Path) -> None:
    lean = without(throw_csv(make_log()), "ball_", "payload", "supply", "requested", "tick")
    _, loaded = both(tmp_path, lean)
    (throw,) = loaded.throws
    assert throw.ball_m.shape == (0, 3)
    assert any("no ball track" in note for note in loaded.evidence()["repairs"][throw.throw_id])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda text: without(text, "gyro_", "accel_", "imu_"), "gyro_x_rad_per_s"),
        (lambda text: without(text, "motion_code"), "motion_code_count"),
        (lambda text: text.replace("# calibration:", "# c:"), "no valve calibration"),
        (lambda text: text.replace("# target: {", "# target: {,"), "holds no JSON"),
        (lambda text: text.replace('"source": "survey"', '"source": "guess"'), "impact"),
        (lambda _: "t,theta\n1,2\n" * 40, "is no whole throw"),
        (lambda _: "", "empty or cut off"),
    ],
)
def test_what_cannot_be_used_is_refused_with_the_reason(
    tmp_path: Path, change: object, words: str
) -> None:
    assert callable(change)
    _, loaded = both(tmp_path, str(change(throw_csv(make_log()))))
    assert loaded.throws == ()
    assert words in loaded.refused[0][1]
