"""Latency of previews, and its floor: MuJoCo alone.

    python -m benchmarks.preview --policies policies [--mode 3d] [--count 20] [--json FILE]

Measured: time until the nominal throw is shown (what an operator waits for), until its landing, until the
first ellipse, and until the whole ellipse; in one process, and in the processes of the server, where the
nominal throw and the scattered throws run side by side. Floor: MuJoCo steps of the same model up to the
release, without control and output. Rows `cpu` are processor time, of all threads: other load of the host
changes it least.
"""

from dataclasses import dataclass
from itertools import product
from pathlib import Path
from time import perf_counter, process_time
from typing import Literal

import mujoco
import numpy as np
import tyro
from mujoco import batch

from benchmarks.result_file import RESULTS, describe, percentile, row, write_result
from evaluation.campaigns import open_policy
from machine.calibration import nominal_calibration
from machine.conventions import CONTROL_PERIOD_S, Mode
from machine.kinematics import aligned_slew_rad
from machine.messages import Target
from machine.spec import load_spec
from machine.starts import safe_pose
from runtime.control.control_loop import ControlParams
from runtime.control.policy import find_policy
from server.plans.preview_pool import PreviewPool
from server.plans.preview_worker import PreviewJob
from sim_twin.rigid_body.model import twin_model
from sim_twin.throws.preview import PreviewRequest, ThrowPreview, preview
from sim_twin.twin.profile import nominal_profile

TARGET_MS = {"shown": 50.0, "ellipse of 500": 1500.0}
POOL_COUNTS = (200, 500)
"""Scattered throws of the previews that are measured in several processes."""


@dataclass(frozen=True)
class Timing:
    """Milliseconds of one preview."""

    shown_ms: float
    shown_cpu_ms: float
    """Processor time of the same, which other load of the host does not change."""
    landed_ms: float
    first_ellipse_ms: float
    ellipse_ms: float
    ellipse_cpu_ms: float
    tick_count: int
    """Ticks of the nominal throw until its release."""


def measure(request: PreviewRequest) -> Timing:
    """Time one preview."""
    started, cpu_started = perf_counter(), process_time()
    marks: list[tuple[float, ThrowPreview]] = []
    cpu: list[float] = []

    def note(shown: ThrowPreview) -> None:
        marks.append((perf_counter() - started, shown))
        cpu.append(process_time() - cpu_started)

    last = preview(request, note)
    note(last)
    ellipses = [seconds for seconds, shown in marks if shown.ellipse is not None]
    nominal = [seconds for seconds, shown in marks if shown.ellipse is None]
    release_s = marks[0][1].release_s
    return Timing(
        shown_ms=1e3 * nominal[0],
        shown_cpu_ms=1e3 * cpu[0],
        landed_ms=1e3 * nominal[-1],
        first_ellipse_ms=1e3 * ellipses[0] if ellipses else float("nan"),
        ellipse_ms=1e3 * ellipses[-1] if ellipses else float("nan"),
        ellipse_cpu_ms=1e3 * cpu[-1],
        tick_count=0 if np.isnan(release_s) else round(release_s / CONTROL_PERIOD_S),
    )


def measure_pool(
    folder: Path, requests: list[PreviewRequest], processes: int
) -> dict[str, list[float]]:
    """Milliseconds of previews in the processes of a server, by part; the first one is not counted."""
    pool = PreviewPool(processes, (folder,))
    pool.start()
    times: dict[str, list[float]] = {}
    try:
        for index, (request, count) in enumerate(product(requests, POOL_COUNTS)):
            job = PreviewJob(
                job_id=str(index),
                slot=0,
                policy_dir=folder,
                target=request.target,
                joint_position_rad_m=request.joint_position_rad_m,
                rollout_count=count,
                calibration_path=None,
                profile_path=None,
                seed=request.seed,
            )
            seconds = _measure_job(pool, job)
            if index < len(POOL_COUNTS):
                continue
            for part, value in zip(
                ("shown", "first ellipse", f"ellipse of {count}"), seconds, strict=True
            ):
                times.setdefault(f"{part}, {processes} processes", []).append(1e3 * value)
    finally:
        pool.close()
    return times


