"""How soon the safety gate sees each fault, whether the arm collides after it, and false trips without one.

Throws of the virtual machine through the real control step. A fault begins at a random time of the throw.
Once the gate or the checks react, the machine is stopped, as the throw protocol does. Runs without a fault
count false trips.

    python benchmarks/gate_faults.py [--units 20] [--throws 8] [--faults 8]
"""

import argparse
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path

import numpy as np

from benchmarks.result_file import Result, Row, Value, describe, write_result
from machine.calibration import nominal_calibration
from machine.conventions import CONTROL_PERIOD_NS, Array, Mode, Motion
from machine.spec import load_spec
from machine.starts import sample_starts
from runtime.control import control_loop
from runtime.control.control_loop import ControlInputs, ControlParams
from runtime.control.policy import PolicyRunner, find_policy
from runtime.control.safety import LATCHING
from runtime.driver import SensorSample, ValveCommand
from runtime.guard.release_window import DEFAULT_RADIUS_M
from sim_twin.virtual_machine import VirtualMachine

SPEC = load_spec()
POLICIES = Path(__file__).parents[1] / "policies"
LIMIT_TICKS = 900
AFTER_TICKS = 150
"""Ticks after a fault that are watched for a collision."""


@dataclass
class Injection:
    """One fault in N machines, each from its own tick on."""

    kind: str
    start: Array
    """(N,) ticks."""
    held: dict[str, Array] = field(default_factory=dict)

    def active(self, tick: int) -> Array:
        return tick >= self.start

    def hold(self, name: str, values: Array, active: Array) -> Array:
        """Values as they were when the fault began."""
        known = self.held.setdefault(name, values.copy())
        known[~active] = values[~active]
        return known.copy()


def _frozen(names: tuple[str, ...], joints: list[int]) -> Callable[..., SensorSample]:
    def change(injection: Injection, sample: SensorSample, active: Array) -> SensorSample:
        changes = {}
        for name in names:
            values = getattr(sample, name).copy()
            held = injection.hold(name, values, active)
            values[:, joints] = held[:, joints]
            changes[name] = values
        return replace(sample, **changes)

    return change


def _offset(joint: int, size: float) -> Callable[..., SensorSample]:
    def change(_: Injection, sample: SensorSample, active: Array) -> SensorSample:
        position = sample.joint_position_rad_m.copy()
        position[active, joint] += size
        return replace(sample, joint_position_rad_m=position)

    return change


def _imu_constant(injection: Injection, sample: SensorSample, active: Array) -> SensorSample:
    return replace(
        sample,
        imu_gyro_rad_per_s=injection.hold("gyro", sample.imu_gyro_rad_per_s, active),
        imu_accel_m_per_s2=injection.hold("accel", sample.imu_accel_m_per_s2, active),
    )


def _imu_silent(injection: Injection, sample: SensorSample, active: Array) -> SensorSample:
    frozen = _imu_constant(injection, sample, active)
    return replace(frozen, imu_t_mono_ns=injection.hold("t", sample.imu_t_mono_ns, active))


POSITION, VELOCITY = "joint_position_rad_m", "joint_velocity_rad_m_per_s"
SENSOR_FAULTS: dict[str, Callable[..., SensorSample]] = {
    "all joints frozen, time goes on": _frozen((POSITION, VELOCITY), [0, 1, 2, 3]),
    "boom frozen, time goes on": _frozen((POSITION, VELOCITY), [1]),
    "dipper frozen, time goes on": _frozen((POSITION, VELOCITY), [2]),
    "dipper position frozen": _frozen((POSITION,), [2]),
    "boom encoder +0.5 rad": _offset(1, 0.5),
    "dipper encoder -0.2 rad": _offset(2, -0.2),
    "slew encoder +90 degrees": _offset(0, np.pi / 2),
    "IMU constant, time goes on": _imu_constant,
    "IMU silent": _imu_silent,
}
VALVE_FAULTS: dict[str, tuple[int, float | None]] = {
    "boom valve stuck at +0.7": (1, 0.7),
    "boom valve stuck at -0.7": (1, -0.7),
    "dipper valve stuck at +0.7": (2, 0.7),
    "dipper valve stuck at -0.7": (2, -0.7),
    "telescope valve stuck at +0.7": (3, 0.7),
    "slew valve stuck at +0.7": (0, 0.7),
    "dipper valve stuck where it was": (2, None),
}
FAULT_KINDS = (*SENSOR_FAULTS, *VALVE_FAULTS)


@dataclass
class Outcome:
    """Of N throws, (N,) each."""

    noticed_tick: Array
    """-1 = never."""
    start: Array
    moved_rad_m: Array
    """Largest difference of a joint, when the fault was noticed, from the same throw without a fault."""
    way_rad_m: Array
    """(T, N, 4) true joint positions."""
    collided: Array
    landed: Array


