"""Measure the virtual machine open loop: `python -m benchmarks.virtual_machine [unit_seed]`.

Prints the tables of docs/virtual_machine.md: steady speeds, dead and rise times, ringing, pump sharing,
and how fast it runs.
"""

import sys
import time

import numpy as np

from machine.conventions import ACTIVE_JOINTS, Array
from machine.starts import safe_pose
from runtime.driver import ValveCommand
from sim_twin.virtual.virtual_machine import VirtualMachine

TICK_NS = 10_000_000
LOW = ((0.9, 0.2, 0.5), (0.55, 0.5, 0.3), (0.8, 0.0, 0.5), (0.8, 0.2, 0.3))
HIGH = ((0.9, 0.2, 0.5), (1.15, 0.3, 0.3), (0.9, 0.75, 0.3), (0.8, 0.2, 1.0))
"""Boom, dipper and telescope where each joint starts for a positive and a negative motion."""


def start(joint: int, sign: int) -> Array:
    """A hanging start pose with room for this motion."""
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


def steps(unit_seed: int, amplitude: float) -> None:
    """Step each joint both ways, then close: steady speed, dead time, rise, overshoot, ringing."""
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
        print(
            f"{ACTIVE_JOINTS[j]:10} {s:+d}  {steady:6.3f}  {dead * 10:7d}  {rise * 10:6d}"
            f"  {v[:end].max() / steady:11.2f}  {hertz:7.1f}  {damping:7.3f}  {pumped:14.0f}"
        )


def ringing(velocity: Array) -> tuple[float, float]:
    """Frequency and damping ratio from the extremes of a decaying oscillation at 100 Hz."""
    inner = velocity[1:-1]
    extreme = np.flatnonzero((inner - velocity[:-2]) * (inner - velocity[2:]) > 0.0) + 1
    extreme = extreme[np.abs(velocity[extreme]) > 0.004][:9]
    if extreme.size < 4:
        return float("nan"), float("nan")
    swings = np.abs(np.diff(velocity[extreme]))
    decrement = np.log(swings[0] / swings[-1]) / (swings.size - 1)
    if decrement <= 0.0:  # driven by the swinging gripper
        return float("nan"), float("nan")
    return 50.0 / float(np.diff(extreme).mean()), float(decrement / np.hypot(np.pi, decrement))


def sharing(unit_seed: int) -> None:
    """Two axes at once against each alone, full valves, 0.3 to 0.6 s after the command."""
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
        print(
            f"{ACTIVE_JOINTS[a[0]]:9} {a[1]:+d} {first:5.0%}   {ACTIVE_JOINTS[b[0]]:9} {b[1]:+d}"
            f" {second:5.0%}   pump {pumped[3 * k + 2]:.0f}"
        )


def rate() -> None:
    """Wall and CPU time of a 10 ms tick (write, advance, read)."""
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
        print(
            f"{count:5d}  {wall * 1e3:12.2f}  {processor * 1e3:11.2f}  {count * 5 / wall:15.0f}"
            f"  {count * 0.01 / wall:.0f}"
        )


if __name__ == "__main__":
    seed = int(sys.argv[1]) if len(sys.argv) > 1 else 0
    steps(seed, 1.0)
    steps(seed, 0.4)
    sharing(seed)
    rate()
