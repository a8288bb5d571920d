"""How soon the safety gate sees each fault, whether the arm collides, and false trips without a fault.

Throws of the virtual machine through the real control step, in virtual time. Faults of random kind, size,
joint and moment; once the gate or the throw's checks react, the machine is stopped, as by the throw protocol.
A throw that collides without any fault gets none: its preview refuses it.
Healthy throws, and throws with each effect of the library at its usual size, count trips.

    python -m benchmarks.gate_faults [--jobs 1] [--healthy 5000] [--faults 1025] [--effects 20]
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.result_file import Row, Value, describe, write_result
from evaluation.execution.executor import LocalProcesses, run_tasks
from machine.calibration import nominal_calibration
from machine.conventions import CONTROL_PERIOD_NS, Array, BoolArray, IntArray, Mode, Motion
from machine.spec import load_spec
from machine.starts import sample_starts
from runtime.control import control_loop
from runtime.control.control_loop import ControlInputs, ControlParams
from runtime.control.policy import PolicyRunner, find_policy
from runtime.control.safety import LATCHING, Intervention
from runtime.driver import SensorSample, ValveCommand
from runtime.guard.drive_envelope import motion_ratio
from runtime.guard.release_window import DEFAULT_RADIUS_M, tool_load
from sim_twin.effects.table import EFFECTS
from sim_twin.faults.fault import Fault
from sim_twin.faults.fault_tables import TABLE_FAULTS, UNLISTED_FAULTS
from sim_twin.virtual_machine import Condition, VirtualMachine

SPEC = load_spec()
POLICIES = Path(__file__).parents[1] / "policies"
SEED = 77
UNITS = 20
BATCH = 25
"""Throws simulated at once."""
HEALTHY_TICKS = 900
EFFECT_TICKS = 600
AFTER_TICKS = 150
"""Ticks after a fault that are watched."""
FIRST_TICK, LAST_TICK = 15, 250
"""Of the throw, between which a fault begins."""
BAR_MS, BAR_RAD_OR_M = 150.0, 0.1

SENSOR_FAULTS = (
    "all joints frozen, time goes on",
    "a joint frozen, time goes on",
    "a joint's position frozen",
    "a joint's velocity frozen",
    "encoder jumps",
    "encoder slips",
    "IMU constant, time goes on",
    "IMU silent",
    "IMU turned on its axis",
    "gyro reads zero",
)
VALVE_FAULTS = {
    "valve stuck fully open": 1.0,
    "valve stuck 70 % open": 0.7,
    "valve stuck 40 % open": 0.4,
    "valve stuck shut": 0.0,
    "valve stuck where it was": None,
}
KINDS = (*SENSOR_FAULTS, *VALVE_FAULTS)
NO_FAULT = -1
SLIP_RAD_OR_M_PER_S = 0.2


@dataclass
class Injection:
    """One fault in each of N machines."""

    kind: IntArray
    """(N,) index in `KINDS`, or `NO_FAULT`."""
    joint: IntArray
    start: IntArray
    """(N,) tick."""
    size: Array
    """(N,) -1 to 1: sign and size of what has one."""
    held: dict[str, Array | IntArray] = field(default_factory=dict[str, Array | IntArray])

    @staticmethod
    def draw(count: int, rng: np.random.Generator) -> "Injection":
        """Random faults."""
        size = rng.uniform(0.2, 1.0, count) * rng.choice([-1.0, 1.0], count)
        return Injection(
            rng.integers(0, len(KINDS), count),
            rng.integers(0, 4, count),
            rng.integers(FIRST_TICK, LAST_TICK, count),
            size,
        )

    @staticmethod
    def none(count: int) -> "Injection":
        """No fault."""
        whole = np.zeros(count, dtype=np.int64)
        return Injection(whole + NO_FAULT, whole, whole, np.zeros(count))

    def sense(self, sample: SensorSample, tick: int) -> SensorSample:
        """What broken sensors say."""
        position = sample.joint_position_rad_m.copy()
        velocity = sample.joint_velocity_rad_m_per_s.copy()
        gyro, force = sample.imu_gyro_rad_per_s.copy(), sample.imu_accel_m_per_s2.copy()
        imu_ns = sample.imu_t_mono_ns.copy()
        whole = self._now("all joints frozen, time goes on", tick)[:, None]
        frozen = whole | self._joints("a joint frozen, time goes on", tick)
        self._freeze("position", position, frozen | self._joints("a joint's position frozen", tick))
        self._freeze("velocity", velocity, frozen | self._joints("a joint's velocity frozen", tick))
        jump = self._joints("encoder jumps", tick)
        full = np.array([np.pi, 0.5, 0.5, 0.5])
        position += jump * full * self.size[:, None]
        slip = self._joints("encoder slips", tick)
        since_s = 0.01 * (tick - self.start)
        position += slip * (SLIP_RAD_OR_M_PER_S * since_s * np.sign(self.size))[:, None]
        silent = self._now("IMU silent", tick)
        constant = (silent | self._now("IMU constant, time goes on", tick))[:, None]
        self._freeze("gyro", gyro, constant)
        self._freeze("force", force, constant)
        self._freeze("time", imu_ns, silent)
        turned = self._now("IMU turned on its axis", tick)[:, None]
        gyro = np.where(turned, gyro[:, [2, 0, 1]], gyro)
        force = np.where(turned, force[:, [2, 0, 1]], force)
        gyro = np.where(self._now("gyro reads zero", tick)[:, None], 0.0, gyro)
        return replace(
            sample,
            joint_position_rad_m=position,
            joint_velocity_rad_m_per_s=velocity,
            imu_t_mono_ns=imu_ns,
            imu_gyro_rad_per_s=gyro,
            imu_accel_m_per_s2=force,
        )

    def drive(self, command: ValveCommand, tick: int) -> ValveCommand:
        """What broken valves do."""
        valve = command.valve_ratio.copy()
        was = self._joints("valve stuck where it was", tick)
        self._freeze("valve", valve, was)
        for kind, opening in VALVE_FAULTS.items():
            if opening is not None:
                stuck = (opening * np.sign(self.size))[:, None]
                valve = np.where(self._joints(kind, tick), stuck, valve)
        return replace(command, valve_ratio=valve)

    def _now(self, kind: str, tick: int) -> BoolArray:
        return (self.kind == KINDS.index(kind)) & (tick >= self.start)

    def _joints(self, kind: str, tick: int) -> BoolArray:
        return self._now(kind, tick)[:, None] & (np.arange(4) == self.joint[:, None])

    def _freeze(self, name: str, values: Array | IntArray, where: BoolArray) -> None:
        """Keep what the values were before."""
        held = self.held.setdefault(name, values.copy())
        np.copyto(held, values, where=~where)
        values[:] = held


@dataclass
class Outcome:
    """Of N throws, (N,) each."""

    injection: Injection
    noticed_tick: IntArray
    """Of a trip or an abort; -1 = never."""
    codes: IntArray
    """Bits of `Intervention` that closed the gate first; 0 = none."""
    is_early: BoolArray
    """Noticed before the fault."""
    moved_rad_or_m: Array
    """Largest difference of a joint from the same throw without a fault, when noticed, or at the end."""
    collided: BoolArray
    collided_by_stop: BoolArray
    """So does the same throw without a fault, stopped at the same moment."""
    collided_tick: IntArray
    motion_ratio: Array
    """(N, 4) largest uncommanded motion as a share of its limit, before a collision."""
    tool_load: Array
    """(2, N) largest speed (m/s) and moment (N m) of the tool, before a collision."""


class Throws(NamedTuple):
    """N throws of one unit."""

    unit: int
    mode: Mode
    size: int
    seed: int
    ticks: int
    effects: tuple[Fault, ...] = ()


def simulate(
    given: Throws,
    injection: Injection,
    way: list[Array] | None = None,
    stop_tick: IntArray | None = None,
) -> tuple[Outcome, list[Array]]:
    """Run them.

    Args:
        given: the throws.
        injection: their faults.
        way: (T)(N, 4) positions of the same throws without faults.
        stop_tick: (N,) a person presses STOP then; -1 = never.

    Returns:
        What came of them, and their own way.
    """
    count = given.size
    rng = np.random.default_rng(given.seed)
    reach, bearing = rng.uniform(6.0, 10.5, count), rng.uniform(-np.pi, np.pi, count)
    target = np.stack([reach * np.cos(bearing), reach * np.sin(bearing), np.zeros(count)], axis=1)
    policy = PolicyRunner(find_policy(POLICIES, given.mode), SPEC)
    params = ControlParams(SPEC, nominal_calibration(SPEC), given.mode, policy)
    condition = Condition(effects=given.effects)
    plant = VirtualMachine(count=count, unit_seed=given.unit, condition=condition)
    starts = sample_starts(SPEC, given.mode, target, rng)
    if given.mode is Mode.SPATIAL:
        starts[:, 0] = bearing + rng.uniform(-1.0, 1.0, count)
    plant.reset(starts, given.seed)
    state = control_loop.initial_state(params, plant.read(), target, plant.now_ns())
    motion, pace = np.full(count, int(Motion.THROW)), rng.uniform(0.0, 1.0, count)
    has_fault = injection.kind != NO_FAULT
    noticed, codes = np.full(count, -1), np.zeros(count, dtype=np.int64)
    moved, largest, load = np.zeros(count), np.zeros((count, 4)), np.zeros((2, count))
    collided_tick, path = np.full(count, -1), list[Array]()
    for tick in range(given.ticks):
        now_ns, position = plant.now_ns(), plant.truth().joint_position_rad_m[:, :4].copy()
        path.append(position)
        sample = injection.sense(plant.read(), tick)
        inputs = ControlInputs(sample, motion, target, pace, DEFAULT_RADIUS_M)
        state, out = control_loop.step(params, state, inputs, now_ns)
        plant.write(injection.drive(out.command, tick))
        plant.advance(now_ns + CONTROL_PERIOD_NS)
        code = out.row["safety_code_count"] & int(LATCHING)
        fresh = ((code != 0) | (out.violation_count != 0)) & (noticed < 0)
        codes = np.where(fresh, code, codes)
        noticed = np.where(fresh, tick, noticed)
        if stop_tick is not None:
            noticed = np.where((tick == stop_tick) & (noticed < 0), tick, noticed)
        collided_tick[plant.collided() & (collided_tick < 0)] = tick
        watched = (tick <= injection.start + AFTER_TICKS) & ((noticed < 0) | fresh)
        if way is not None:
            beside = np.abs(position - way[tick]).max(axis=1)
            moved = np.where(watched & has_fault, beside, moved)
        free = ((noticed < 0) | fresh) & (collided_tick < 0)
        used = motion_ratio(SPEC, state.safety.guard.drives)
        largest = np.maximum(largest, free[:, None] * used)
        row = out.row
        tool = tool_load(SPEC, row["joint_position_rad_m"], row["joint_velocity_rad_m_per_s"])
        load = np.maximum(load, free * np.stack(tool))
        motion = control_loop.next_motion(motion, out)
        motion = np.where((motion == Motion.SETTLE) & out.settled, int(Motion.HOLD), motion)
        motion = np.where(noticed >= 0, int(Motion.STOP), motion)
    early = has_fault & (noticed >= 0) & (noticed < injection.start)
    since = collided_tick - injection.start
    collided = (collided_tick >= 0) & (~has_fault | ((since >= 0) & (since <= AFTER_TICKS)))
    outcome = Outcome(
        injection,
        noticed,
        codes,
        early,
        moved,
        collided,
        np.zeros(count, dtype=np.bool_),
        collided_tick,
        largest,
        load,
    )
    return outcome, path


def run_healthy(given: Throws) -> Outcome:
    """Throws without a fault."""
    return simulate(given, Injection.none(given.size))[0]


def run_faulty(given: Throws) -> Outcome:
    """Throws with faults, beside the same ones without; none where those collide."""
    alone, way = simulate(given, Injection.none(given.size))
    injection = Injection.draw(given.size, np.random.default_rng([given.seed, 1]))
    injection.kind[alone.collided] = NO_FAULT
    faulty = simulate(given, injection, way)[0]
    stopped = simulate(given, Injection.none(given.size), stop_tick=faulty.noticed_tick)[0]
    return replace(faulty, collided_by_stop=stopped.collided)


def fault_rows(outcomes: Sequence[Outcome]) -> list[Row]:
    """One row a kind of fault, and one for all."""
    kind = np.concatenate([o.injection.kind for o in outcomes])
    start = np.concatenate([o.injection.start for o in outcomes])
    noticed = np.concatenate([o.noticed_tick for o in outcomes])
    early = np.concatenate([o.is_early for o in outcomes])
    moved = np.concatenate([o.moved_rad_or_m for o in outcomes])
    collided = np.concatenate([o.collided for o in outcomes])
    by_stop = np.concatenate([o.collided_by_stop for o in outcomes])
    seen = (noticed >= start) & (noticed <= start + AFTER_TICKS)
    delay_ms = np.where(seen, (noticed - start) * 10.0, np.inf)
    outside = (delay_ms > BAR_MS) & (moved >= BAR_RAD_OR_M) & ~early

    def row(name: str, chosen: BoolArray) -> Row:
        chosen = chosen & ~early
        delays, ways = delay_ms[chosen & seen], moved[chosen]

        def of(values: Array, share: float) -> Value:
            return Value(value=float(np.quantile(values, share)) if values.size else None)

        counted = {
            "unnoticed_count": chosen & ~seen,
            "outside_the_bar_count": chosen & outside,
            "collided_count": chosen & collided,
            "collided_by_stop_count": chosen & collided & by_stop,
        }
        values = {
            "p50_ms": of(delays, 0.5),
            "p95_ms": of(delays, 0.95),
            "p50_moved_rad_m": of(ways, 0.5),
            "p95_moved_rad_m": of(ways, 0.95),
            "largest_moved_rad_m": of(ways, 1.0),
            **{key: Value(value=float(found.sum())) for key, found in counted.items()},
        }
        return Row(labels={"fault": name}, n=int(chosen.sum()), values=values)

    rows = [row(name, kind == index) for index, name in enumerate(KINDS)]
    return [*rows, row("all", kind != NO_FAULT)]


def trip_row(name: str, outcomes: Sequence[Outcome]) -> Row:
    """Trips of throws without a fault of a sensor or valve; what follows a collision is none."""
    noticed = np.concatenate([o.noticed_tick for o in outcomes])
    codes = np.concatenate([o.codes for o in outcomes])
    collided = np.concatenate([o.collided_tick for o in outcomes])
    largest = np.concatenate([o.motion_ratio for o in outcomes])
    is_first = (noticed >= 0) & ((collided < 0) | (noticed < collided))
    trips = is_first & (codes != 0)
    found = {i.name: int((codes[trips] & int(i) != 0).sum()) for i in Intervention}
    reasons = ", ".join(f"{name} {count}" for name, count in found.items() if count)
    load = np.concatenate([o.tool_load for o in outcomes], axis=1)
    values = {
        "trip_count": Value(value=float(trips.sum())),
        "aborted_count": Value(value=float((is_first & (codes == 0)).sum())),
        "collided_count": Value(value=float((collided >= 0).sum())),
    }
    for joint, label in enumerate(("slew", "boom", "dipper", "telescope")):
        values[f"{label}_used_ratio"] = Value(value=float(largest[:, joint].max()))
    values["largest_tool_m_per_s"] = Value(value=float(load[0].max()))
    values["largest_moment_kn_m"] = Value(value=float(load[1].max()) * 1e-3)
    return Row(labels={"throws": name, "reason": reasons}, n=len(noticed), values=values)


def usual_effects() -> dict[str, list[Fault]]:
    """Each effect on each of its joints and in each direction, at its usual size."""
    found: dict[str, list[Fault]] = {}
    for name, fault in TABLE_FAULTS.items():
        spec = EFFECTS[name]
        signs = (1.0, -1.0) if any(low < 0.0 for low, _ in fault.bounds.values()) else (1.0,)
        for joint in spec.joints or (None,):
            for sign in signs:
                sizes = {
                    p.name: float(np.clip(sign * p.prior_sd, *fault.bounds[p.name]))
                    for p in spec.parameters
                }
                found.setdefault(name, []).append(Fault(name, joint, sizes))
    for name, fault in UNLISTED_FAULTS.items():
        strong = fault.strength or next(iter(fault.bounds))
        sizes = {
            key: 0.5 * high if key == strong else 0.5 * (low + high)
            for key, (low, high) in fault.bounds.items()
        }
        found[name] = [Fault(name, joint, sizes) for joint in fault.joints or (None,)]
    return found


def batches(count: int, ticks: int, seed: int) -> list[Throws]:
    """`count` throws, spread over units and modes in turn."""
    found: list[Throws] = []
    modes = tuple(Mode)
    for number, begin in enumerate(range(0, count, BATCH)):
        unit = (number // 2) % UNITS
        size = min(BATCH, count - begin)
        found.append(Throws(unit, modes[number % 2], size, seed + number, ticks))
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--healthy", type=int, default=5000, help="throws without a fault")
    parser.add_argument("--faults", type=int, default=1025, help="throws with a fault")
    parser.add_argument("--effects", type=int, default=20, help="throws an effect and joint")
    given = parser.parse_args()
    healthy = batches(given.healthy, HEALTHY_TICKS, 1000)
    faulty = batches(given.faults, LAST_TICK + AFTER_TICKS, SEED)
    names: list[str] = []
    with_effect: list[Throws] = []
    for name, effects in usual_effects().items():
        for effect in effects if given.effects else []:
            for mode in Mode:
                names.append(name)
                unit = len(names) % UNITS
                seed = 50_000 + len(names)
                size = max(given.effects // 2, 1)
                with_effect.append(Throws(unit, mode, size, seed, EFFECT_TICKS, (effect,)))
    tasks = [
        *(partial(run_faulty, task) for task in faulty),
        *(partial(run_healthy, task) for task in (*healthy, *with_effect)),
    ]
    outcomes = run_tasks(tasks, LocalProcesses(given.jobs), "gate")
    of_faults, rest = outcomes[: len(faulty)], outcomes[len(faulty) :]
    of_healthy, of_effects = rest[: len(healthy)], rest[len(healthy) :]
    if of_faults:
        result = describe(
            "gate_faults",
            "Safety gate: time until a fault is noticed, motion until then, collisions after it",
            fault_rows(of_faults),
            seed=SEED,
            notes="Bar: within 150 ms, or before 0.1 rad of motion beside the same throw without it. "
            "Collided by stop: of those, the throws that collide without the fault too, when they are "
            "stopped at that moment.",
        )
        print(write_result(result))
    rows = [trip_row("healthy", of_healthy)] if of_healthy else []
    for name in dict.fromkeys(names):
        chosen = [o for o, of in zip(of_effects, names, strict=True) if of == name]
        rows.append(trip_row(name, chosen))
    if rows:
        result = describe(
            "gate_trips",
            "Safety gate: trips of healthy machines, and of machines with an effect at its usual size",
            rows,
            seed=1000,
            notes="used: largest uncommanded motion as a share of the limit that closes the gate.",
        )
        print(write_result(result))


if __name__ == "__main__":
    main()
