"""Right causes and coverage of the 90 % intervals of the single-stage diagnoses, on synthetic records.

python -m benchmarks.single_stage_coverage 40 [--cases swing joint_angle ...] [--json FILE]

Sizes, noise and sampling rates are drawn anew for every record. Cases without an effect count false alarms.
"""

import argparse
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.result_file import Row, describe, ratio, row, write_result
from diagnosis.single_stage.csv_diagnosis import (
    diagnose_actuation_csv,
    diagnose_flight_csv,
    diagnose_swing_csv,
)
from diagnosis.verdict import Diagnosis
from tests.diagnosis.single_stage.synthetic import Columns, joint, pendulum, throws, write

SEED: Final = 7
Truth = Mapping[tuple[str, str], float]
"""True values by effect and parameter; empty for a record without an effect."""
Case = Callable[[np.random.Generator, Path], tuple[Diagnosis, Truth]]


def swing(rng: np.random.Generator, path: Path) -> tuple[Diagnosis, Truth]:
    """Viscous and Coulomb friction together, or air drag."""
    noise, rate_hz = 10.0 ** rng.uniform(-3.0, -2.0), rng.choice([20.0, 40.0, 120.0])
    viscous, coulomb, air = rng.uniform(0.03, 0.15), rng.uniform(0.02, 0.08), rng.uniform(0.05, 0.3)
    truth: Truth
    if rng.random() < 0.5:
        columns = pendulum(rng, viscous, coulomb, rate_hz=rate_hz, noise_rad=noise)
        truth = {
            ("passive_viscous_friction", "extra_viscous_per_s"): viscous,
            ("passive_coulomb_friction", "extra_coulomb_rad_per_s2"): coulomb,
        }
    else:
        columns = pendulum(rng, quadratic=air, rate_hz=rate_hz, noise_rad=noise)
        truth = {("air_drag", "quadratic_per_rad"): air}
    return diagnose_swing_csv(write(path, columns), "t", "theta_deg"), truth


def swing_without_effect(rng: np.random.Generator, path: Path) -> tuple[Diagnosis, Truth]:
    """A swing without loss."""
    noise, rate_hz = 10.0 ** rng.uniform(-3.0, -2.0), rng.choice([20.0, 40.0, 120.0])
    columns = pendulum(rng, rate_hz=rate_hz, noise_rad=noise)
    return diagnose_swing_csv(write(path, columns), "t", "theta_deg"), {}


def _joint(rng: np.random.Generator, path: Path) -> Truth:
    dead_time, lag, band = rng.uniform(0.08, 0.3), rng.uniform(0.1, 0.5), rng.uniform(0.05, 0.2)
    noise, rate_hz = 10.0 ** rng.uniform(-3.5, -2.5), rng.choice([25.0, 40.0, 100.0])
    write(path, joint(rng, dead_time, lag, band, rate_hz=rate_hz, noise_rad=noise))
    return {
        ("valve_dead_time", "extra_dead_time_s"): dead_time,
        ("valve_lag", "extra_lag_s"): lag,
        ("valve_dead_band", "positive_ratio"): band,
        ("valve_dead_band", "negative_ratio"): band,
    }


def joint_angle(rng: np.random.Generator, path: Path) -> tuple[Diagnosis, Truth]:
    """An excavator's joint with its angle."""
    truth = _joint(rng, path)
    return diagnose_actuation_csv(path, "stamp_ms", "lever_pct", "boom_deg"), truth


def joint_speed(rng: np.random.Generator, path: Path) -> tuple[Diagnosis, Truth]:
    """An excavator's joint with its noisy speed."""
    truth = _joint(rng, path)
    found = diagnose_actuation_csv(path, "stamp_ms", "lever_pct", velocity="boom_rate_deg_s")
    return found, truth


def joint_without_effect(rng: np.random.Generator, path: Path) -> tuple[Diagnosis, Truth]:
    """An ideal joint."""
    noise, rate_hz = 10.0 ** rng.uniform(-3.5, -2.5), rng.choice([25.0, 40.0, 100.0])
    write(path, joint(rng, rate_hz=rate_hz, noise_rad=noise))
    return diagnose_actuation_csv(path, "stamp_ms", "lever_pct", "boom_deg"), {}


