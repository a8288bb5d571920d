"""Swings that a hand or dry friction ends within the record, and swings that something keeps going."""

from pathlib import Path

import numpy as np
import pytest

from diagnosis.alone.diagnose import swing_from_csv
from diagnosis.alone.reading.free_swings import Swing, free_part, swing_of_rate
from diagnosis.verdict import VerdictKind
from tests.diagnosis.alone.answers import effects, notes_of, value
from tests.diagnosis.alone.planted import pendulum, write

CAUGHT_S = 14.03


def caught(seed: int, coulomb: float = 0.03) -> dict[str, np.ndarray]:
    """A swing with viscous and dry friction that a hand stops within 0.1 s, and its rate in rad/s."""
    one = pendulum(np.random.default_rng(seed), viscous=0.05, coulomb=coulomb, noise_rad=0.0)
    t, angle = one["t"], np.radians(one["theta_deg"])
    held = t > CAUGHT_S
    angle = angle - np.mean(angle[:-1])
    angle[held] = angle[np.argmax(held)] * np.exp(-(t[held] - CAUGHT_S) / 0.1)
    rng = np.random.default_rng(seed)
    rate = np.gradient(angle, t) + rng.normal(0.0, 0.004, len(t)) + 0.01
    return {"t": t, "angle_rad": angle + rng.normal(0.0, 0.002, len(t)), "rate": rate}


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("is_rate", [False, True])
def test_what_a_hand_does_at_the_end_is_left_out(seed: int, is_rate: bool) -> None:
    one = caught(seed)
    swing = Swing(one["t"], one["angle_rad"])
    if is_rate:
        swing = swing_of_rate(one["t"], one["rate"])
    free = free_part(swing, 0.002)
    assert free is not None
    assert free.end == "then a hand or an obstacle ends it"
    until_s = free.since_s + free.time_s[-1]
    assert CAUGHT_S - 3.0 < until_s <= CAUGHT_S


def test_a_caught_swing_has_the_frictions_that_acted_before(tmp_path: Path) -> None:
    one = caught(4, coulomb=0.0)
    path = write(tmp_path / "a.csv", {name: one[name] for name in ("t", "angle_rad")})
    found = swing_from_csv(path)
    assert effects(found) == {"passive_viscous_friction"}
    _, viscous, _ = value(found, "passive_viscous_friction", "extra_viscous_per_s")
    assert viscous == pytest.approx(0.05, rel=0.03)
    assert "a hand or an obstacle ends it" in notes_of(found)


def test_rest_after_dry_friction_is_no_motion_of_a_gyro() -> None:
    one = pendulum(np.random.default_rng(5), viscous=0.05, coulomb=0.35, noise_rad=0.003)
    rate = np.radians(one["omega_deg_s"])
    moving_s = one["t"][np.flatnonzero(np.abs(rate - np.median(rate[-200:])) > 0.06)[-1]]
    assert moving_s < 16.0
    swing = swing_of_rate(one["t"], rate)
    assert moving_s - 1.0 < swing.since_s + swing.time_s[-1] < moving_s + 2.0


def test_a_swing_that_grows_is_unknown(tmp_path: Path) -> None:
    t = np.arange(0.0, 30.0, 0.04)
    angle = 0.1 * np.exp(0.02 * t) * np.cos(4.0 * t)
    angle += np.random.default_rng(6).normal(0.0, 0.002, len(t))
    found = swing_from_csv(write(tmp_path / "a.csv", {"t": t, "angle_rad": angle}))
    assert found.verdict is VerdictKind.UNKNOWN
    assert "energy is fed in" in found.sentence
    assert "used: 0 to 29.96 s" in notes_of(found)


def test_a_swing_that_was_pumped_up_and_let_go_is_free() -> None:
    t = np.arange(0.0, 40.0, 0.02)
    size = np.where(t < 10.0, 0.05 * t, 0.5 * np.exp(-0.04 * (t - 10.0)))
    free = free_part(Swing(t, size * np.cos(4.0 * t)), 1e-4)
    assert free is not None
    assert free.fed is None
    assert 9.5 < free.since_s < 13.0


@pytest.mark.parametrize("drift", [0.0, -0.03])
def test_a_frequency_that_drifts_is_unknown_and_said(tmp_path: Path, drift: float) -> None:
    t = np.arange(0.0, 30.0, 0.04)
    phase = 4.0 * (t + 0.5 * drift * t**2 / t[-1])
    angle = 0.1 * np.exp(-0.02 * t) * np.cos(phase)
    angle += np.random.default_rng(7).normal(0.0, 0.001, len(t))
    found = swing_from_csv(write(tmp_path / "a.csv", {"t": t, "angle_rad": angle}))
    assert (found.verdict is VerdictKind.UNKNOWN) == (drift != 0.0)
    assert ("The frequency changes by -2.0%" in found.sentence) == (drift != 0.0)
