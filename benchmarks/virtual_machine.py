"""Open-loop measurements of the virtual machine: step responses, pump sharing, simulation speed.

    python -m benchmarks.virtual_machine [--unit 0] [--json FOLDER]

Writes three result files: virtual_machine_steps, virtual_machine_pump and virtual_machine_speed.
"""

import argparse
import time
from pathlib import Path

import numpy as np

from benchmarks.result_file import RESULTS, Row, describe, row, write_result
from machine.conventions import ACTIVE_JOINTS, Array
from machine.starts import safe_pose
from runtime.driver import ValveCommand
from sim_twin.virtual_machine import VirtualMachine

TICK_NS = 10_000_000
LOW = ((0.9, 0.2, 0.5), (0.55, 0.5, 0.3), (0.8, 0.0, 0.5), (0.8, 0.2, 0.3))
HIGH = ((0.9, 0.2, 0.5), (1.15, 0.3, 0.3), (0.9, 0.75, 0.3), (0.8, 0.2, 1.0))
"""Start positions of boom, dipper and telescope, by joint, for positive (LOW) and negative (HIGH) motion."""


def start(joint: int, sign: int) -> Array:
    """Start pose (6,) with room for the motion and a plumb gripper."""
    pose = safe_pose()
    pose[1:4] = (LOW if sign > 0 else HIGH)[joint]
    pose[4] = -pose[1] - pose[2]
    return pose


def drive(poses: Array, valves: Array, unit_seed: int) -> tuple[Array, Array]:
    """Velocities (T, N, 4) and pump flows (T, N), l/min, under valve patterns (T, N, 4) from poses (N, 6)."""
    count = poses.shape[0]
    machine = VirtualMachine(count=count, unit_seed=unit_seed)
    machine.reset(poses, seed=1)
    shut = np.zeros(count, dtype=np.bool_)
    speed, flow = [], []
    for valve in valves:
        machine.write(ValveCommand(valve, shut))
        machine.advance(machine.now_ns() + TICK_NS)
        truth = machine.truth()
        speed.append(truth.joint_velocity_rad_m_per_s[:, :4])
        flow.append(truth.pump_flow_m3_per_s * 60e3)
    return np.array(speed), np.array(flow)


def steps(unit_seed: int, amplitude: float) -> list[Row]:
    """Step each joint in both directions, then close: steady speed, dead time, rise, overshoot, ringing."""
    lines: list[Row] = []
    cases = [(j, s) for j in range(4) for s in (1, -1)]
    poses = np.array([start(j, s) for j, s in cases])
    closed_at = {j: 250 if j == 0 else 100 for j in range(4)}
    valves = np.zeros((500, len(cases), 4))
    for i, (j, s) in enumerate(cases):
        valves[: closed_at[j], i, j] = s * amplitude
    speed, flow = drive(poses, valves, unit_seed)
    print(f"\nvalve step of {amplitude:.0%}")
    print("joint      dir  steady  dead_ms  t63_ms  peak/steady  ring_hz  damping  pump_l_per_min")
    for i, (j, s) in enumerate(cases):
        v = s * speed[:, i, j]
        end = closed_at[j]
        steady = float(v[end - 20 : end].mean())
        dead = int(np.argmax(v > 0.03 * steady)) + 1
        rise = int(np.argmax(v > 0.632 * steady)) + 1 - dead
        pumped = flow[end - 20 : end, i].mean()
        hertz, damping = ringing(v[end + 40 : end + 240])
        labels = {"valve": f"{amplitude:.0%}", "joint": ACTIVE_JOINTS[j], "direction": f"{s:+d}"}
        values = {
            "steady_rad_or_m_per_s": steady,
            "dead_time_ms": 10.0 * dead,
            "rise_63_ms": 10.0 * rise,
            "peak_ratio": v[:end].max() / steady,
            "ringing_hz": hertz,
            "damping_ratio": damping,
            "pump_l_per_min": pumped,
        }
        lines.append(row(1, labels, values))
        print(
            f"{ACTIVE_JOINTS[j]:10} {s:+d}  {steady:6.3f}  {dead * 10:7d}  {rise * 10:6d}"
            f"  {v[:end].max() / steady:11.2f}  {hertz:7.1f}  {damping:7.3f}  {pumped:14.0f}"
        )
    return lines


def ringing(velocity: Array) -> tuple[float, float]:
    """Frequency, Hz, and damping ratio from the extrema of a decaying oscillation sampled at 100 Hz."""
    inner = velocity[1:-1]
    extreme = np.flatnonzero((inner - velocity[:-2]) * (inner - velocity[2:]) > 0.0) + 1
    extreme = extreme[np.abs(velocity[extreme]) > 0.004][:9]
    if extreme.size < 4:
        return float("nan"), float("nan")
    swings = np.abs(np.diff(velocity[extreme]))
    decrement = np.log(swings[0] / swings[-1]) / (swings.size - 1)
    if decrement <= 0.0:  # Driven by the swinging gripper.
        return float("nan"), float("nan")
    return 50.0 / float(np.diff(extreme).mean()), float(decrement / np.hypot(np.pi, decrement))


