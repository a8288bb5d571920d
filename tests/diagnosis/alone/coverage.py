"""How often the 90 % intervals of the stage tools hold what was planted.

`python -m tests.diagnosis.alone.coverage 40` prints it for 40 seeds.

Sizes, noise and rates are drawn anew for every seed, at other levels than those of the tests.
"""

import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np

from diagnosis.alone.diagnose import actuation_from_csv, flight_from_csv, swing_from_csv
from diagnosis.verdict import Diagnosis
from tests.diagnosis.alone.planted import joint, pendulum, throws, write

Truth = dict[tuple[str, str], float]
"""By effect and parameter."""
Case = Callable[[np.random.Generator, Path], tuple[Diagnosis, Truth]]


def swing(rng: np.random.Generator, path: Path) -> tuple[Diagnosis, Truth]:
    """Viscous and Coulomb friction together, or air drag, as the seed says."""
    noise, rate_hz = 10.0 ** rng.uniform(-3.0, -2.0), rng.choice([20.0, 40.0, 120.0])
    viscous, coulomb, air = rng.uniform(0.03, 0.15), rng.uniform(0.02, 0.08), rng.uniform(0.05, 0.3)
    if rng.random() < 0.5:
        columns = pendulum(rng, viscous, coulomb, rate_hz=rate_hz, noise_rad=noise)
        truth = {
            ("passive_viscous_friction", "extra_viscous_per_s"): viscous,
            ("passive_coulomb_friction", "extra_coulomb_rad_per_s2"): coulomb,
        }
    else:
        columns = pendulum(rng, quadratic=air, rate_hz=rate_hz, noise_rad=noise)
        truth = {("air_drag", "quadratic_per_rad"): air}
    return swing_from_csv(write(path, columns), "t", "theta_deg"), truth


def _excavator(rng: np.random.Generator, path: Path, velocity: bool) -> tuple[Diagnosis, Truth]:
    dead_time, lag, band = rng.uniform(0.08, 0.3), rng.uniform(0.1, 0.5), rng.uniform(0.05, 0.2)
    noise, rate_hz = 10.0 ** rng.uniform(-3.5, -2.5), rng.choice([25.0, 40.0, 100.0])
    columns = joint(rng, dead_time, lag, band, rate_hz=rate_hz, noise_rad=noise)
    write(path, columns)
    names = ("stamp_ms", "lever_pct")
    found = (
        actuation_from_csv(path, *names, velocity="boom_rate_deg_s")
        if velocity
        else actuation_from_csv(path, *names, "boom_deg")
    )
    return found, {
        ("valve_dead_time", "extra_dead_time_s"): dead_time,
        ("valve_lag", "extra_lag_s"): lag,
        ("valve_dead_band", "positive_ratio"): band,
        ("valve_dead_band", "negative_ratio"): band,
    }


def joint_angle(rng: np.random.Generator, path: Path) -> tuple[Diagnosis, Truth]:
    """An excavator's joint by its angle."""
    return _excavator(rng, path, velocity=False)


def joint_speed(rng: np.random.Generator, path: Path) -> tuple[Diagnosis, Truth]:
    """An excavator's joint by its noisy speed."""
    return _excavator(rng, path, velocity=True)


def flight(rng: np.random.Generator, path: Path) -> tuple[Diagnosis, Truth]:
    """Throws with drag, and with wind or spin as the seed says."""
    drag, noise = rng.uniform(0.015, 0.08), 10.0 ** rng.uniform(-3.0, -2.0)
    rate_hz, kind = rng.choice([30.0, 60.0, 120.0]), rng.integers(0, 3)
    wind = (
        (float(rng.uniform(2.0, 5.0)), float(rng.uniform(-4.0, -1.0))) if kind == 1 else (0.0, 0.0)
    )
    lift = float(rng.uniform(0.008, 0.03)) if kind == 2 else 0.0
    columns = throws(
        rng,
        drag_per_m=drag,
        wind_m_per_s=wind,
        lift_per_m=lift,
        rate_hz=rate_hz,
        noise_m=noise,
    )
    truth = {("air_drag", "drag_per_m"): drag}
    if kind == 1:
        truth[("wind", "x_m_per_s")], truth[("wind", "y_m_per_s")] = wind
    if kind == 2:
        truth[("release_spin", "backspin_lift_per_m")] = lift
    return flight_from_csv(write(path, columns), "t", ["x", "y", "z"]), truth


CASES: tuple[Case, ...] = (swing, joint_angle, joint_speed, flight)


def main(count: int, names: list[str]) -> None:
    """Print what was found and how many intervals hold, by tool and by parameter."""
    with tempfile.TemporaryDirectory() as folder:
        for case in CASES:
            if names and case.__name__ not in names:
                continue
            right, held, asked = 0, Counter[str](), Counter[str]()
            for seed in range(count):
                rng = np.random.default_rng([7, seed])
                found, truth = case(rng, Path(folder) / "a.csv")
                named = {e.effect: e.parameters for e in found.causes[0].effects}
                exact = set(named) == {effect for effect, _ in truth}
                right += exact
                for (effect, parameter), value in truth.items():
                    if effect not in named:
                        continue
                    low, high = named[effect][parameter].ci90
                    asked[f"{effect}.{parameter}"] += 1
                    held[f"{effect}.{parameter}"] += low <= value <= high
                if not exact:
                    sys.stdout.write(f"  {seed}: {found.verdict.value} {sorted(named)}\n")
            each = ", ".join(f"{name} {held[name]}/{asked[name]}" for name in asked)
            sys.stdout.write(
                f"{case.__name__}: causes right in {right} of {count}, intervals {held.total()} of "
                f"{asked.total()} ({each})\n"
            )
            sys.stdout.flush()


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2:])
