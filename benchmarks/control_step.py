"""Time of one control step for 1 and 200 machines, and of its floor: onnxruntime running the policy alone.

    python -m benchmarks.control_step [--policies policies] [--mode 2d] [--ticks 2000] [--json FILE]

Samples are recorded first, so that no plant runs while the step is timed. "policy ticks" are the ticks on
which the step runs the policy (one in eight). Wall time includes other load of the host, CPU time does not.
"""

from pathlib import Path
from time import perf_counter, thread_time
from typing import Literal

import numpy as np
import onnxruntime as ort
import tyro

from benchmarks.result_file import RESULTS, Row, describe, percentile, row, write_result
from machine.calibration import nominal_calibration
from machine.conventions import CONTROL_PERIOD_NS, POLICY_DECIMATION, Mode, Motion
from machine.policy_card import POLICY_FILE
from machine.spec import load_spec
from machine.starts import sample_starts
from runtime.control import control_loop
from runtime.control.control_loop import ControlInputs, ControlParams
from runtime.control.policy import PolicyRunner, find_policy
from runtime.driver import SensorSample
from sim_twin.twin.twin import Twin

RECORDED_TICKS = 160
"""Length of the recording; longer runs repeat it."""
TARGET_P99_MS = 2.0


def record(params: ControlParams, count: int) -> tuple[list[tuple[SensorSample, int]], np.ndarray]:
    """Samples and ticks of a throw on the twin, and its targets (N, 3)."""
    rng = np.random.default_rng(1)
    range_m = rng.uniform(7.5, 10.0, count)
    bearing = rng.uniform(-np.pi, np.pi, count)
    target = np.stack([range_m * np.cos(bearing), range_m * np.sin(bearing), 0 * range_m], axis=1)
    plant = Twin.for_plant(count=count, unit_seed=0)
    plant.reset(sample_starts(params.spec, params.mode, target, rng), 1)
    sample = plant.read()
    state = control_loop.initial_state(params, sample, target, plant.now_ns())
    motion = np.full(count, int(Motion.THROW))
    samples: list[tuple[SensorSample, int]] = []
    for _ in range(RECORDED_TICKS):
        now_ns = plant.now_ns()
        samples.append((sample, now_ns))
        inputs = ControlInputs(sample, motion, target)
        state, outputs = control_loop.step(params, state, inputs, now_ns)
        plant.write(outputs.command)
        plant.advance(now_ns + CONTROL_PERIOD_NS)
        sample = plant.read()
    return samples, target


def time_steps(params: ControlParams, count: int, ticks: int) -> np.ndarray:
    """Milliseconds of each step: wall and CPU (2, ticks)."""
    samples, target = record(params, count)
    motion = np.full(count, int(Motion.THROW))
    took = np.empty((2, ticks))
    for tick in range(ticks):
        sample, now_ns = samples[tick % RECORDED_TICKS]
        if tick % RECORDED_TICKS == 0:
            state = control_loop.initial_state(params, sample, target, now_ns)
        inputs = ControlInputs(sample, motion, target)
        started, busy = perf_counter(), thread_time()
        state, _ = control_loop.step(params, state, inputs, now_ns)
        took[:, tick] = perf_counter() - started, thread_time() - busy
    return took * 1e3


def time_floor(path: Path, width: int, count: int, runs: int) -> np.ndarray:
    """Milliseconds of each run of the policy's ONNX file alone: wall and CPU (2, runs)."""
    options = ort.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session = ort.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    given = {"observation": np.zeros((count, width), dtype=np.float32)}
    took = np.empty((2, runs))
    for index in range(runs):
        started, busy = perf_counter(), thread_time()
        session.run(None, given)
        took[:, index] = perf_counter() - started, thread_time() - busy
    return took * 1e3


def main(
    policies: Path = Path("policies"),
    mode: Literal["2d", "3d"] = "2d",
    ticks: int = 2000,
    json: Path = RESULTS / "control_step.json",
) -> None:
    """Time the control step and its floor.

    Args:
        policies: folder with active.json.
        mode: 2d or 3d.
        ticks: timed steps of each batch size.
        json: file for the result.
    """
    spec = load_spec()
    folder = find_policy(policies, Mode(mode))
    policy = PolicyRunner(folder, spec)
    params = ControlParams(spec, nominal_calibration(spec), Mode(mode), policy)
    rows: list[Row] = []
    for count in (1, 200):
        steps = time_steps(params, count, ticks)
        due = steps[:, np.arange(ticks) % RECORDED_TICKS % POLICY_DECIMATION == 0]
        floor = time_floor(
            folder / POLICY_FILE, len(policy.card.observation_names), count, ticks // 4
        )
        for name, values in (("step", steps), ("policy ticks", due), ("floor", floor)):
            p50, p99, cpu = (
                percentile(values[0], 50),
                percentile(values[0], 99),
                percentile(values[1], 50),
            )
            labels = {"machines": count, "part": name}
            found = {"p50_ms": p50, "p99_ms": p99, "cpu_p50_ms": cpu}
            rows.append(row(values.shape[1], labels, found))
            shown = "  ".join(f"{key} {value.value:.3f}" for key, value in found.items())
            print(f"N={count:<4d} {name:13s} {shown}")
    notes = f"Target: p99 {TARGET_P99_MS} ms for one machine."
    print(notes)
    title = f"Time of one control step, {mode}, and of the policy alone"
    write_result(describe("control_step", title, rows, seed=1, notes=notes), json)


if __name__ == "__main__":
    tyro.cli(main)