def throw(
    unit: int, mode: Mode, count: int, seed: int, kind: str | None, known: Array | None = None
) -> Outcome:
    """N throws of one unit, with one kind of fault, or none; `known` is the way of those without."""
    rng = np.random.default_rng(seed)
    reach, bearing = rng.uniform(6.0, 10.5, count), rng.uniform(-np.pi, np.pi, count)
    target = np.stack([reach * np.cos(bearing), reach * np.sin(bearing), np.zeros(count)], axis=1)
    params = ControlParams(
        SPEC, nominal_calibration(SPEC), mode, PolicyRunner(find_policy(POLICIES, mode), SPEC)
    )
    plant = VirtualMachine(count=count, unit_seed=unit)
    starts = sample_starts(SPEC, mode, target, rng)
    if mode is Mode.SPATIAL:
        starts[:, 0] = bearing + rng.uniform(-1.0, 1.0, count)
    plant.reset(starts, seed)
    state = control_loop.initial_state(params, plant.read(), target, plant.now_ns())
    motion = np.full(count, int(Motion.THROW))
    pace = rng.uniform(0.0, 1.0, count)
    start = rng.integers(15, 250, count) if kind else np.full(count, LIMIT_TICKS)
    injection = Injection(kind or "", start)
    joint, stuck = VALVE_FAULTS.get(kind or "", (0, None))
    noticed, way = np.full(count, -1), []
    moved, collided = np.zeros(count), np.zeros(count, dtype=np.bool_)
    last = LIMIT_TICKS if kind is None else int(start.max()) + AFTER_TICKS
    before = plant.collided()
    for tick in range(last):
        now_ns, sample = plant.now_ns(), plant.read()
        way.append(plant.truth().joint_position_rad_m[:, :4].copy())
        active = injection.active(tick)
        if kind in SENSOR_FAULTS:
            sample = SENSOR_FAULTS[kind](injection, sample, active)
        inputs = ControlInputs(sample, motion, target, pace, DEFAULT_RADIUS_M)
        state, out = control_loop.step(params, state, inputs, now_ns)
        command = out.command
        if kind in VALVE_FAULTS:
            valve = command.valve_ratio.copy()
            held = injection.hold("valve", valve, active)
            valve[active, joint] = held[active, joint] if stuck is None else stuck
            command = ValveCommand(
                valve, command.gripper_open, command.supply_enabled, command.alive_count
            )
        plant.write(command)
        plant.advance(now_ns + CONTROL_PERIOD_NS)
        tripped = (out.row["safety_code_count"] & int(LATCHING) != 0) | (out.violation_count != 0)
        fresh = tripped & (noticed < 0)
        noticed[fresh] = tick
        if known is not None and fresh.any():
            beside = np.abs(way[-1] - known[tick]).max(axis=1)
            moved = np.where(fresh, beside, moved)
        # The fault was in before the load left, and what is watched is near in time.
        watched = active & (tick < start + AFTER_TICKS)
        collided |= watched & plant.collided() & ~before
        before = plant.collided()
        motion = control_loop.next_motion(motion, out)
        motion = np.where((motion == Motion.SETTLE) & out.settled, int(Motion.HOLD), motion)
        motion = np.where(noticed >= 0, int(Motion.STOP), motion)
    landed = np.isfinite(plant.true_impact_m()).all(axis=1)
    return Outcome(noticed, start, moved, np.stack(way), collided, landed)


def healthy(units: int, throws: int) -> Row:
    """False trips."""
    trips = count = 0
    for unit in range(units):
        for mode in Mode:
            found = throw(unit, mode, throws, 1000 * unit + throws, None)
            trips += int((found.noticed_tick >= 0).sum())
            count += throws
            if (found.noticed_tick >= 0).any():
                print(f"  unit {unit} {mode.value}: trips at {found.noticed_tick.tolist()}")
    empty = Value(value=None)
    values = {
        "p50_ms": empty,
        "max_ms": empty,
        "unnoticed_count": empty,
        "moved_max_rad_or_m": empty,
        "collided_count": empty,
        "false_trip_count": Value(value=float(trips)),
    }
    return Row(labels={"fault": "none"}, n=count, values=values)


@cache
def _healthy_way(unit: int, mode: Mode, count: int) -> Array:
    return throw(unit, mode, count, 77 + unit, None).way_rad_m


def faulty(kind: str, count: int, units: tuple[int, ...]) -> Row:
    """Detection of one kind of fault, in half of the throws each mode."""
    delays: list[float] = []
    moved: list[float] = []
    collided = early = 0
    for unit in units:
        for mode in Mode:
            known = _healthy_way(unit, mode, count)
            found = throw(unit, mode, count, 77 + unit, kind, known)
            delay = (found.noticed_tick - found.start) * 10.0
            early += int(((found.noticed_tick >= 0) & (delay < 0)).sum())
            delays += [float("inf") if n < 0 else float(d) for n, d in
                       zip(found.noticed_tick, delay, strict=True)]  # fmt: skip
            moved += [float(m) for m in found.moved_rad_m]
            collided += int(found.collided.sum())
    seen = [d for d in delays if np.isfinite(d)]
    values = {
        "p50_ms": Value(value=float(np.median(seen)) if seen else None),
        "max_ms": Value(value=max(seen) if seen else None),
        "unnoticed_count": Value(value=float(len(delays) - len(seen))),
        "moved_max_rad_or_m": Value(value=max(moved)),
        "collided_count": Value(value=float(collided)),
        "false_trip_count": Value(value=float(early)),
    }
    return Row(labels={"fault": kind}, n=len(delays), values=values)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--units", type=int, default=20)
    parser.add_argument("--throws", type=int, default=8, help="healthy throws a unit and mode")
    parser.add_argument("--faults", type=int, default=8, help="throws a unit, mode and fault")
    parser.add_argument("--only", default="", help="part of a fault's name")
    given = parser.parse_args()
    rows: list[Row] = []
    for kind in FAULT_KINDS:
        if given.only in kind and given.faults:
            rows.append(faulty(kind, given.faults, (3, 11)))
            print(kind, {name: value.value for name, value in rows[-1].values.items()}, flush=True)
    if not given.only and given.throws:
        rows.append(healthy(given.units, given.throws))
        print("healthy", rows[-1].n, rows[-1].values["false_trip_count"].value)
    if given.only:
        return
    result: Result = describe(
        "gate_faults",
        "Safety gate: time until a fault is noticed, collisions after it, false trips",
        rows,
        seed=77,
        notes="Bars: 150 ms or 0.1 rad, no collision, no false trip.",
    )
    print(write_result(result))


if __name__ == "__main__":
    main()
