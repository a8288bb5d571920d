"""Measures detection limits: the size from which an effect is visible in the data.

Run ``python -m challenge.limit_measurement``. An effect must move the impact by 3 cm or a channel by 3
standard deviations. Healthy throws are recorded in closed loop. Their commands are replayed open loop on
machines with and without each effect, and the size is found by interpolation. The standard deviation is
that of sensor noise and of healthy machines among themselves. For actuation only joint channels count,
because the joint sensors show its effect on the impact. No limit lies within the nuisance.

No limit lies below what the best linear observer detects (challenge/observer.py) either.
"""

import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from challenge.detection_limits import LIMITS_PATH, limit_key
from challenge.healthy_machines import (
    HealthyMachine,
    healthy_machine,
    nuisance_unit,
    nuisance_width,
)
from challenge.make import open_policy, plan_throws
from challenge.observer import limit_sizes, observe
from challenge.sealed_truth import hidden_drifts
from machine.conventions import ACTIVE_JOINTS, CONTROL_PERIOD_NS, Array, BoolArray
from machine.spec import load_spec
from runtime.control.control_loop import ControlOutputs, ControlParams
from runtime.driver import SensorSample, SimulatedDriver, ValveCommand
from sim_twin.effects.schema import DRIFT
from sim_twin.effects.table import EFFECTS
from sim_twin.faults.fault import Fault
from sim_twin.faults.fault_tables import FAULTS, TABLE_FAULTS
from sim_twin.throws.campaign import ThrowResult, run_throws
from sim_twin.virtual_machine import Condition, VirtualMachine

IMPACT_M: Final = 0.03
CHANNEL_SD: Final = 3.0
SHIFT_PERCENTILE: Final = 95.0
"""Of the ticks: an effect may show for a moment only."""
THROWS: Final = 12
SCATTER_COUNT: Final = 12
WINDOW_S: Final = 0.1
"""After the opening command; later motion of the arm does not affect the throw."""
SEED: Final = 41
FIXED: Final = {
    # Doubles the nominal variance, which twelve throws show; the mean impact does not move.
    "release_jitter.extra_sd_s": 0.020,
    # Three times the noise: an open-loop replay moves nothing but the sensor itself.
    **{f"joint_sensor_bias.{joint}.bias_rad_m": 0.004 for joint in ACTIVE_JOINTS},
}
DRIFT_LIMIT_RATIO: Final = 2.0
"""A ramp from 0 to d has a root mean square of d / sqrt(3), and starts below what is visible."""
ROUNDS: Final = 4
BISECTIONS: Final = 5
CLOSE_RATIO: Final = 1.3
"""A score within this factor of 1 is the limit."""
SENSOR_SD: Final = np.repeat([1.2e-3, 8.0e-3, 6.2e-4], [4, 4, 3])
"""Of joint positions, joint velocities, gyro."""
JOINT_CHANNELS: Final = 8
NUISANCE_SD_COUNT: Final = 3.0 / np.sqrt(3.0)
"""Three standard deviations of a uniform draw, in half widths."""
RELATIVE: Final = ("pump_flow_m3_per_s",)
"""Fields whose effect counts as a share of them."""


class Commands(NamedTuple):
    """What was commanded in recorded throws."""

    start_rad_m: Array
    """(N, 6)"""
    valve_ratio: Array
    """(ticks, N, 4)"""
    opens: BoolArray
    """(ticks, N)"""


class Observed(NamedTuple):
    """What sensors and survey said of a replay."""

    channels: Array
    """(ticks, N, 11)"""
    impact_m: Array
    """(N, 3)"""


class _CommandRecorder:
    """Keeps commands of the only batch of a campaign."""

    def __init__(self) -> None:
        self.valve: list[Array] = []
        self.opens: list[BoolArray] = []

    def begin(self, plant: SimulatedDriver, first_throw_count: int, throw_count: int) -> None:
        """A batch starts."""

    def tick(self, now_ns: int, sample: SensorSample, outputs: ControlOutputs) -> None:
        """Keep one tick."""
        self.valve.append(outputs.command.valve_ratio.copy())
        self.opens.append(outputs.command.gripper_open.copy())

    def end(self, results: Sequence[ThrowResult]) -> None:
        """The batch is over."""


