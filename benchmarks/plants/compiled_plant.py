"""A plant whose physics is C code, as a driver: compiled once a version of the source, one array of machines.

The C file of a plant ``name`` has the functions of `_Code` with its name in front, as ``name_advance``. What
moves how is its own.
"""

import ctypes
import hashlib
import json
import os
import re
import shutil
import subprocess
import tempfile
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from machine.conventions import CONTROL_PERIOD_NS, Array, BoolArray
from runtime.driver import SensorSample, ValveCommand

DAY_NS = 86_400_000_000_000
BUILD = Path(__file__).parents[2] / "build" / "plants"
OUTPUT_FIELDS = (
    ("joint_time", 1),
    ("position", 4),
    ("velocity", 4),
    ("imu_time", 1),
    ("gyro", 3),
    ("accel", 3),
    ("held", 1),
    ("pressure", 1),
    ("ball_time", 1),
    ("ball", 3),
    ("impact_time", 1),
    ("impact", 3),
    ("collided", 1),
    ("true_position", 6),
)
"""Fields of the C struct of a machine's sensors, with their lengths."""


class NoCompilerError(RuntimeError):
    """No C compiler is installed."""


def find_compiler() -> str | None:
    """Path of the C compiler: ``$CC``, cc, gcc or clang; None where there is none."""
    names = [os.environ.get("CC"), "cc", "gcc", "clang"]
    return next((path for name in names if name and (path := shutil.which(name))), None)


def compiled_file(source: Path) -> Path:
    """Where the compiled code of a source lies; copy it along to computers without a compiler."""
    digest = hashlib.sha256(source.read_bytes()).hexdigest()[:16]
    return BUILD / f"{source.stem}-{digest}-{os.uname().machine}.so"


def can_load(source: Path) -> bool:
    """Whether a source is compiled, or can be."""
    return compiled_file(source).exists() or find_compiler() is not None


def load(source: Path, standard: str) -> ctypes.CDLL:
    """The code of a source, compiled where that is missing.

    Args:
        source: C file.
        standard: of the language, for the compiler.

    Raises:
        NoCompilerError: it is not compiled, and there is no C compiler.
        subprocess.CalledProcessError: it does not compile.
    """
    target = compiled_file(source)
    if not target.exists():
        _compile(source, target, standard)
    return ctypes.CDLL(str(target))


def _compile(source: Path, target: Path, standard: str) -> None:
    """Compile beside the target, then rename: several processes may do this at once."""
    compiler = find_compiler()
    if compiler is None:
        raise NoCompilerError(
            f"the plant `{source.stem}` is C code: install a C compiler (gcc or clang), set CC to one, or "
            f"copy {target} from a computer with one"
        )
    target.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=target.parent) as folder:
        made = Path(folder) / target.name
        flags = ["-O3", f"-std={standard}", "-Wall", "-Wextra", "-shared", "-fPIC"]
        subprocess.run([compiler, *flags, "-o", str(made), str(source), "-lm"], check=True)
        made.replace(target)


def field_sizes(names: str) -> dict[str, int]:
    """Fields of the C struct by name with their lengths, in order."""
    return {name: int(size) or 1 for name, size in re.findall(r"(\w+):(\d+)", names)}


class _Code:
    """Functions of a plant's C code, without its name in front."""

    def __init__(self, source: Path, standard: str, time: type[Any]) -> None:
        library, name = load(source, standard), source.stem
        pointer, integer, number = ctypes.c_void_p, ctypes.c_int, ctypes.c_double
        arguments: dict[str, tuple[Any, ...]] = {
            "parameter_names": (),
            "parameters_size": (),
            "output_size": (),
            "new": (integer,),
            "free": (pointer,),
            "configure": (pointer, integer, pointer),
            "reset": (pointer, integer, pointer, ctypes.c_uint64, time),
            "reload": (pointer, integer),
            "set": (pointer, integer, number, integer),
            "advance": (pointer, integer, pointer, pointer, time, integer),
            "read": (pointer, integer, pointer),
            "mass": (pointer, integer, pointer, pointer),
        }
        results = {"parameter_names": ctypes.c_char_p, "new": pointer}
        self._functions: dict[str, Any] = {}
        for function, types in arguments.items():
            found = library[f"{name}_{function}"]
            found.argtypes, found.restype = types, results.get(function, integer)
            self._functions[function] = found

    def __getattr__(self, name: str) -> Any:
        return self._functions[name]


