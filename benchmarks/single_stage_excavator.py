"""Read arm, boom and bucket of a public excavator recording: dead time, dead band, saturation per direction.

    python -m benchmarks.single_stage_excavator DATA

`DATA` is the folder ``data`` of github.com/rebirther00/pid_gain_estimation_clean: steps of 40 to 100 % of
the valve's duty, logged by dSPACE ControlDesk at 100 Hz, one run a file. The repository has no licence:
nothing of it is kept here but what the files show. Beside the answers stands what a plot shows: when the
joint has travelled 0.1 degrees, the smallest duty that moved it faster than 1 degree/s, and the smallest that
was as fast as any (within 7 %).
"""

import csv
import tempfile
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
import tyro

from benchmarks.result_file import Row, Value, describe, row, write_result
from benchmarks.single_stage_recordings import diagnose
from machine.conventions import Array

JOINTS: Final = {
    "arm": ("Arm_Single", "Arm_in_duty", "Arm_out_duty", "Arm_ang"),
    "boom": ("Boom Single", "Boom_up_duty", "Boom_dn_duty", "Boom_ang"),
    "bucket": ("Bucket_Single", "Bkt_in_duty", "Bkt_out_duty", "Bkt_ang"),
}
"""Joint -> folder, duties of both directions, angle; as the files name them."""
SEEN_TRAVEL_DEG: Final = 0.1
SEEN_SPEED_DEG_PER_S: Final = 1.0
SEEN_TOP_RATIO: Final = 0.93
SMOOTHED_ROWS: Final = 20


def read_run(file: Path, up: str, down: str, angle: str) -> Array:
    """Time s, duty % (positive for `up`) and angle deg of a run, (rows, 3)."""
    lines = list(csv.reader(file.read_text(encoding="latin-1").splitlines()))
    head = {line[0]: line for line in lines if line and line[0]}
    first = next(number for number, line in enumerate(lines) if line[:1] == ["trace_values"])
    names = [f"{path}/{name}" for path, name in zip(head["path"], head["trace_names"], strict=True)]

    def column(name: str) -> int:
        return next(number for number, path in enumerate(names) if f"/{name}" in path)

    cells = [line for line in lines[first:] if len(line) == len(lines[first])]
    chosen = [1, column(up), column(down), column(angle)]
    values = np.array([[float(line[number]) for number in chosen] for line in cells])
    return np.column_stack([values[:, 0], values[:, 1] - values[:, 2], values[:, 3]])


def see(runs: list[Array]) -> tuple[float, float, float]:
    """Dead time s, smallest duty that moves and smallest that is as fast as any, %, of one direction."""
    late, duties, speeds = [], [], []
    for run in runs:
        begin = int(np.argmax(np.abs(run[:, 1]) > 0.0))
        travel = np.abs(run[:, 2] - run[begin, 2])
        moved = travel > SEEN_TRAVEL_DEG
        moved[:begin] = False
        speed = np.abs(run[SMOOTHED_ROWS:, 2] - run[:-SMOOTHED_ROWS, 2])
        speed /= run[SMOOTHED_ROWS:, 0] - run[:-SMOOTHED_ROWS, 0]
        inside = (travel > 0.25 * travel.max()) & (travel < 0.75 * travel.max())
        duties.append(float(np.abs(run[:, 1]).max()))
        speeds.append(float(np.median(speed[inside[SMOOTHED_ROWS:]])))
        if speeds[-1] > SEEN_SPEED_DEG_PER_S:
            late.append(float(run[int(np.argmax(moved)), 0] - run[begin, 0]))
    is_moving = np.array(speeds) > SEEN_SPEED_DEG_PER_S
    is_fast = np.array(speeds) >= SEEN_TOP_RATIO * max(speeds)
    return (
        float(np.median(late)),
        float(np.array(duties)[is_moving].min()),
        float(np.array(duties)[is_fast].min()),
    )


def answer(runs: list[Array]) -> dict[str, Any]:
    """What ``downrange diagnose actuation`` says of the runs of a joint in one table."""
    with tempfile.TemporaryDirectory() as folder:
        table = Path(folder) / "joint.csv"
        with table.open("w", encoding="utf-8") as file:
            file.write("run,time_s,duty_percent,angle_deg\n")
            for number, run in enumerate(runs):
                file.writelines(f"{number},{t:.4f},{u:.1f},{a:.5f}\n" for t, u, a in run)
        return diagnose(
            [
                *("actuation", str(table), "--time", "time_s", "--group", "run"),
                *("--command", "duty_percent", "--position", "angle_deg"),
            ]
        )


def rows_of(joint: str, data: Path) -> list[Row]:
    """One row a direction."""
    folder, up, down, angle = JOINTS[joint]
    files = sorted((data / folder).glob("*-H-S.csv"))
    runs = [read_run(file, up, down, angle) for file in files]
    found = answer(runs)
    made: list[Row] = []
    for reading in found["evidence"]["directions"]:
        way = 1.0 if reading["direction"] == "positive" else -1.0
        ours = [run for run in runs if way * run[:, 1].sum() > 0.0]
        seen = see(ours)
        labels = {"joint": joint, "command": up if way > 0.0 else down}
        band, most = reading["dead_band_ratio"], reading["saturation_ratio"]
        values = {
            "dead_time_s": Value(value=reading["dead_time_s"]),
            "travels_after_s": Value(value=seen[0]),
            "dead_band_ratio": Value(value=band),
            "moves_from_ratio": Value(value=seen[1] / 100.0),
            "saturation_ratio": Value(value=most),
            "as_fast_from_ratio": Value(value=seen[2] / 100.0),
        }
        made.append(row(len(ours), labels, values))
    return made


def main(data: Annotated[Path, tyro.conf.Positional]) -> None:
    """Diagnose the three joints and write the result."""
    rows = [line for joint in JOINTS for line in rows_of(joint, data)]
    title = "Steps of an excavator's joints: what the diagnosis reads, and what a plot shows"
    result = describe("single_stage_excavator", title, rows, seed=None)
    command = "python -m benchmarks.single_stage_excavator DATA"
    print(write_result(result.model_copy(update={"command": command}), None))


if __name__ == "__main__":
    tyro.cli(main)