def record_commands(machine: HealthyMachine, policies: Path) -> Commands:
    """Commands of healthy throws of both modes."""
    spec = load_spec()
    starts, valves, opens = [], [], []
    for plan in plan_throws(spec, THROWS, np.random.default_rng(SEED)):
        params = ControlParams(
            spec=spec,
            calibration=machine.calibration,
            mode=plan.mode,
            policy=open_policy(policies, plan.mode),
        )
        plant = VirtualMachine(
            count=len(plan.numbers), unit_seed=0, condition=Condition(unit=machine.unit)
        )
        kept = _CommandRecorder()
        run_throws(plant, params, plan.target_m, plan.start_rad_m, SEED, record=kept)
        starts.append(plan.start_rad_m)
        valves.append(np.stack(kept.valve))
        opens.append(np.stack(kept.opens))
    ticks = min(valve.shape[0] for valve in valves)
    return Commands(
        np.concatenate(starts),
        np.concatenate([valve[:ticks] for valve in valves], axis=1),
        np.concatenate([each[:ticks] for each in opens], axis=1),
    )


def replay(
    commands: Commands, machine: HealthyMachine, effects: tuple[Fault, ...], scatter: int = 0
) -> Observed:
    """Replay commands open loop; `scatter` > 0 takes other noise and other nuisance."""
    unit = machine.unit
    if scatter:
        unit = nuisance_unit(unit, np.random.default_rng([SEED, scatter]))
    count = commands.start_rad_m.shape[0]
    place = np.linspace(0.0, 1.0, count)
    condition = Condition(effects=effects, place_ratio=place, unit=unit)
    plant = VirtualMachine(count=count, unit_seed=0, tracker=False, condition=condition)
    plant.reset(commands.start_rad_m, SEED + scatter)
    channels = []
    for valve, opens in zip(commands.valve_ratio, commands.opens, strict=True):
        plant.write(ValveCommand(valve, opens))
        plant.advance(plant.now_ns() + CONTROL_PERIOD_NS)
        sample = plant.read()
        parts = (
            sample.joint_position_rad_m,
            sample.joint_velocity_rad_m_per_s,
            sample.imu_gyro_rad_per_s,
        )
        channels.append(np.concatenate(parts, axis=1))
    return Observed(np.stack(channels), plant.true_impact_m())


