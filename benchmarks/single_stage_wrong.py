"""Sure and wrong: synthetic records on which a single-stage diagnosis claims another cause than the truth.

python -m benchmarks.single_stage_wrong 25 SEED [--kinds joint servo ...] [--json FILE]

A record counts as sure and wrong if the verdict is "explained" or "none" and its effects are not those of the
record. Sizes, rates, noise and commands are drawn anew for every record from the seed.
"""

import argparse
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.result_file import Row, Value, describe, row, write_result
from diagnosis.single_stage.csv_diagnosis import (
    diagnose_actuation_csv,
    diagnose_flight_csv,
    diagnose_swing_csv,
)
from diagnosis.verdict import Diagnosis, VerdictKind
from machine.conventions import Array
from tests.diagnosis.single_stage.synthetic import ball, pendulum, write

TICK_S: Final = 0.005
"""Step of the plants, s."""
Draw = np.random.Generator
Kind = Callable[[Draw, Path], tuple[Diagnosis, frozenset[str]]]
"""A diagnosis and the true effects."""


def _lever(rng: Draw, seconds: float) -> Array:
    """(ticks,) steps of random size and direction with rests between."""
    lever = np.zeros(round(seconds / TICK_S))
    k = round(1.0 / TICK_S)
    while k < len(lever):
        held, rest = (round(s / TICK_S) for s in rng.uniform((1.0, 0.8), (2.5, 1.5)))
        lever[k : k + held] = rng.choice([-1.0, 1.0]) * rng.uniform(0.2, 1.0)
        k += held + rest
    return lever


def _lag(steady: Array, seconds: float) -> Array:
    speed = np.zeros(len(steady))
    for k in range(1, len(steady)):
        speed[k] = speed[k - 1] + (1.0 - np.exp(-TICK_S / seconds)) * (steady[k] - speed[k - 1])
    return speed


def _delay(signal: Array, seconds: float) -> Array:
    count = round(seconds / TICK_S)
    return np.concatenate([np.full(count, signal[0]), signal])[: len(signal)]


def _diagnose_joint(rng: Draw, path: Path, command: Array, position: Array) -> Diagnosis:
    """Log command and position at 25 to 100 Hz with noise and diagnose the file."""
    stride = int(rng.choice([2, 4, 8]))
    seen = position[::stride]
    seen = seen + rng.normal(0.0, 10.0 ** rng.uniform(-3.5, -2.8), len(seen))
    columns = {
        "time_s": np.arange(len(seen)) * stride * TICK_S,
        "command": command[::stride],
        "position_rad": seen,
    }
    return diagnose_actuation_csv(write(path, columns))


def joint(rng: Draw, path: Path) -> tuple[Diagnosis, frozenset[str]]:
    """A drive with dead time, dead band and lag, each of its own size by direction or absent."""
    lever = _lever(rng, 45.0)
    truth: set[str] = set()
    steady = lever
    if rng.random() < 0.6:
        bands = rng.uniform(0.06, 0.2, 2)
        band = np.where(lever > 0.0, *bands)
        steady = np.sign(lever) * np.maximum(np.abs(lever) - band, 0.0) / (1.0 - band)
        truth.add("valve_dead_band")
    if rng.random() < 0.7:
        out_s, in_s = rng.uniform(0.1, 0.35, 2)
        steady = _delay(np.maximum(steady, 0.0), out_s) + _delay(np.minimum(steady, 0.0), in_s)
        truth.add("valve_dead_time")
    if rng.random() < 0.6:
        steady = _lag(steady, rng.uniform(0.1, 0.4))
        truth.add("valve_lag")
    position = np.cumsum(rng.uniform(0.2, 0.6) * steady) * TICK_S
    return _diagnose_joint(rng, path, lever, position), frozenset(truth)


def servo(rng: Draw, path: Path) -> tuple[Diagnosis, frozenset[str]]:
    """A position servo with delay and lag on steps or a chirp."""
    time_s = np.arange(0.0, 30.0, TICK_S)
    start, rise = rng.uniform(0.1, 0.3), rng.uniform(0.01, 0.03)
    chirp = np.sin(2.0 * np.pi * (start * time_s + rise * time_s**2))
    command = chirp if rng.random() < 0.5 else _lever(rng, 30.0)
    command = rng.uniform(0.4, 1.5) * command
    position = _lag(_delay(command, rng.uniform(0.06, 0.2)), rng.uniform(0.08, 0.3))
    position = rng.uniform(-0.5, 0.5) + rng.uniform(0.8, 1.1) * position
    return _diagnose_joint(rng, path, command, position), frozenset(
        {"valve_dead_time", "valve_lag"}
    )


def resonance(rng: Draw, path: Path) -> tuple[Diagnosis, frozenset[str]]:
    """A drive on an oil spring."""
    lever = _lever(rng, 45.0)
    pulsation, damping = 2.0 * np.pi * rng.uniform(0.8, 2.0), rng.uniform(0.1, 0.3)
    speed, slope, speeds = 0.0, 0.0, np.zeros(len(lever))
    for k, wanted in enumerate(lever):
        slope += TICK_S * (pulsation**2 * (wanted - speed) - 2.0 * damping * pulsation * slope)
        speed += TICK_S * slope
        speeds[k] = speed
    position = np.cumsum(rng.uniform(0.2, 0.6) * speeds) * TICK_S
    return _diagnose_joint(rng, path, lever, position), frozenset({"resonance"})


