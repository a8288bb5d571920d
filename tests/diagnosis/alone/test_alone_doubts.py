"""Verdicts that say their own doubts: none as a rival, gains that do not show, a camera for wind."""

from pathlib import Path

import numpy as np
import pytest

from diagnosis.alone.diagnose import flight_from_csv
from diagnosis.verdict import VerdictKind
from tests.diagnosis.alone.answers import effects
from tests.diagnosis.alone.planted import ball, joined, write


def test_drag_that_held_out_data_do_not_show_is_not_explained(tmp_path: Path) -> None:
    """A webcam's short drops: drag is the best set in some, and never sure."""
    doubts = 0
    for seed in range(12):
        one = ball(np.random.default_rng(seed), 0.03, is_drop=True, rate_hz=25.0, noise_m=0.025)
        path = write(tmp_path / "a.csv", {"t": one["t"][:22], "z": one["z"][:22]})
        found = flight_from_csv(path)
        none = next(cause.probability for cause in found.causes if cause.name == "none")
        if found.verdict is VerdictKind.EXPLAINED:
            assert none < 0.25 * found.causes[0].probability
            assert found.shrink is not None
            assert found.shrink.ci90[0] >= 0.01
        elif found.verdict is VerdictKind.AMBIGUOUS:
            doubts += 1
            assert "may as well be" in found.sentence
    assert doubts > 0


def rolled(roll_rad: float, wind: float, directions: tuple[float, ...]) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(4)
    throws = []
    for direction in directions:
        one = ball(rng, 0.04, (direction * wind, 0.0), tilt_rad=direction * roll_rad, noise_m=0.003)
        throws.append({"t": one["t"], "x": direction * one["x"], "z": one["z"]})
    return joined(throws, throw=[str(k) for k in range(len(throws))])


def test_a_rolled_camera_is_named_beside_wind(tmp_path: Path) -> None:
    columns = rolled(0.045, 0.0, (1.0, 1.0, 1.0))
    found = flight_from_csv(write(tmp_path / "a.csv", columns), group=None)
    assert "wind" in effects(found)
    words = found.sentence.split("rolled by ")[1]
    assert float(words.split()[0]) == pytest.approx(np.degrees(0.045), abs=0.5)


def test_wind_along_and_against_two_throws_is_no_rolled_camera(tmp_path: Path) -> None:
    columns = rolled(0.0, 3.0, (1.0, -1.0, 1.0, -1.0))
    found = flight_from_csv(write(tmp_path / "a.csv", columns))
    assert effects(found) == {"air_drag", "wind"}
    assert "rolled" not in found.sentence
