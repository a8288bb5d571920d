"""Free swings: friction, length, springs, gyros, disturbed and driven swings, refused records."""

from pathlib import Path

import numpy as np
import pytest

from diagnosis.single_stage.csv_diagnosis import diagnose_swing_csv
from diagnosis.verdict import VerdictKind
from tests.diagnosis.single_stage.synthetic import (
    pendulum,
    swing_angles,
    write,
    write_angles,
)

VISCOUS = ("passive_viscous_friction", "extra_viscous_per_s")


def test_a_swing_without_loss_needs_no_effect(tmp_path: Path) -> None:
    found = diagnose_swing_csv(write_angles(tmp_path / "a.csv", swing_angles()))
    assert found.verdict is VerdictKind.NONE
    assert found.evidence["frequency_hz"] == pytest.approx(3.0 / (2.0 * np.pi), rel=0.002)
    assert found.evidence["length_of_equal_pendulum_m"] == pytest.approx(9.81 / 9.0, rel=0.004)


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
