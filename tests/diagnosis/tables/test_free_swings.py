"""The free part of swing records: disturbances, rest, growth, held starts, noise, clipping."""

import numpy as np
import pytest

from diagnosis.tables.consistency import find_clipping
from diagnosis.tables.free_swings import (
    SwingRecord,
    estimate_swing_noise,
    extract_free_swing,
    swing_from_rate,
)
from tests.diagnosis.single_stage.exact_pendulum import STOPPED, exact_angles, stopped_swing
from tests.diagnosis.single_stage.synthetic import CAUGHT_S, caught_swing, pendulum


def test_a_swing_ends_where_a_hand_stops_it() -> None:
    for seed in (1, 2, 3):
        one = caught_swing(seed)
        from_angle = SwingRecord(one["t"], one["angle_rad"])
        for swing in (from_angle, swing_from_rate(one["t"], one["rate"])):
            free = extract_free_swing(swing, 0.002)
            assert free is not None
            assert free.end_reason == "then a hand or an obstacle ends it"
            until_s = free.start_s + free.time_s[-1]
            assert CAUGHT_S - 3.0 < until_s <= CAUGHT_S


def test_a_swing_ends_where_dry_friction_stops_it() -> None:
    swing = stopped_swing(0.002)
    angles = exact_angles(*STOPPED, swing.time_s)
    rests_s = float(swing.time_s[np.argmax(np.abs(np.diff(angles)) == 0.0)])
    free = extract_free_swing(swing, estimate_swing_noise([swing]))
    assert free is not None
    assert free.time_s[-1] == pytest.approx(rests_s, abs=2.6)  # one period


def test_rates_after_dry_friction_has_stopped_the_body_are_not_integrated() -> None:
    one = pendulum(np.random.default_rng(5), viscous=0.05, coulomb=0.35, noise_rad=0.003)
    rate = np.radians(one["omega_deg_s"])
    moving_s = one["t"][np.flatnonzero(np.abs(rate - np.median(rate[-200:])) > 0.06)[-1]]
    assert moving_s < 16.0
    swing = swing_from_rate(one["t"], rate)
    assert moving_s - 1.0 < swing.start_s + swing.time_s[-1] < moving_s + 2.0


def test_a_swing_that_was_pumped_up_and_released_is_free() -> None:
    t = np.arange(0.0, 40.0, 0.02)
    size = np.where(t < 10.0, 0.05 * t, 0.5 * np.exp(-0.04 * (t - 10.0)))
    free = extract_free_swing(SwingRecord(t, size * np.cos(4.0 * t)), 1e-4)
    assert free is not None
    assert free.energy_input is None
    assert 9.5 < free.start_s < 13.0


def test_a_held_body_is_not_free_in_spite_of_noise() -> None:
    t = np.arange(0.0, 20.0, 0.01)
    angle = np.concatenate([np.full(100, 0.12), exact_angles(3.0, 0.05, 0.0, 0.12, t)])
    angle += np.random.default_rng(5).normal(0.0, 0.008, len(angle))
    free = extract_free_swing(SwingRecord(np.arange(len(angle)) * 0.01, angle), 0.008)
    assert free is not None
    # From 0.9 of the amplitude the first zero follows within 64 degrees of a period of 2.1 s.
    crossed_s = float(free.time_s[np.argmax(free.angle_rad < 0.0)])
    assert 0.25 < crossed_s < 0.55


def test_the_noise_of_a_slowly_sampled_swing_is_not_overestimated() -> None:
    t = np.arange(0.0, 20.0, 1.0 / 15.0)
    noisy = 0.9 * np.cos(7.0 * t) + np.random.default_rng(1).normal(0.0, 0.003, len(t))
    assert estimate_swing_noise([SwingRecord(t, noisy)]) == pytest.approx(0.003, rel=0.25)


def test_quantisation_is_not_clipping() -> None:
    angle = np.cos(np.arange(0.0, 60.0, 0.01))
    assert not np.any(find_clipping(np.round(angle / 0.05) * 0.05))
    assert np.any(find_clipping(np.round(np.clip(angle, -0.7, 0.7) / 0.05) * 0.05))
