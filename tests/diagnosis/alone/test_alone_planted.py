"""Planted effects and nulls over seeds: verdicts, coverage, false alarms; short here, long by hand.

`python -m tests.diagnosis.alone.test_alone_planted 40` runs every maker over 40 seeds and prints the counts.
"""

import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest

from diagnosis.alone.diagnose import actuation_from_csv, flight_from_csv, swing_from_csv
from diagnosis.verdict import Diagnosis, VerdictKind
from tests.diagnosis.alone.planted import Columns, joint, pendulum, throws, write

Truth = Mapping[str, tuple[str, float]]
"""By effect: a parameter and its planted value."""
VISCOUS = "passive_viscous_friction"
COULOMB = "passive_coulomb_friction"
EXCAVATOR: Truth = {
    "valve_dead_time": ("extra_dead_time_s", 0.15),
    "valve_lag": ("extra_lag_s", 0.2),
    "valve_dead_band": ("positive_ratio", 0.12),
}


def _swing(columns: Columns, folder: Path) -> Diagnosis:
    return swing_from_csv(write(folder / "a.csv", columns), "t", "theta_deg")


def _joint(columns: Columns, folder: Path) -> Diagnosis:
    return actuation_from_csv(write(folder / "a.csv", columns), "stamp_ms", "lever_pct", "boom_deg")


def _joint_speed(columns: Columns, folder: Path) -> Diagnosis:
    path = write(folder / "a.csv", columns)
    return actuation_from_csv(path, "stamp_ms", "lever_pct", velocity="boom_rate_deg_s")


def _throws(columns: Columns, folder: Path) -> Diagnosis:
    return flight_from_csv(write(folder / "a.csv", columns), "t", ["x", "y", "z"])


def _film(columns: Columns, folder: Path) -> Diagnosis:
    return flight_from_csv(write(folder / "a.csv", columns), "t", ["x", "z"])


def _drops(columns: Columns, folder: Path) -> Diagnosis:
    return flight_from_csv(write(folder / "a.csv", columns), "t", ["z"])


Maker = Callable[[np.random.Generator], Columns]
CASES: dict[str, tuple[Callable[[Columns, Path], Diagnosis], Maker, Truth]] = {
    "swing, null": (_swing, pendulum, {}),
    "swing, null, noisy": (_swing, lambda r: pendulum(r, noise_rad=0.01, rate_hz=30.0), {}),
    "swing, viscous": (
        _swing,
        lambda r: pendulum(r, viscous=0.08),
        {VISCOUS: ("extra_viscous_per_s", 0.08)},
    ),
    "swing, Coulomb": (
        _swing,
        lambda r: pendulum(r, coulomb=0.08),
        {COULOMB: ("extra_coulomb_rad_per_s2", 0.08)},
    ),
    "swing, quadratic": (
        _swing,
        lambda r: pendulum(r, quadratic=0.08),
        {"air_drag": ("quadratic_per_rad", 0.08)},
    ),
    "joint, null": (_joint, joint, {}),
    "joint, null, speed": (_joint_speed, lambda r: joint(r, noise_rad=0.002), {}),
    "joint, excavator": (
        _joint,
        lambda r: joint(r, dead_time_s=0.15, lag_s=0.2, dead_band=0.12),
        EXCAVATOR,
    ),
    "joint, excavator, speed": (
        _joint_speed,
        lambda r: joint(r, dead_time_s=0.15, lag_s=0.2, dead_band=0.12),
        EXCAVATOR,
    ),
    "joint, slow log of the lever": (
        _joint,
        lambda r: joint(r, dead_time_s=0.15, lag_s=0.2, held_s=0.1, rate_hz=100.0),
        {k: EXCAVATOR[k] for k in ("valve_dead_time", "valve_lag")},
    ),
    "throws, null, 3D": (_throws, lambda r: throws(r), {}),
    "throws, null, film at 30 fps": (
        _film,
        lambda r: throws(r, rate_hz=30.0, noise_m=0.01),
        {},
    ),
    "drops, null": (_drops, lambda r: throws(r, 3, is_drop=True), {}),
    "throws, drag": (
        _throws,
        lambda r: throws(r, drag_per_m=0.02),
        {"air_drag": ("drag_per_m", 0.02)},
    ),
    "drops, drag": (
        _drops,
        lambda r: throws(r, 3, drag_per_m=0.03, is_drop=True),
        {"air_drag": ("drag_per_m", 0.03)},
    ),
    "throws, drag and wind": (
        _throws,
        lambda r: throws(r, drag_per_m=0.03, wind_m_per_s=(3.0, -2.0)),
        {"air_drag": ("drag_per_m", 0.03), "wind": ("x_m_per_s", 3.0)},
    ),
    "throws, drag and spin": (
        _throws,
        lambda r: throws(r, drag_per_m=0.02, lift_per_m=0.01),
        {"air_drag": ("drag_per_m", 0.02), "release_spin": ("backspin_lift_per_m", 0.01)},
    ),
}


def trial(name: str, seed: int, folder: Path) -> tuple[Diagnosis, set[str], int, int]:
    """The result, the effects it names, and how many intervals of how many hold what was planted."""
    diagnose, make, truth = CASES[name]
    found = diagnose(make(np.random.default_rng(seed)), folder)
    named = (
        {e.effect: e.parameters for e in found.causes[0].effects}
        if found.verdict in (VerdictKind.EXPLAINED, VerdictKind.AMBIGUOUS)
        else {}
    )
    asked = {effect: truth[effect] for effect in named.keys() & truth.keys()}
    held = [
        named[effect][parameter].ci90[0] <= value <= named[effect][parameter].ci90[1]
        for effect, (parameter, value) in asked.items()
    ]
    return found, set(named), sum(held), len(held)


@pytest.mark.parametrize("name", ["swing, null, noisy", "joint, null", "drops, null"])
def test_nulls_are_none(name: str, tmp_path: Path) -> None:
    assert trial(name, 11, tmp_path)[0].verdict is VerdictKind.NONE


@pytest.mark.parametrize("name", ["swing, Coulomb", "joint, excavator, speed", "drops, drag"])
def test_planted_effects_come_back(name: str, tmp_path: Path) -> None:
    found, named, held, asked = trial(name, 21, tmp_path)
    assert found.verdict is VerdictKind.EXPLAINED
    assert named == set(CASES[name][2])
    assert held >= 0.6 * asked


def main(count: int) -> None:
    """Print verdicts and coverage of every maker over seeds."""
    with tempfile.TemporaryDirectory() as folder:
        for name in CASES:
            trials = [trial(name, 1000 + seed, Path(folder)) for seed in range(count)]
            verdicts = Counter(f"{f.verdict.value} {'+'.join(sorted(n))}" for f, n, _, _ in trials)
            held, asked = sum(t[2] for t in trials), sum(t[3] for t in trials)
            sys.stdout.write(f"{name}: {dict(verdicts)}, intervals {held} of {asked}\n")


if __name__ == "__main__":
    main(int(sys.argv[1]))
