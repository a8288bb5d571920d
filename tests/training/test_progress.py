"""What a run writes about itself survives a kill and stays readable."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.cases import each
from training.measure import Accuracy
from training.ppo import IterationMetrics
from training.progress import (
    CSV_FILE,
    ProgressRow,
    append_rows,
    keep_rows,
    plot_curve,
    progress_line,
    progress_rows,
    read_rows,
    write_summary,
)


def _rows(first: int, count: int, landed: float = 8.0) -> list[ProgressRow]:
    """Rows of `count` iterations: 10 episodes each, of which `landed` land 0.5 m off."""
    one = np.ones(count)
    metrics = IterationMetrics(
        reward=-640.0 * one,
        done=10.0 * one,
        landed=landed * one,
        failure=np.tile([0.0, 0.0, 10.0 - landed, 0.0, 0.0, 0.0], (count, 1)),
        miss=0.5 * landed * one,
        miss_squared=0.25 * landed * one,
        within_quarter=0.25 * landed * one,
        duration=20.0 * one,
        learning_rate=1e-3 * one,
        divergence=0.01 * one,
        entropy=one,
        value_loss=one,
        deviation=one,
    )
    return progress_rows(metrics, first, 1280, (10.0, 10.0 + count))


def test_rows_are_rates_and_moments():
    row = _rows(20, 3)[-1]
    assert (row.iteration_count, row.environment_step_count, row.wall_s) == (23, 23 * 1280, 13.0)
    assert row.reward_ratio == pytest.approx(-0.5)
    assert (row.landed_ratio, row.collision_ratio, row.swing_ratio) == (0.8, 0.2, 0.0)
    assert (row.miss_mean_m, row.miss_rms_m, row.within_quarter_ratio) == (0.5, 0.5, 0.25)
    assert row.duration_s == 2.0
    assert "landed  80.0 %  miss 0.500 m" in progress_line(row, 100)


def test_an_iteration_without_a_landing_has_no_miss(tmp_path: Path):
    rows = _rows(0, 2, landed=0.0)
    assert np.isnan(rows[0].miss_mean_m)
    assert "miss -  " in progress_line(rows[0], 2)
    append_rows(tmp_path / CSV_FILE, rows)
    assert np.isnan(read_rows(tmp_path / CSV_FILE)[1].miss_rms_m)
    plot_curve(tmp_path / "curve.png", rows, "nothing landed")
    nothing = Accuracy(7.0, 4, 0, *[float("nan")] * 4, duration_s=7.0, failure_count={"limit": 4})
    write_summary(tmp_path / "metrics.json", rows, [nothing])

    def refuse(word: str) -> None:
        raise AssertionError(f"{word} is no JSON")

    text = (tmp_path / "metrics.json").read_text(encoding="utf-8")
    content = json.loads(text, parse_constant=refuse)
    assert content["last"]["miss_mean_m"] is None
    assert content["accuracy"][0]["downrange_sd_m"] is None


def test_rows_beyond_the_checkpoint_are_dropped_and_written_again(tmp_path: Path):
    path = tmp_path / CSV_FILE
    assert keep_rows(path, 0) == []
    append_rows(path, _rows(0, 6))
    kept = keep_rows(path, 4)
    assert [row.iteration_count for row in kept] == [1, 2, 3, 4]
    again = [replace(row, reward_ratio=7.0) for row in _rows(4, 4)]
    append_rows(path, again)
    assert read_rows(path) == [*kept, *again]
    assert sorted(p.name for p in tmp_path.iterdir()) == [CSV_FILE]


@each("lost", [1, 2, 20, 80], copied="tmp_path")
def test_half_a_last_line_is_not_read(tmp_path: Path, lost: int):
    path = tmp_path / CSV_FILE
    append_rows(path, _rows(0, 3))
    path.write_bytes(path.read_bytes()[:-lost])
    whole = keep_rows(path, 3)
    assert [row.iteration_count for row in whole] == [1, 2]
    append_rows(path, _rows(2, 1))
    assert [row.iteration_count for row in read_rows(path)] == [1, 2, 3]
