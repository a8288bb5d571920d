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
)

VISCOUS = ("passive_viscous_friction", "extra_viscous_per_s")


def write_angles(
    path: Path, angle: np.ndarray, rate_hz: float = 50.0, held_s: float = 0.0, offset: float = 0.0
) -> Path:
    """A table of angles in degrees; `angle` every millisecond, held at first for `held_s`."""
    angle = np.concatenate([np.full(round(1000.0 * held_s), angle[0]), angle])
    seen = angle[:: round(1000.0 / rate_hz)] + offset
    seen = seen + np.random.default_rng(2).normal(0.0, 0.002, len(seen))
    columns = {"time_s": np.arange(len(seen)) / rate_hz, "theta_deg": np.degrees(seen)}
    return write(path, columns, ";")


def test_a_swing_without_loss_needs_no_effect(tmp_path: Path) -> None:
    found = diagnose_swing_csv(write_angles(tmp_path / "a.csv", swing_angles()))
    assert found.verdict is VerdictKind.NONE
    assert found.evidence["frequency_hz"] == pytest.approx(3.0 / (2.0 * np.pi), rel=0.002)
    assert found.evidence["length_of_equal_pendulum_m"] == pytest.approx(9.81 / 9.0, rel=0.004)


def test_each_friction_is_separated_from_the_others(tmp_path: Path) -> None:
    for friction, effect, parameter in (
        ("viscous", *VISCOUS),
        ("coulomb", "passive_coulomb_friction", "extra_coulomb_rad_per_s2"),
        ("air", "air_drag", "quadratic_per_rad"),
    ):
        angles = swing_angles(**{friction: 0.08})
        path = write_angles(tmp_path / "a.csv", angles, held_s=1.0, offset=0.3)
        found = diagnose_swing_csv(path, "time_s", "theta_deg")
        assert found.verdict is VerdictKind.EXPLAINED, friction
        assert effects(found) == {effect}
        low, fitted, high = value(found, effect, parameter)
        assert fitted == pytest.approx(0.08, rel=0.05)
        assert low <= fitted <= high
        assert found.shrink is not None
        assert found.shrink.ratio > 0.9


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


def test_a_drifting_frequency_is_unknown(tmp_path: Path) -> None:
    t = np.arange(0.0, 30.0, 0.04)
    phase = 4.0 * (t - 0.5 * 0.03 * t**2 / t[-1])
    angle = 0.1 * np.exp(-0.02 * t) * np.cos(phase)
    angle += np.random.default_rng(7).normal(0.0, 0.001, len(t))
    found = diagnose_swing_csv(write(tmp_path / "a.csv", {"t": t, "angle_rad": angle}))
    assert found.verdict is VerdictKind.UNKNOWN
    assert "The frequency changes by -2.0%" in found.sentence


def test_a_mass_on_a_spring_and_a_torsion_wire_are_not_pendulums(tmp_path: Path) -> None:
    t = np.arange(0.0, 8.0, 1.0 / 25.0)
    x = 120.0 + 45.0 * np.exp(-0.075 * t) * np.cos(6.0 * t)
    x += np.random.default_rng(2).normal(0.0, 0.2, len(t))
    found = diagnose_swing_csv(write(tmp_path / "a.csv", {"Time (s)": t, "Position (mm)": x}))
    assert effects(found) == {VISCOUS[0]}
    assert value(found, *VISCOUS)[1] == pytest.approx(0.15, rel=0.02)
    # The period of a torsion wire does not depend on its amplitude.
    path = write(tmp_path / "b.csv", {"t": t, "angle_rad": (x - 120.0) / 56.0})
    found = diagnose_swing_csv(path, angle="angle_rad")
    assert "spring or a torsion wire" in join_notes(found)
    assert effects(found) == {VISCOUS[0]}


def test_gyros_bobs_and_encoders_give_the_same_friction(tmp_path: Path) -> None:
    one = pendulum(np.random.default_rng(3), viscous=0.1, noise_rad=0.001)
    rate = np.concatenate([np.zeros(80), np.radians(one["omega_deg_s"][:500])])
    rng = np.random.default_rng(4)
    gyro = {"Time (s)": np.arange(len(rate)) * 0.02}
    for axis, share in zip("xyz", (0.36, 0.8, 0.48), strict=True):
        seen = share * rate + rng.normal(0.0, 0.003, len(rate)) + 0.005
        gyro[f"Gyroscope {axis} (rad/s)"] = seen
    one = pendulum(np.random.default_rng(5), viscous=0.1, noise_rad=0.0, rate_hz=30.0)
    one = {name: column[:300] for name, column in one.items()}
    angle = np.radians(one["theta_deg"])
    rng = np.random.default_rng(6)
    bob = {"t": one["t"], "x": 0.4 + 1.2 * np.sin(angle), "y": 1.5 - 1.2 * np.cos(angle)}
    bob["x"] += rng.normal(0.0, 0.002, len(angle))
    bob["y"] += rng.normal(0.0, 0.002, len(angle))
    encoder = {
        "t": one["t"],
        "encoder_counts": np.round(angle / (2.0 * np.pi) * 4096.0) % 4096.0,
    }
    for columns in (gyro, bob, encoder):
        found = diagnose_swing_csv(write(tmp_path / "a.csv", columns))
        assert value(found, *VISCOUS)[1] == pytest.approx(0.1, rel=0.05), list(columns)
        if columns is gyro:
            assert "0.36, 0.80, 0.48" in join_notes(found)


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
