"""Throws of an independent plant, read from CSV and judged without reference throws."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.other_plant import Variant, throws
from diagnosis.loading.measured import white_noise_sd


def test_25_rows_a_second_are_enough(tmp_path: Path) -> None:
    """Time stamps in ns make 24.9999 Hz of them."""
    loaded = throws(tmp_path, Variant(row_ticks=4), 3)
    assert len(loaded.throws) == 3, loaded.refused


def test_noise_is_separated_from_motion(tmp_path: Path) -> None:
    for ratio in (1.0, 4.0):
        loaded = throws(tmp_path / str(ratio), Variant(noise_ratio=ratio), 3)
        shown = [white_noise_sd(throw.sensor_velocity_rad_m_per_s) for throw in loaded.throws]
        assert float(np.median(shown)) == pytest.approx(ratio * 5e-3, rel=0.15)