def kinked(rng: Draw, path: Path) -> tuple[Diagnosis, frozenset[str]]:
    """A valve whose speed grows more steeply, or less, beyond a part of its command; with a dead time."""
    lever = _lever(rng, 45.0)
    kink = rng.uniform(0.3, 0.6)
    height = kink * (rng.uniform(0.2, 0.6) if rng.random() < 0.7 else rng.uniform(1.3, 1.6))
    steady = np.sign(lever) * np.interp(np.abs(lever), (0.0, kink, 1.0), (0.0, height, 1.0))
    position = np.cumsum(rng.uniform(0.2, 0.6) * _delay(steady, rng.uniform(0.1, 0.3))) * TICK_S
    truth = frozenset({"valve_curve", "valve_dead_time"})
    return _diagnose_joint(rng, path, lever, position), truth


def loaded(rng: Draw, path: Path) -> tuple[Diagnosis, frozenset[str]]:
    """A drive that slows down by 20 to 50 % from one time on, as with a load; with a lag."""
    lever = _lever(rng, 45.0)
    at = rng.uniform(0.3, 0.7) * len(lever)
    gain = np.where(np.arange(len(lever)) < at, 1.0, 1.0 - rng.uniform(0.2, 0.5))
    position = np.cumsum(rng.uniform(0.2, 0.6) * _lag(gain * lever, rng.uniform(0.1, 0.4))) * TICK_S
    return _diagnose_joint(rng, path, lever, position), frozenset({"speed_drift", "valve_lag"})


def by_position(rng: Draw, path: Path) -> tuple[Diagnosis, frozenset[str]]:
    """A drive whose speed depends on the position by up to 30 to 60 %."""
    lever = _lever(rng, 45.0)
    gain, change = rng.uniform(0.2, 0.5), rng.uniform(0.3, 0.6)
    position = np.zeros(len(lever))
    for k in range(1, len(lever)):
        speed = gain * lever[k] * (1.0 + change * np.tanh(position[k - 1]))
        position[k] = position[k - 1] + TICK_S * speed
    return _diagnose_joint(rng, path, lever, position), frozenset({"speed_by_position"})


def swing(rng: Draw, path: Path) -> tuple[Diagnosis, frozenset[str]]:
    """A pendulum with viscous friction, dry friction or none."""
    viscous = float(rng.uniform(0.04, 0.15)) if rng.random() < 0.5 else 0.0
    coulomb = float(rng.uniform(0.03, 0.08)) if rng.random() < 0.5 else 0.0
    columns = pendulum(rng, viscous, coulomb, noise_rad=10.0 ** rng.uniform(-3.0, -2.2))
    truth = {"passive_viscous_friction"} if viscous > 0.0 else set[str]()
    truth |= {"passive_coulomb_friction"} if coulomb > 0.0 else set[str]()
    return diagnose_swing_csv(write(path, columns), "t", "theta_deg"), frozenset(truth)


def film(rng: Draw, path: Path) -> tuple[Diagnosis, frozenset[str]]:
    """One throw filmed in one plane, with drag."""
    columns = ball(rng, rng.uniform(0.02, 0.08), noise_m=10.0 ** rng.uniform(-3.0, -2.5))
    found = diagnose_flight_csv(write(path, columns), "t", ["x", "z"])
    return found, frozenset({"air_drag"})


KINDS: Final[Mapping[str, Kind]] = {
    "joint": joint,
    "servo": servo,
    "resonance": resonance,
    "by_position": by_position,
    "kinked": kinked,
    "loaded": loaded,
    "swing": swing,
    "film": film,
}
"""By name."""


def measure(name: str, count: int, seed: int, folder: Path) -> Row:
    """Counts of right, sure and wrong, and doubtful verdicts."""
    right = wrong = 0
    for number in range(count):
        rng = np.random.default_rng([seed, list(KINDS).index(name), number])
        found, truth = KINDS[name](rng, folder / "a.csv")
        named = frozenset(e.effect for cause in found.causes[:1] for e in cause.effects)
        is_sure = found.verdict in (VerdictKind.EXPLAINED, VerdictKind.NONE)
        # Of delay and lag a chirp or a short log may show the sum alone.
        is_right = named == truth or (name == "servo" and bool(named) and named <= truth)
        right += is_sure and is_right
        wrong += is_sure and not is_right
        if is_sure and not is_right:
            print(f"{name} {number}: {sorted(truth)}; {found.sentence}")
    values = {
        "right_count": Value(value=float(right)),
        "sure_and_wrong_count": Value(value=float(wrong)),
        "doubtful_count": Value(value=float(count - right - wrong)),
    }
    return row(count, {"kind": name}, values)


def main() -> None:
    """Measure the kinds and print or write the result file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("count", type=int, help="records of each kind")
    parser.add_argument("seed", type=int)
    parser.add_argument("--kinds", nargs="*", choices=list(KINDS), default=list(KINDS))
    parser.add_argument("--json", type=Path, help="file for the result")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        rows = [measure(name, options.count, options.seed, Path(folder)) for name in options.kinds]
    result = describe(
        "single_stage_wrong",
        "Single-stage diagnoses that are sure and wrong, on synthetic records",
        rows,
        seed=options.seed,
    )
    if options.json is not None:
        write_result(result, options.json)
    print(result.model_dump_json(indent=1))


if __name__ == "__main__":
    main()
