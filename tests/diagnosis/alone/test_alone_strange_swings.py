"""Free swings as strangers record them: springs, phones, films, encoders."""

from pathlib import Path

import numpy as np
import pytest

from diagnosis.alone.diagnose import swing_from_csv
from tests.diagnosis.alone.answers import notes_of, value
from tests.diagnosis.alone.planted import pendulum, write


def test_a_mass_on_a_spring_is_no_pendulum(tmp_path: Path) -> None:
    t = np.arange(0.0, 10.0, 1.0 / 30.0)
    x = 120.0 + 45.0 * np.exp(-0.075 * t) * np.cos(6.0 * t)
    x += np.random.default_rng(2).normal(0.0, 0.2, len(t))
    found = swing_from_csv(write(tmp_path / "a.csv", {"Time (s)": t, "Position (mm)": x}))
    assert {e.effect for e in found.causes[0].effects} == {"passive_viscous_friction"}
    assert value(found, "passive_viscous_friction", "extra_viscous_per_s")[1] == pytest.approx(
        0.15, rel=0.02
    )
    # A torsion wire swings far, and its period does not depend on how far.
    found = swing_from_csv(
        write(tmp_path / "b.csv", {"t": t, "angle_rad": (x - 120.0) / 45.0}), angle="angle_rad"
    )
    assert "spring or a torsion wire" in notes_of(found)
    assert {e.effect for e in found.causes[0].effects} == {"passive_viscous_friction"}


def test_a_phone_mounted_askew_and_held_at_first(tmp_path: Path) -> None:
    one = pendulum(np.random.default_rng(3), viscous=0.1, noise_rad=0.001)
    rate = np.concatenate([np.zeros(80), np.radians(one["omega_deg_s"])])
    rng = np.random.default_rng(4)
    columns = {"Time (s)": np.arange(len(rate)) * 0.02}
    for axis, share in zip("xyz", (0.36, 0.8, 0.48), strict=True):
        seen = share * rate + rng.normal(0.0, 0.003, len(rate)) + 0.005
        columns[f"Gyroscope {axis} (rad/s)"] = seen
    found = swing_from_csv(write(tmp_path / "a.csv", columns))
    assert "0.36, 0.80, 0.48" in notes_of(found)
    low, viscous, high = value(found, "passive_viscous_friction", "extra_viscous_per_s")
    assert viscous == pytest.approx(0.1, rel=0.03)
    assert low < 0.1 < high


def test_a_tracked_bob_and_counts_of_an_encoder(tmp_path: Path) -> None:
    one = pendulum(np.random.default_rng(5), viscous=0.1, noise_rad=0.0, rate_hz=30.0)
    one = {name: column[:300] for name, column in one.items()}
    angle = np.radians(one["theta_deg"])
    rng = np.random.default_rng(6)
    bob = {"t": one["t"], "x": 0.4 + 1.2 * np.sin(angle), "y": 1.5 - 1.2 * np.cos(angle)}
    bob["x"] += rng.normal(0.0, 0.002, len(angle))
    bob["y"] += rng.normal(0.0, 0.002, len(angle))
    counts = np.round(angle / (2.0 * np.pi) * 4096.0) % 4096.0
    for columns in (bob, {"t": one["t"], "encoder_counts": counts}):
        found = swing_from_csv(write(tmp_path / "a.csv", columns))
        assert value(found, "passive_viscous_friction", "extra_viscous_per_s")[1] == pytest.approx(
            0.1, rel=0.05
        )
    straight = {"t": one["t"], "counts": np.round(angle / (2.0 * np.pi) * 4096.0) + 2000.0}
    assert "--counts-per-turn" in swing_from_csv(write(tmp_path / "b.csv", straight)).sentence
