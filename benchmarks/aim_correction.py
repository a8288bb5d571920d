"""What an aim correction gains: mean miss before and after, never worse, spread untouched.

    python -m benchmarks.aim_correction [--machines 20] [--jobs 16] [--json FILE]

20 machines whose mean miss over the range is drawn, a quarter without any, with the scatter of virtual
machines as recorded below; and virtual machines that throw: from their first throws a correction is made, and
others are thrown without and with it from the same starts. The maps and the decision are the server's.
"""

import multiprocessing
import os
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import tyro

from benchmarks.result_file import RESULTS, Row, describe, plain, row, write_result
from machine.calibration import nominal_calibration
from machine.conventions import Array, Mode
from machine.registration import Registration
from machine.spec import load_spec
from machine.starts import sample_starts
from runtime.control.control_loop import ControlParams
from runtime.control.policy import PolicyRunner, find_policy
from server.aim.bias_map import Misses, bias_map, correction_at, expected_gain, is_correctable
from sim_twin.throws.campaign import ThrowResult, run_throws
from sim_twin.virtual_machine import VirtualMachine

MACHINE_COUNT = 20
LEARN_COUNT = 60
TEST_COUNT = 4000
SD_M = (0.051, 0.066)
"""Spread along and across of m545-3d-v7 at 9 m (benchmarks/results/policy_accuracy.json)."""
RANGE_M = (7.5, 10.0)
BIAS_FREE_RATIO = 0.25
VIRTUAL_LEARN_COUNT = 60
VIRTUAL_TEST_COUNT = 200
POLICIES = Path("policies")
SEED = 40


def drawn(rng: np.random.Generator, bias: Array, count: int) -> Misses:
    """Throws of a machine with a mean miss: constant and slope over the range, along and across (2, 2)."""
    range_m = rng.uniform(*RANGE_M, count)
    tilt = (range_m - np.mean(RANGE_M)) / np.ptp(RANGE_M)
    scatter = rng.standard_normal((2, count)) * np.array(SD_M)[:, None]
    along, across = bias[:, :1] + bias[:, 1:] * tilt + scatter
    sd_along, sd_across = (np.full(count, value) for value in SD_M)
    zero = np.zeros(count)
    return Misses(range_m, zero, along, across, sd_along, sd_across, zero, zero)


def correction(misses: Misses) -> Registration | None:
    """What the server would propose of these throws."""
    found = bias_map(misses)
    if not is_correctable(found) or expected_gain(misses, None).low_m <= 0.0:
        return None
    return found.registration("", misses.range_m.size)


def mean_miss(along_m: Array, across_m: Array, range_m: Array) -> float:
    """Root mean square over ranges of the mean miss there, m."""
    which = np.digitize(range_m, np.linspace(*RANGE_M, 6)[1:-1])
    bins = [which == one for one in np.unique(which)]
    squares = [along_m[one].mean() ** 2 + across_m[one].mean() ** 2 for one in bins]
    return float(np.sqrt(np.mean(squares)))


def simulated() -> list[Row]:
    """Machines whose mean miss is drawn."""
    rng = np.random.default_rng(SEED)
    before, after, spread, is_biased = [], [], [], []
    for number in range(MACHINE_COUNT):
        has_bias = number >= BIAS_FREE_RATIO * MACHINE_COUNT
        bias = rng.normal(0.0, [[0.12, 0.1], [0.06, 0.05]]) * has_bias
        table = correction(drawn(rng, bias, LEARN_COUNT))
        test = drawn(rng, bias, TEST_COUNT)
        along, across = correction_at(table, test)
        before.append(mean_miss(test.along_m, test.across_m, test.range_m))
        left = test.along_m - along, test.across_m - across
        after.append(mean_miss(*left, test.range_m))
        tilt = test.range_m - test.range_m.mean()
        spread.append(_rest_sd(left[0], tilt) / _rest_sd(test.along_m, tilt))
        is_biased.append(has_bias)
    return _rows("drawn mean misses", np.array(before), np.array(after), spread, is_biased)


def _rest_sd(values: Array, tilt: Array) -> float:
    """Spread about a line over the range, m."""
    line = np.polynomial.Polynomial.fit(tilt, values, 3)
    return float(np.std(values - line(tilt)))


