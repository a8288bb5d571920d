"""Latency of previews against the cheapest thing that does the same physics; one run, side by side.

    python benchmarks/preview.py --policies policies [--mode 3d] [--count 20] [--json FILE]

Measured: time until the nominal throw is shown (what an operator waits for), until it has come down, until
the first ellipse, and until the ellipse of 200 throws. Floor: bare MuJoCo steps of the same model, for the
ticks until the load leaves, which is all that either of the two simulates before it is shown.
"""

import json as json_text
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter, process_time
from typing import Literal

import mujoco
import numpy as np
import tyro
from mujoco import batch

from evaluation.campaigns import open_policy
from machine.calibration import nominal_calibration
from machine.conventions import CONTROL_PERIOD_S, Mode
from machine.kinematics import aligned_slew_rad
from machine.messages import Target
from machine.spec import load_spec
from machine.starts import safe_pose
from runtime.control.control_loop import ControlParams
from sim_twin.throws.preview import PreviewRequest, ThrowPreview, preview
from sim_twin.twin.model import twin_model
from sim_twin.twin.profile import nominal_profile

TARGET_MS = {"shown": 150.0, "ellipse": 2000.0}


@dataclass(frozen=True)
class Timing:
    """Milliseconds of one preview."""

    shown_ms: float
    shown_cpu_ms: float
    """Processor time of the same; on a busy machine the honest number."""
    landed_ms: float
    first_ellipse_ms: float
    ellipse_ms: float
    ellipse_cpu_ms: float
    tick_count: int
    """Ticks of the nominal throw until its load leaves."""


def measure(request: PreviewRequest) -> Timing:
    """Run one preview and note when what arrived."""
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


def floor_ms(ticks: int, count: int) -> float:
    """Bare physics: `ticks` steps of `count` machines, nothing read, nothing controlled."""
    model, _ = twin_model()
    started = perf_counter()
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
    return 1e3 * (perf_counter() - started)


def main(
    policies: Path = Path("policies"),
    mode: Literal["2d", "3d"] = "2d",
    count: int = 20,
    nearest: float = 7.0,
    farthest: float = 9.5,
    json: Path | None = None,
) -> None:
    """Preview `count` targets between `nearest` and `farthest` and print what it took."""
    spec = load_spec()
    runner = open_policy(Mode(mode), policies, None, spec)
    params = ControlParams(
        spec=spec, calibration=nominal_calibration(spec), mode=Mode(mode), policy=runner
    )
    timings: list[Timing] = []
    floors: list[tuple[float, float]] = []
    for index, range_m in enumerate(np.linspace(nearest, farthest, count + 1)):
        target = Target(x_m=float(range_m), y_m=0.0)
        # Aligned already, so that the drawn turn of a 2D throw does not count as simulated time.
        slew = float(aligned_slew_rad(spec, np.array([target.x_m, target.y_m, 0.0])))
        pose = safe_pose(slew)
        request = PreviewRequest(
            params=params,
            profile=nominal_profile(spec),
            target=target,
            joint_position_rad_m=(pose[0], pose[1], pose[2], pose[3], pose[4], pose[5]),
            seed=index,
        )
        timing = measure(request)
        if index == 0:
            continue  # the first preview compiles the model and warms the policy
        timings.append(timing)
        floors.append((floor_ms(timing.tick_count, 1), floor_ms(timing.tick_count, 200)))
    report = {
        key: {
            "p50_ms": float(np.nanpercentile([getattr(t, key) for t in timings], 50)),
            "p95_ms": float(np.nanpercentile([getattr(t, key) for t in timings], 95)),
        }
        for key in (
            "shown_ms",
            "shown_cpu_ms",
            "landed_ms",
            "first_ellipse_ms",
            "ellipse_ms",
            "ellipse_cpu_ms",
        )
    }
    one, many = np.median(floors, axis=0)
    report["floor"] = {"one_throw_ms": float(one), "two_hundred_throws_ms": float(many)}
    ticks = np.median([t.tick_count for t in timings])
    print(f"{count} previews in {mode}, 200 throws each; {ticks:.0f} ticks until the load leaves")
    for key, row in report.items():
        print(f"{key:>18}: " + ", ".join(f"{k} {v:.1f}" for k, v in row.items()))
    print(
        f"nominal throw shown: {report['shown_ms']['p50_ms'] / one:.0f} x bare MuJoCo; "
        f"ellipse: {report['ellipse_ms']['p50_ms'] / many:.1f} x bare mujoco.batch; "
        f"targets: shown {TARGET_MS['shown']:.0f} ms p95, ellipse {TARGET_MS['ellipse']:.0f} ms"
    )
    if json is not None:
        json.write_text(json_text.dumps(report, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    tyro.cli(main)