def flight(rng: np.random.Generator, path: Path) -> tuple[Diagnosis, Truth]:
    """Throws with drag, some with wind or spin."""
    drag, noise = rng.uniform(0.015, 0.08), 10.0 ** rng.uniform(-3.0, -2.0)
    rate_hz, kind = rng.choice([30.0, 60.0, 120.0]), rng.integers(0, 3)
    wind = (
        (float(rng.uniform(2.0, 5.0)), float(rng.uniform(-4.0, -1.0))) if kind == 1 else (0.0, 0.0)
    )
    lift = float(rng.uniform(0.008, 0.03)) if kind == 2 else 0.0
    columns: Columns = throws(
        rng, drag_per_m=drag, wind_m_per_s=wind, lift_per_m=lift, rate_hz=rate_hz, noise_m=noise
    )
    truth = {("air_drag", "drag_per_m"): drag}
    if kind == 1:
        truth[("wind", "x_m_per_s")], truth[("wind", "y_m_per_s")] = wind
    if kind == 2:
        truth[("release_spin", "backspin_lift_per_m")] = lift
    return diagnose_flight_csv(write(path, columns), "t", ["x", "y", "z"]), truth


def flight_without_effect(rng: np.random.Generator, path: Path) -> tuple[Diagnosis, Truth]:
    """Throws under gravity alone."""
    noise, rate_hz = 10.0 ** rng.uniform(-3.0, -2.0), rng.choice([30.0, 60.0, 120.0])
    columns = throws(rng, rate_hz=rate_hz, noise_m=noise)
    return diagnose_flight_csv(write(path, columns), "t", ["x", "y", "z"]), {}


CASES: Final[Mapping[str, tuple[str, str, Case]]] = {
    "joint_angle": ("joint", "simulated, from angles", joint_angle),
    "joint_speed": ("joint", "simulated, from noisy speeds", joint_speed),
    "joint_without_effect": ("joint", "simulated, without an effect", joint_without_effect),
    "swing": ("swing", "simulated pendulums with friction or drag", swing),
    "swing_without_effect": ("swing", "simulated, without an effect", swing_without_effect),
    "flight": ("flight", "simulated throws with drag, wind, spin", flight),
    "flight_without_effect": ("flight", "simulated, without an effect", flight_without_effect),
}
"""By name: tool, data, and the case."""


def measure(name: str, count: int, folder: Path) -> Row:
    """Share of records with exactly the right causes, and of intervals that contain the truth."""
    tool, data, case = CASES[name]
    right = held = asked = 0
    for seed in range(count):
        found, truth = case(np.random.default_rng([SEED, seed]), folder / "a.csv")
        named = {effect.effect: effect.parameters for effect in found.causes[0].effects}
        right += set(named) == {effect for effect, _ in truth}
        for (effect, parameter), value in truth.items():
            if effect in named:
                low, high = named[effect][parameter].ci90
                asked += 1
                held += low <= value <= high
    values = {
        "all_causes_right_ratio": ratio(right, count),
        "intervals_that_hold_ratio": ratio(held, asked),
    }
    return row(count, {"tool": tool, "data": data}, values)


def main() -> None:
    """Measure the cases and print or write the result file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("count", type=int, help="records of each case")
    parser.add_argument("--cases", nargs="*", choices=list(CASES), default=list(CASES))
    parser.add_argument("--json", type=Path, help="file for the result")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        rows = [measure(name, options.count, Path(folder)) for name in options.cases]
    result = describe(
        "single_stage_coverage",
        "Right causes, and 90 % intervals that hold the truth, of the single-stage diagnoses",
        rows,
        seed=SEED,
    )
    if options.json is not None:
        write_result(result, options.json)
    print(result.model_dump_json(indent=1))


if __name__ == "__main__":
    main()
