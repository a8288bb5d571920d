"""Free swings: the friction that a plant of its own planted comes back."""

from pathlib import Path

import numpy as np
import pytest

from diagnosis.alone.diagnose import swing_from_csv
from diagnosis.alone.fit import fit
from diagnosis.alone.reading.free_swings import Swing
from diagnosis.alone.swing import diagnose_swing
from diagnosis.alone.swing_problem import make_problem
from diagnosis.verdict import VerdictKind

STEP_S = 0.001


def swing(
    viscous: float = 0.0,
    coulomb: float = 0.0,
    air: float = 0.0,
    start: float = 0.6,
    frequency: float = 3.0,
    span_s: float = 14.0,
) -> np.ndarray:
    """Angles every millisecond, semi-implicit Euler with true dry friction."""
    angle, rate, rows = start, 0.0, []
    for _ in range(round(span_s / STEP_S)):
        rows.append(angle)
        pull = -(frequency**2) * np.sin(angle) - viscous * rate - air * abs(rate) * rate
        if abs(rate) < 2.0 * coulomb * STEP_S and abs(pull) < coulomb:
            rate = 0.0
        else:
            rate += STEP_S * (pull - coulomb * np.sign(rate))
        angle += STEP_S * rate
    return np.array(rows)


def write(
    path: Path, angle: np.ndarray, rate_hz: float = 50.0, held_s: float = 0.0, offset: float = 0.0
) -> Path:
    rng = np.random.default_rng(2)
    angle = np.concatenate([np.full(round(held_s / STEP_S), angle[0]), angle])
    seen = angle[:: round(1.0 / rate_hz / STEP_S)] + offset
    seen = seen + rng.normal(0.0, 0.002, len(seen))
    rows = np.stack([np.arange(len(seen)) / rate_hz, np.degrees(seen)], axis=1)
    np.savetxt(path, rows, delimiter=";", header="time_s;theta_deg", comments="", fmt="%.6f")
    return path


def test_a_swing_without_loss_needs_no_effect(tmp_path: Path) -> None:
    found = swing_from_csv(write(tmp_path / "a.csv", swing()))
    assert found.verdict is VerdictKind.NONE
    assert found.evidence["frequency_hz"] == pytest.approx(3.0 / (2.0 * np.pi), rel=0.002)
    assert found.evidence["length_of_equal_pendulum_m"] == pytest.approx(9.81 / 9.0, rel=0.004)


def test_a_wide_swing_is_fitted_from_its_beginning_on() -> None:
    """A search over all 60 s of a record left 55 standard deviations of noise, and found 0.35 for 0.3."""
    friction = "passive_coulomb_friction"
    angle = swing(coulomb=0.3, start=np.radians(120.0), frequency=5.0, span_s=30.0)[::20]
    seen = angle + np.random.default_rng(3).normal(0.0, 0.003, len(angle))
    problem = make_problem((Swing(np.arange(len(seen)) / 50.0, seen),), np.nan, 0.003)
    found = fit(problem, tuple(o for o in problem.options if o.key == friction), {})
    assert np.sqrt(found.mean_square) < 1.5 * 0.003
    assert found.as_mapping()[f"{friction}.extra_coulomb_rad_per_s2"] == pytest.approx(
        0.3, rel=0.01
    )


@pytest.mark.parametrize(
    ("friction", "effect", "parameter"),
    [
        ("viscous", "passive_viscous_friction", "extra_viscous_per_s"),
        ("coulomb", "passive_coulomb_friction", "extra_coulomb_rad_per_s2"),
        ("air", "air_drag", "quadratic_per_rad"),
    ],
)
def test_each_friction_is_told_from_the_others(
    tmp_path: Path, friction: str, effect: str, parameter: str
) -> None:
    path = write(tmp_path / "a.csv", swing(**{friction: 0.08}), held_s=1.0, offset=0.3)
    found = swing_from_csv(path, "time_s", "theta_deg")
    assert found.verdict is VerdictKind.EXPLAINED
    assert [e.effect for e in found.causes[0].effects] == [effect]
    fitted = found.causes[0].effects[0].parameters[parameter]
    assert fitted.value == pytest.approx(0.08, rel=0.05)
    assert fitted.ci90[0] <= fitted.value <= fitted.ci90[1]
    assert found.shrink is not None
    assert found.shrink.ratio > 0.9


def test_a_wrong_length_shows_against_a_reference(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", swing(viscous=0.06, span_s=7.0), rate_hz=25.0)
    found = swing_from_csv(path, length_m=0.9)
    named = {e.effect: e for e in found.causes[0].effects}
    assert "gripper_length" in named
    ratio = named["gripper_length"].parameters["extra_length_ratio"].value
    assert 0.9 * (1.0 + ratio) == pytest.approx(9.81 / 9.0, rel=0.01)


def test_a_short_record_does_not_decide_between_two_frictions_by_its_pieces() -> None:
    """Five periods with both: held-out pieces gave viscous friction alone 0.998, all the data give 0.89."""
    t = np.arange(71) / 15.0
    fine = swing(viscous=0.067, coulomb=0.165, start=0.93, frequency=6.95, span_s=5.0)
    angle = fine[np.round(t / STEP_S).astype(int)]
    angle += np.random.default_rng(4).normal(0.0, 0.0034, len(t))
    found = diagnose_swing((Swing(t, angle),))
    assert 0.5 < max(cause.probability for cause in found.causes) < 0.95


def test_a_record_without_a_swing_is_refused(tmp_path: Path) -> None:
    found = swing_from_csv(write(tmp_path / "a.csv", np.full(5000, 0.1)))
    assert found.verdict is VerdictKind.BAD_DATA
    assert "periods of free swing" in found.sentence