def thrown(unit: int) -> tuple[float, float, float, bool]:
    """Mean miss before and after, ratio of spreads and whether there is a correction, of one machine."""
    spec = load_spec()
    runner = PolicyRunner(find_policy(POLICIES, Mode.SPATIAL), spec)
    params = ControlParams(spec, nominal_calibration(spec), Mode.SPATIAL, runner)
    rng = np.random.default_rng([SEED, unit])
    first, _ = _throw(params, unit, rng, VIRTUAL_LEARN_COUNT, None, 1)
    table = correction(first)
    state = rng.bit_generator.state
    without, _ = _throw(params, unit, rng, VIRTUAL_TEST_COUNT, None, 2)
    rng.bit_generator.state = state
    corrected, _ = _throw(params, unit, rng, VIRTUAL_TEST_COUNT, table, 2)
    values = [
        (mean_miss(one.along_m, one.across_m, one.range_m), _scatter(one))
        for one in (without, corrected)
    ]
    return values[0][0], values[1][0], values[1][1] / values[0][1], table is not None


def _scatter(misses: Misses) -> float:
    """Robust spread along, m."""
    off = misses.along_m - np.median(misses.along_m)
    return float(1.4826 * np.median(np.abs(off)))


def _throw(
    params: ControlParams,
    unit: int,
    rng: np.random.Generator,
    count: int,
    table: Registration | None,
    seed: int,
) -> tuple[Misses, list[ThrowResult]]:
    range_m = rng.uniform(*RANGE_M, count)
    azimuth = rng.uniform(-np.pi, np.pi, count)
    forward = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
    left = np.stack([-forward[:, 1], forward[:, 0]], axis=1)
    target_m = np.hstack([range_m[:, None] * forward, np.zeros((count, 1))])
    starts = sample_starts(params.spec, params.mode, target_m, rng)
    zero = np.zeros(count)
    empty = Misses(range_m, zero, zero, zero, zero + SD_M[0], zero + SD_M[1], zero, zero)
    along, across = correction_at(table, empty)
    aim_m = target_m.copy()
    aim_m[:, :2] -= along[:, None] * forward + across[:, None] * left
    plant = VirtualMachine(count=count, unit_seed=unit)
    results = run_throws(plant, params, aim_m, starts, seed)
    impact = np.array([result.impact_m for result in results])[:, :2] - target_m[:, :2]
    landed = np.flatnonzero(np.isfinite(impact).all(axis=1))
    found = empty._replace(
        along_m=np.einsum("ij,ij->i", impact, forward),
        across_m=np.einsum("ij,ij->i", impact, left),
    )
    return found.take(landed), results


def _rows(
    what: str, before: Array, after: Array, spread: list[float], is_biased: list[bool]
) -> list[Row]:
    rows: list[Row] = []
    for biased in (True, False):
        chosen = np.array(is_biased) == biased
        if not chosen.any():
            continue
        rows.append(
            row(
                int(chosen.sum()),
                {"machines": what, "bias": "yes" if biased else "no"},
                {
                    "before_m": plain(float(before[chosen].mean())),
                    "after_m": plain(float(after[chosen].mean())),
                    "halved_ratio": plain(float((after[chosen] <= 0.5 * before[chosen]).mean())),
                    "worst_change_m": plain(float((after - before)[chosen].max())),
                    "spread_ratio": plain(float(np.mean(np.array(spread)[chosen]))),
                },
            )
        )
    return rows


def main(
    machines: int = 20,
    jobs: int = len(os.sched_getaffinity(0)),
    json: Path = RESULTS / "aim_correction.json",
) -> None:
    """Measure and write the result.

    Args:
        machines: virtual machines that throw.
        jobs: processes that throw, each with one machine at a time.
        json: where the result is written.
    """
    rows = simulated()
    found: list[tuple[float, float, float, bool]] = []
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(jobs, machines), context) as pool:
        for unit, values in enumerate(pool.map(thrown, range(1, machines + 1)), 1):
            found.append(values)
            print(unit, *values, flush=True)
    before, after, spread, _ = zip(*found, strict=True)
    rows += _rows(
        "virtual, valve tables of the drawing",
        np.array(before),
        np.array(after),
        list(spread),
        [True] * len(found),
    )
    corrected_count = sum(is_corrected for *_, is_corrected in found)
    result = describe(
        "aim_correction",
        "Mean miss before and after an aim correction",
        rows,
        seed=SEED,
        notes=(
            f"{LEARN_COUNT} throws to learn from, {VIRTUAL_LEARN_COUNT} of virtual machines; mean miss: "
            "root mean square over five ranges; worst change: of any machine, positive is worse; "
            f"{corrected_count} of the virtual machines got a correction"
        ),
    )
    for line in rows:
        print(line.n, *line.labels.values(), *(v.value for v in line.values.values()))
    print(write_result(result, json))


if __name__ == "__main__":
    tyro.cli(main)