class CompiledPlant(ABC):
    """`count` copies of machine number `unit_seed` on day `day_seed`, with `effects` wrong with it.

    Where `day_seed` or `effects` is not given, it comes from the environment variable `options_variable`, a
    JSON object with these names: commands construct a plant with `count` and `unit_seed` alone. Its `start_s`
    is the time of day at which the plant's clock starts, s.
    """

    source: ClassVar[Path]
    """C file, named as the plant."""
    standard: ClassVar[str] = "c11"
    options_variable: ClassVar[str]
    time: ClassVar[type[Any]] = ctypes.c_double
    """C type of the plant's times."""
    time_unit_ns: ClassVar[float] = 1e9
    survey_sd_m: ClassVar[float]
    """Standard deviation of the survey of an impact."""

    def __init__(
        self,
        *,
        count: int = 1,
        unit_seed: int = 0,
        day_seed: int | None = None,
        effects: Sequence[Mapping[str, Any]] | None = None,
    ) -> None:
        options = json.loads(os.environ.get(self.options_variable, "{}"))
        day = int(options.get("day_seed", 0) if day_seed is None else day_seed)
        wrong = options.get("effects", []) if effects is None else effects
        self.count = int(count)
        self._code = _Code(self.source, self.standard, self.time)
        sizes = field_sizes(self._code.parameter_names().decode())
        if sum(sizes.values()) != self._code.parameters_size():
            raise RuntimeError(f"{self.source.name}: the parameters' names do not fit their struct")
        self.parameters = self._parameters(sizes, int(unit_seed), day, wrong)
        self._seed = [int(unit_seed), day]
        self._now_ns = (
            round((1.0 + float(options.get("start_s", 0.0))) * 100) * CONTROL_PERIOD_NS
            + day * DAY_NS
        )
        self._machines = self._code.new(self.count)
        packed = np.concatenate([self.parameters[name] for name in sizes])
        for index in range(self.count):
            self._code.configure(self._machines, index, packed.ctypes.data)
        self._valves = np.zeros((self.count, 4))
        self._open = np.zeros(self.count, dtype=np.uint8)
        self._surface = np.zeros(self.count)
        self._frozen = np.zeros(self.count, dtype=bool)
        width = self._code.output_size()
        self._output = np.zeros((self.count, width))
        if sum(size for _, size in OUTPUT_FIELDS) != width:
            raise RuntimeError(f"{self.source.name}: the outputs' names do not fit their struct")
        rest = np.array([0.0, 0.5, 0.0, 0.4, -0.5, 0.0])
        self.reset(np.tile(rest, (self.count, 1)), 0)

    @abstractmethod
    def _parameters(
        self,
        sizes: Mapping[str, int],
        unit_seed: int,
        day_seed: int,
        effects: Sequence[Mapping[str, Any]],
    ) -> dict[str, Any]:
        """Parameters of a machine on a day with effects: arrays by field of the C struct."""

    @abstractmethod
    def _time(self) -> float:
        """The present time in the C code's unit."""

    def __del__(self) -> None:
        if machines := getattr(self, "_machines", None):
            self._code.free(machines)
            self._machines = None

    def now_ns(self) -> int:
        """The plant's clock; each day starts 24 h after the last."""
        return self._now_ns

    def advance(self, until_ns: int) -> None:
        """Simulate up to this time, in whole ticks of 10 ms."""
        ticks = (until_ns - self._now_ns) // CONTROL_PERIOD_NS
        if ticks > 0:
            valves, opened = self._valves.ctypes.data, self._open.ctypes.data
            start = self._time()
            self._code.advance(self._machines, self.count, valves, opened, start, ticks)
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
            times[name] = np.round(fields[name][:, 0] * self.time_unit_ns).astype(np.int64)
        in_air, landed = times["ball_time"] > 0, times["impact_time"] > 0
        return SensorSample(
            t_mono_ns=round(float(fields["joint_time"].max()) * self.time_unit_ns),
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
            impact_sd_m=np.where(landed, self.survey_sd_m, nan),
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
            pose, start = poses[index], self._time()
            self._code.reset(self._machines, index, pose.ctypes.data, int(seeds[index]), start)
        self._set()

    def collided(self) -> BoolArray:
        """(N,) whether the claws have touched ground, arm or chassis since the reset."""
        return self._fields()["collided"][:, 0] > 0.5

    def load(self) -> None:
        """Put a load into every empty gripper."""
        for index in range(self.count):
            self._code.reload(self._machines, index)

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

    def mass_and_bias(self, index: int = 0) -> tuple[Array, Array]:
        """Mass matrix (6, 6) and the forces (6,) that its bodies meet without acceleration, for tests."""
        mass, bias = np.zeros((6, 6)), np.zeros(6)
        self._code.mass(self._machines, index, mass.ctypes.data, bias.ctypes.data)
        return mass, bias

    def _fields(self) -> dict[str, Array]:
        self._code.read(self._machines, self.count, self._output.ctypes.data)
        fields, start = dict[str, Array](), 0
        for name, size in OUTPUT_FIELDS:
            fields[name] = self._output[:, start : start + size]
            start += size
        return fields

    def _set(self) -> None:
        for index in range(self.count):
            surface, frozen = float(self._surface[index]), int(self._frozen[index])
            self._code.set(self._machines, index, surface, frozen)
