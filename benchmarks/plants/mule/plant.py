"""The plant as a driver: `downrange record --plant benchmarks.plants.mule.plant:Mule`."""

import json
import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.plants.mule import effects as mule_effects
from benchmarks.plants.mule.library import load_mule
from benchmarks.plants.mule.parameters import field_sizes, nominal, vary_day, vary_unit
from machine.conventions import CONTROL_PERIOD_NS, Array, BoolArray
from runtime.driver import SensorSample, ValveCommand

MILLISECOND_NS = 1_000_000
DAY_NS = 86_400_000_000_000
OPTIONS_VARIABLE = "MULE_OPTIONS"
OUTPUT_FIELDS = (
    *(
        ("joint_time", 1),
        ("position", 4),
        ("velocity", 4),
        ("imu_time", 1),
        ("gyro", 3),
        ("accel", 3),
    ),
    *(
        ("held", 1),
        ("pressure", 1),
        ("ball_time", 1),
        ("ball", 3),
        ("impact_time", 1),
        ("impact", 3),
    ),
    *(("collided", 1), ("true_position", 6)),
)


class Mule:
    """`count` copies of machine number `unit_seed` on day `day_seed`, with `effects` wrong with it.

    Where `day_seed` or `effects` is not given, it comes from the environment variable ``MULE_OPTIONS``, a
    JSON object with these names: commands construct a plant with `count` and `unit_seed` alone. Its `start_s`
    is the time of day at which the plant's clock starts, s.
    """

    def __init__(
        self,
        *,
        count: int = 1,
        unit_seed: int = 0,
        day_seed: int | None = None,
        effects: Sequence[Mapping[str, Any]] | None = None,
    ) -> None:
        options = json.loads(os.environ.get(OPTIONS_VARIABLE, "{}"))
        day = int(options.get("day_seed", 0) if day_seed is None else day_seed)
        wrong = mule_effects.parse_effects(
            options.get("effects", []) if effects is None else effects
        )
        self.count = int(count)
        self._library = load_mule()
        sizes = field_sizes(self._library.mule_parameter_names().decode())
        if sum(sizes.values()) != self._library.mule_parameters_size():
            raise RuntimeError("mule.c: the parameters' names do not fit their struct")
        self.parameters = nominal(sizes)
        vary_unit(self.parameters, int(unit_seed))
        vary_day(self.parameters, int(unit_seed), day)
        for effect in wrong:
            mule_effects.apply(effect, self.parameters)
        self._seed = [int(unit_seed), day]
        self._now_ns = (
            round((1.0 + float(options.get("start_s", 0.0))) * 100) * CONTROL_PERIOD_NS
            + day * DAY_NS
        )
        self._machines = self._library.mule_new(self.count)
        packed = np.concatenate([self.parameters[name] for name in sizes])
        for index in range(self.count):
            self._library.mule_configure(self._machines, index, packed.ctypes.data)
        self._valves = np.zeros((self.count, 4))
        self._open = np.zeros(self.count, dtype=np.uint8)
        self._surface = np.zeros(self.count)
        self._frozen = np.zeros(self.count, dtype=bool)
        width = self._library.mule_output_size()
        self._output = np.zeros((self.count, width))
        if sum(size for _, size in OUTPUT_FIELDS) != width:
            raise RuntimeError("mule.c: the outputs' names do not fit their struct")
        rest = np.array([0.0, 0.5, 0.0, 0.4, -0.5, 0.0])
        self.reset(np.tile(rest, (self.count, 1)), 0)

    def __del__(self) -> None:
        if machines := getattr(self, "_machines", None):
            self._library.mule_free(machines)
            self._machines = None

    def now_ns(self) -> int:
        """The plant's clock; each day starts 24 h after the last."""
        return self._now_ns

    def advance(self, until_ns: int) -> None:
        """Simulate up to this time, in whole ticks of 10 ms."""
        ticks = (until_ns - self._now_ns) // CONTROL_PERIOD_NS
        if ticks > 0:
            valves, opened = self._valves.ctypes.data, self._open.ctypes.data
            start_ms = self._now_ns // MILLISECOND_NS
            self._library.mule_advance(self._machines, self.count, valves, opened, start_ms, ticks)
            self._now_ns += ticks * CONTROL_PERIOD_NS
        if 0 < until_ns - self._now_ns < CONTROL_PERIOD_NS:
            raise ValueError("the plant advances in whole ticks of 10 ms")

    def write(self, command: ValveCommand) -> None:
        """Hold these valves and grippers until the next call."""
        self._valves[:] = np.nan_to_num(command.valve_ratio)
        self._open[:] = command.gripper_open
        if command.supply_enabled is not None:
            self._valves[~np.asarray(command.supply_enabled, dtype=bool)] = 0.0

    def read(self) -> SensorSample:
        """The newest values of all sensors."""
        fields = self._fields()
        nan, times = np.nan, {}
        for name in ("imu_time", "ball_time", "impact_time"):
            times[name] = np.round(fields[name][:, 0] * 1e6).astype(np.int64)
        in_air, landed = times["ball_time"] > 0, times["impact_time"] > 0
        return SensorSample(
            t_mono_ns=round(float(fields["joint_time"].max()) * 1e6),
            joint_position_rad_m=fields["position"].copy(),
            joint_velocity_rad_m_per_s=fields["velocity"].copy(),
            imu_t_mono_ns=times["imu_time"],
            imu_gyro_rad_per_s=fields["gyro"].copy(),
            imu_accel_m_per_s2=fields["accel"].copy(),
            payload_held=fields["held"][:, 0] > 0.5,
            supply_pressure_pa=fields["pressure"][:, 0].copy(),
            local_enable=np.ones(self.count, dtype=bool),
            emergency_stop=np.zeros(self.count, dtype=bool),
            ball_t_mono_ns=times["ball_time"],
            ball_position_m=np.where(in_air[:, None], fields["ball"], nan),
            impact_t_mono_ns=times["impact_time"],
            impact_position_m=np.where(landed[:, None], fields["impact"], nan),
            impact_sd_m=np.where(landed, 0.015, nan),
        )

    def reset(self, joint_position_rad_m: Array, seed: int) -> None:
        """Start over at rest where the sensors report these positions (N, 6), loads in the grippers."""
        poses = np.ascontiguousarray(joint_position_rad_m, dtype=float)
        seeds = np.random.SeedSequence([*self._seed, abs(int(seed))]).generate_state(
            self.count, np.uint64
        )
        self._valves[:] = 0.0
        self._open[:] = 0
        self._frozen[:] = False
        for index in range(self.count):
            pose, start_ms = poses[index], self._now_ns // MILLISECOND_NS
            self._library.mule_reset(
                self._machines, index, pose.ctypes.data, int(seeds[index]), start_ms
            )
        self._set()

    def collided(self) -> BoolArray:
        """(N,) whether the claws have touched ground, arm or chassis since the reset."""
        return self._fields()["collided"][:, 0] > 0.5

    def load(self) -> None:
        """Put a load into every empty gripper."""
        for index in range(self.count):
            self._library.mule_reload(self._machines, index)

    def close(self) -> None:
        """Close the valves."""
        self._valves[:] = 0.0

    def set_surface_height(self, height_m: Array) -> None:
        """(N,) height on which loads land."""
        self._surface[:] = height_m
        self._set()

    def freeze(self, frozen: BoolArray) -> None:
        """(N,) machines that need not move any more until the next reset."""
        self._frozen[:] = frozen
        self._set()

    def true_position_rad_m(self) -> Array:
        """(N, 6) joint positions without sensor errors, for tests."""
        return self._fields()["true_position"].copy()

    def mass_and_gravity(self, index: int = 0) -> tuple[Array, Array]:
        """Mass matrix (6, 6) and forces that hold it against gravity (6,) now, for tests."""
        mass, gravity = np.zeros((6, 6)), np.zeros(6)
        self._library.mule_mass(self._machines, index, mass.ctypes.data, gravity.ctypes.data)
        return mass, gravity

    def _fields(self) -> dict[str, Array]:
        self._library.mule_read(self._machines, self.count, self._output.ctypes.data)
        fields, start = dict[str, Array](), 0
        for name, size in OUTPUT_FIELDS:
            fields[name] = self._output[:, start : start + size]
            start += size
        return fields

    def _set(self) -> None:
        for index in range(self.count):
            surface, frozen = float(self._surface[index]), int(self._frozen[index])
            self._library.mule_set(self._machines, index, surface, frozen)