class Meter:
    """Scores effects by what they change in the replay of the same throws."""

    def __init__(self, policies: Path) -> None:
        self._machine = healthy_machine(load_spec(), 0)
        self._commands = record_commands(self._machine, policies)
        opens = self._commands.opens
        late = round(WINDOW_S * 1e9 / CONTROL_PERIOD_NS)
        first = np.where(opens.any(0), opens.argmax(0), opens.shape[0]) + late
        self._window = np.arange(opens.shape[0])[:, None] < first
        self._healthy = replay(self._commands, self._machine, ())
        others = [
            replay(self._commands, self._machine, (), scatter=k + 1).channels
            - self._healthy.channels
            for k in range(SCATTER_COUNT)
        ]
        moved = np.stack(others)[:, self._window]
        self.channel_sd = np.maximum(np.sqrt(np.nanmean(moved**2, axis=(0, 1))), SENSOR_SD)

    def score(self, effect: Fault) -> float:
        """Size of an effect relative to the limit, by its largest visible change; 1 is at the limit."""
        seen = replay(self._commands, self._machine, (effect,))
        shift = np.abs(seen.channels - self._healthy.channels)[self._window]
        channel = np.nanpercentile(shift, SHIFT_PERCENTILE, axis=0) / self.channel_sd / CHANNEL_SD
        if FAULTS[effect.effect].stage == "actuation":
            return float(channel[:JOINT_CHANNELS].max())
        miss = np.linalg.norm((seen.impact_m - self._healthy.impact_m)[:, :2], axis=1)
        known = np.isfinite(miss)
        impact = float(np.sqrt(np.mean(miss[known] ** 2))) if known.any() else 1.0
        return max(float(channel.max()), impact / IMPACT_M)

    def limit(self, effect: str, joint: str | None, parameter: str) -> float:
        """Size at the limit, in the parameter's unit; at most the bound."""
        hidden = FAULTS[effect]
        others = {
            name: 0.5 * (low + high)
            for name, (low, high) in hidden.bounds.items()
            if hidden.strength is not None and name != parameter
        }
        bound = max(hidden.bounds[parameter])

        def score(size: float) -> float:
            return self.score(Fault(effect, joint, {parameter: size, **others}))

        size = 0.2 * bound
        for _ in range(ROUNDS):
            found = score(size)
            if abs(np.log(max(found, 1e-6))) < np.log(CLOSE_RATIO):
                break
            size = float(np.clip(size / max(found, 1e-3), 1e-3 * bound, bound))
        else:
            size = _bisected(score, 0.01 * bound, bound)
        return min(max(size, self._nuisance(effect, joint)), bound)

    def _nuisance(self, effect: str, joint: str | None) -> float:
        """Three standard deviations of the nuisance of a healthy machine."""
        field = EFFECTS[effect].unit_field if effect in EFFECTS else None
        if field is None:
            return 0.0
        width = np.atleast_1d(nuisance_width(self._machine.unit, field))
        if field in RELATIVE:
            width = width / getattr(self._machine.unit, field)
        place = 0 if joint is None else ACTIVE_JOINTS.index(joint)
        return float(NUISANCE_SD_COUNT * width[place])


def _bisected(score: Callable[[float], float], low: float, high: float) -> float:
    """Size of score 1 of an effect with a threshold, by bisection; `high` if its score stays below 1."""
    if score(high) < 1.0:
        return high
    for _ in range(BISECTIONS):
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if score(middle) < 1.0 else (low, middle)
    return high


def measure_limits(policies: Path) -> dict[str, float]:
    """Measure the limits of all effects, joints and parameters that a challenge may hide, and of drifts."""
    meter = Meter(policies)
    shown = limit_sizes(observe(policies))
    limits = {
        name: max(size, shown.get(name, (0.0,))[0]) for name, size in _seen_limits(meter).items()
    }
    for effect, parameter in hidden_drifts():
        for joint in TABLE_FAULTS[effect].joints or (None,):
            key = limit_key(effect, joint, parameter)
            drift = limit_key(DRIFT, joint, f"{effect}.{parameter}")
            limits[drift] = max(DRIFT_LIMIT_RATIO * limits[key], shown[key][1])
    return limits


def _seen_limits(meter: Meter) -> dict[str, float]:
    """Sizes that move the impact or a channel."""
    limits: dict[str, float] = {}
    for effect, hidden in FAULTS.items():
        for joint in hidden.joints or (None,):
            for parameter in hidden.bounds:
                if hidden.strength not in (None, parameter):
                    continue
                key = limit_key(effect, joint, parameter)
                limits[key] = FIXED.get(key) or meter.limit(effect, joint, parameter)
                sys.stderr.write(f"{key} {limits[key]:.3g}\n")
    return limits


def main() -> None:
    """Measure and write the file beside this module."""
    limits = measure_limits(Path("policies"))
    document = {
        "made_by": "python -m challenge.limit_measurement",
        "meaning": f"impact {IMPACT_M} m or a channel {CHANNEL_SD} sd in 5 % of the ticks, unit 0; at least "
        f"what the best linear observer of {THROWS} throws can show",
        "limits": {name: float(f"{size:.4g}") for name, size in limits.items()},
    }
    LIMITS_PATH.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