def sharing(unit_seed: int) -> list[Row]:
    """Speed of two joints together over each alone, full valves, 0.3 to 0.6 s after the command."""
    lines: list[Row] = []
    pose = start(1, 1)
    pose[1:4] = (0.6, 0.3, 0.4)
    pose[4] = -0.9
    down = pose.copy()
    down[1:4] = (1.15, 0.2, 0.4)
    down[4] = -1.35
    pairs = [(pose, (1, 1), (2, 1)), (pose, (1, 1), (3, 1)), (pose, (2, 1), (3, 1))]
    pairs += [(pose, (0, 1), (1, 1)), (down, (1, -1), (2, 1))]
    poses, valves = [], []
    for at, a, b in pairs:
        for axes in ((a,), (b,), (a, b)):
            valve = np.zeros(4)
            for joint, sign in axes:
                valve[joint] = sign
            poses.append(at)
            valves.append(valve)
    speed, flow = drive(np.array(poses), np.tile(np.array(valves), (61, 1, 1)), unit_seed)
    mean, pumped = np.abs(speed[30:60]).mean(0), flow[30:60].mean(0)
    print("\ntwo axes at full valve: speed against each alone; pump flow, l/min")
    for k, (_, a, b) in enumerate(pairs):
        first = mean[3 * k + 2, a[0]] / mean[3 * k, a[0]]
        second = mean[3 * k + 2, b[0]] / mean[3 * k + 1, b[0]]
        labels = {
            "first": f"{ACTIVE_JOINTS[a[0]]} {a[1]:+d}",
            "second": f"{ACTIVE_JOINTS[b[0]]} {b[1]:+d}",
        }
        values = {
            "first_ratio": first,
            "second_ratio": second,
            "pump_l_per_min": pumped[3 * k + 2],
        }
        lines.append(row(1, labels, values))
        print(
            f"{ACTIVE_JOINTS[a[0]]:9} {a[1]:+d} {first:5.0%}   {ACTIVE_JOINTS[b[0]]:9} {b[1]:+d}"
            f" {second:5.0%}   pump {pumped[3 * k + 2]:.0f}"
        )
    return lines


def speed() -> list[Row]:
    """Wall and CPU time of a 10 ms tick (write, advance, read), best of 8."""
    lines: list[Row] = []
    print("\ncount  wall_ms/tick  cpu_ms/tick  physics_steps/s  x_real_time (best of 8)")
    for count in (1, 50, 200):
        machine = VirtualMachine(count=count, unit_seed=0)
        poses = np.tile(safe_pose(), (count, 1))
        command = ValveCommand(np.tile([0.3, 0.2, -0.2, 0.1], (count, 1)), np.zeros(count, bool))
        walls, processors = [], []
        for _ in range(8):
            machine.reset(poses, seed=1)
            wall, processor = time.perf_counter(), time.process_time()
            for _ in range(50):
                machine.write(command)
                machine.advance(machine.now_ns() + TICK_NS)
                machine.read()
            walls.append((time.perf_counter() - wall) / 50)
            processors.append((time.process_time() - processor) / 50)
        wall, processor = min(walls), min(processors)
        values = {
            "wall_ms_per_tick": wall * 1e3,
            "cpu_ms_per_tick": processor * 1e3,
            "physics_steps_per_s": count * 5 / wall,
            "real_time_factor": count * 0.01 / wall,
        }
        lines.append(row(8, {"machines": count}, values))
        print(
            f"{count:5d}  {wall * 1e3:12.2f}  {processor * 1e3:11.2f}  {count * 5 / wall:15.0f}"
            f"  {count * 0.01 / wall:.0f}"
        )
    return lines


def main(unit_seed: int, folder: Path) -> None:
    """Measure and write the three results."""
    tables = {
        "virtual_machine_steps": (
            "Valve steps of the virtual machine",
            [*steps(unit_seed, 1.0), *steps(unit_seed, 0.4)],
        ),
        "virtual_machine_pump": ("Two joints at full valve, over each alone", sharing(unit_seed)),
        "virtual_machine_speed": ("Time of one 10 ms tick of the virtual machine", speed()),
    }
    for name, (title, rows) in tables.items():
        write_result(describe(name, title, rows, seed=unit_seed), folder / f"{name}.json")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--unit", type=int, default=0, help="seed of the unit's parameters")
    parser.add_argument("--json", type=Path, default=RESULTS, metavar="FOLDER")
    given = parser.parse_args()
    main(given.unit, given.json)
