"""Free swings: friction, length, springs, gyros, disturbed and driven swings, refused records."""

from pathlib import Path

import numpy as np
import pytest

from diagnosis.single_stage.csv_diagnosis import diagnose_swing_csv
from diagnosis.single_stage.swing_diagnosis import diagnose_swing
from diagnosis.tables.free_swings import SwingRecord
from diagnosis.verdict import VerdictKind
from tests.diagnosis.single_stage.synthetic import (
    caught_swing,
    effects,
    join_notes,
    pendulum,
    swing_angles,
    value,
    write,
    write_angles,
)

VISCOUS = ("passive_viscous_friction", "extra_viscous_per_s")


def test_a_swing_without_loss_needs_no_effect(tmp_path: Path) -> None:
    found = diagnose_swing_csv(write_angles(tmp_path / "a.csv", swing_angles()))
    assert found.verdict is VerdictKind.NONE
    assert found.evidence["frequency_hz"] == pytest.approx(3.0 / (2.0 * np.pi), rel=0.002)
    assert found.evidence["length_of_equal_pendulum_m"] == pytest.approx(9.81 / 9.0, rel=0.004)


def test_a_wrong_length_shows_against_a_reference(tmp_path: Path) -> None:
    path = write_angles(tmp_path / "a.csv", swing_angles(viscous=0.06, span_s=7.0), rate_hz=25.0)
    found = diagnose_swing_csv(path, length_m=0.9)
    _, ratio, _ = value(found, "gripper_length", "extra_length_ratio")
    assert 0.9 * (1.0 + ratio) == pytest.approx(9.81 / 9.0, rel=0.01)


def test_a_short_record_does_not_decide_between_two_frictions() -> None:
    t = np.arange(71) / 15.0
    fine = swing_angles(viscous=0.067, coulomb=0.165, start=0.93, frequency=6.95, span_s=5.0)
    angle = fine[np.round(1000.0 * t).astype(int)]
    angle += np.random.default_rng(4).normal(0.0, 0.0034, len(t))
    found = diagnose_swing((SwingRecord(t, angle),))
    assert 0.5 < max(cause.probability for cause in found.causes) < 0.95


def test_a_stopped_swing_has_the_friction_that_acted_before(tmp_path: Path) -> None:
    one = caught_swing(4, coulomb=0.0)
    path = write(tmp_path / "a.csv", {name: one[name] for name in ("t", "angle_rad")})
    found = diagnose_swing_csv(path)
    assert effects(found) == {VISCOUS[0]}
    assert value(found, *VISCOUS)[1] == pytest.approx(0.05, rel=0.03)
    assert "a hand or an obstacle ends it" in join_notes(found)


def test_a_growing_swing_is_unknown(tmp_path: Path) -> None:
    t = np.arange(0.0, 16.0, 0.04)
    angle = 0.1 * np.exp(0.02 * t) * np.cos(4.0 * t)
    angle += np.random.default_rng(6).normal(0.0, 0.002, len(t))
    found = diagnose_swing_csv(write(tmp_path / "a.csv", {"t": t, "angle_rad": angle}))
    assert found.verdict is VerdictKind.UNKNOWN
    assert "energy is fed in" in found.sentence
    assert "used: 0 to 15.96 s" in join_notes(found)


def test_a_clipped_angle_keeps_its_friction(tmp_path: Path) -> None:
    one = pendulum(np.random.default_rng(5), viscous=0.1, noise_rad=0.001)
    limit = 0.75 * float(np.max(np.abs(one["theta_deg"])))
    angle = np.clip(one["theta_deg"], -limit, limit)
    found = diagnose_swing_csv(write(tmp_path / "a.csv", {"t": one["t"], "theta_deg": angle}))
    assert effects(found) == {VISCOUS[0]}
    assert value(found, *VISCOUS)[1] == pytest.approx(0.1, rel=0.02)
    assert "the angle is cut off" in join_notes(found)


def test_unusable_swings_are_refused_with_the_remedy(tmp_path: Path) -> None:
    one = pendulum(np.random.default_rng(6), viscous=0.1, noise_rad=0.001)
    t, rate = one["t"], one["omega_deg_s"]
    limit = 0.75 * float(np.max(np.abs(rate)))
    angles = {"t": t, "theta_deg": one["theta_deg"]}
    mixed_times = angles | {"t": np.where(t > 9.0, 1000.0, 1.0) * t}
    counts = np.round(one["theta_deg"] / 360.0 * 4096.0) + 2000.0
    for columns, length_m, words in (
        ({"t": t, "omega_deg_s": np.clip(rate, -limit, limit)}, None, "range of the gyro"),
        (mixed_times, None, "units of time are mixed"),
        (angles, -1.0, "--length-m"),
        ({"t": t, "counts": counts}, None, "--counts-per-turn"),
        ({"t": t, "theta_rad": np.cos(500.0 * t) * 1e-3 + 0.1}, None, "periods of free swing"),
    ):
        found = diagnose_swing_csv(write(tmp_path / "a.csv", columns), length_m=length_m)
        assert found.verdict is VerdictKind.BAD_DATA, words
        assert words in found.sentence
