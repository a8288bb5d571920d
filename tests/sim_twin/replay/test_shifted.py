"""Tracks moved by parts of a tick."""

import numpy as np

from sim_twin.replay.motion import shifted
from tests.cases import each

TICKS = np.arange(60.0)


@each("ticks", [-7.0, 0.0, 3.0])
def test_whole_ticks_are_moved_exactly_and_ends_held(ticks: float) -> None:
    track = np.random.default_rng(0).normal(size=(60, 2))
    index = np.clip(TICKS + ticks, 0, 59).astype(int)
    np.testing.assert_array_equal(shifted(track, np.full(2, ticks)), track[index])


def test_cubics_are_met_between_ticks_each_column_by_its_own_way() -> None:
    def cubic(t: np.ndarray) -> np.ndarray:
        return 1.0 - 2.0 * t + 0.3 * t**2 - 0.004 * t**3

    moved = shifted(np.column_stack([cubic(TICKS)] * 2), np.array([0.4, -2.7]))
    np.testing.assert_allclose(moved[1:-2, 0], cubic(TICKS[1:-2] + 0.4), rtol=1e-12, atol=1e-9)
    np.testing.assert_allclose(moved[5:, 1], cubic(TICKS[5:] - 2.7), rtol=1e-12, atol=1e-9)


def test_less_of_a_fast_motion_is_smoothed_away_than_along_straight_lines() -> None:
    wave = np.sin(2 * np.pi * 0.1 * TICKS)
    half = shifted(wave, np.asarray(0.5))[5:-5]
    lines = np.interp(TICKS + 0.5, TICKS, wave)[5:-5]
    true = np.sin(2 * np.pi * 0.1 * (TICKS + 0.5))[5:-5]
    assert np.abs(half - true).max() < 0.3 * np.abs(lines - true).max()