def _measure_job(pool: PreviewPool, job: PreviewJob) -> tuple[float, float, float]:
    """Seconds until the throw, the first ellipse and everything is there."""
    started = perf_counter()
    marks: list[tuple[float, ThrowPreview]] = []
    pool.submit(job, lambda shown: marks.append((perf_counter() - started, shown))).result()
    ended_s = perf_counter() - started
    ellipses = [seconds for seconds, shown in marks if shown.ellipse is not None]
    return marks[0][0], min([*ellipses, ended_s]), ended_s


def floor_ms(ticks: int, count: int) -> tuple[float, float]:
    """Milliseconds, and of processor time, of `ticks` physics steps of `count` machines and nothing else."""
    model, _ = twin_model()
    started, cpu_started = perf_counter(), process_time()
    if count == 1:
        data = mujoco.MjData(model)
        data.qpos[:] = safe_pose()
        for _ in range(ticks):
            mujoco.mj_step(model, data)
    else:
        machines = batch.Batch(model, count, 2)
        machines.bind("qpos")[:] = safe_pose()
        for _ in range(ticks):
            machines.step()
    return 1e3 * (perf_counter() - started), 1e3 * (process_time() - cpu_started)


def main(
    policies: Path = Path("policies"),
    mode: Literal["2d", "3d"] = "2d",
    count: int = 20,
    nearest: float = 7.0,
    farthest: float = 9.5,
    processes: int = 2,
    json: Path = RESULTS / "preview.json",
) -> None:
    """Time previews of `count` targets between `nearest` and `farthest`; 0 `processes`: in this one only."""
    spec = load_spec()
    runner = open_policy(Mode(mode), policies, None, spec)
    params = ControlParams(
        spec=spec, calibration=nominal_calibration(spec), mode=Mode(mode), policy=runner
    )
    timings: list[Timing] = []
    requests: list[PreviewRequest] = []
    floors: list[list[tuple[float, float]]] = []
    for index, range_m in enumerate(np.linspace(nearest, farthest, count + 1)):
        target = Target(x_m=float(range_m), y_m=0.0)
        # Aligned already: aligning the cabin would count as simulated time of a 2D throw.
        slew = float(aligned_slew_rad(spec, np.array([target.x_m, target.y_m, 0.0])))
        pose = safe_pose(slew)
        request = PreviewRequest(
            params=params,
            profile=nominal_profile(spec),
            target=target,
            joint_position_rad_m=(pose[0], pose[1], pose[2], pose[3], pose[4], pose[5]),
            seed=index,
        )
        requests.append(request)
        timing = measure(request)
        if index == 0:
            continue  # The first preview compiles the model and loads the policy.
        timings.append(timing)
        floors.append([floor_ms(timing.tick_count, many) for many in (1, 200, 500)])
    parts = ("shown", "shown_cpu", "landed", "first_ellipse", "ellipse", "ellipse_cpu")
    times = {part: [getattr(timing, f"{part}_ms") for timing in timings] for part in parts}
    if processes:
        times |= measure_pool(find_policy(policies, Mode(mode)), requests, processes)
    for column, name in enumerate(("one throw", "200 throws", "500 throws")):
        times[f"floor of {name}"] = [floor[column][0] for floor in floors]
        times[f"floor of {name} cpu"] = [floor[column][1] for floor in floors]
    rows = [
        row(
            len(values),
            {"part": part.replace("_", " ")},
            {"p50_ms": percentile(values, 50), "p95_ms": percentile(values, 95)},
        )
        for part, values in times.items()
    ]
    ticks = np.median([t.tick_count for t in timings])
    print(f"{count} previews in {mode}, 200 throws each; {ticks:.0f} ticks until the release")
    for line in rows:
        shown = ", ".join(f"{key} {value.value or 0.0:.1f}" for key, value in line.values.items())
        print(f"{line.labels['part']:>28}: {shown}")
    notes = "Targets, p95: " + ", ".join(f"{k} {v:.0f} ms" for k, v in TARGET_MS.items()) + "."
    print(notes)
    title = f"Latency of previews, {mode}"
    write_result(describe("preview", title, rows, seed=0, notes=notes), json)


if __name__ == "__main__":
    tyro.cli(main)
