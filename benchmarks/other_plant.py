"""Diagnosis of throws of an independent plant, which shares geometry and masses with the twin and no code.

    python -m benchmarks.other_plant [--json FILE] [--variant healthy]

Its drives are two lags in a row behind a pure delay. The body is integrated in steps of 1 ms by Euler's
method with MuJoCo's friction, and the load flies by its own integration. The throws are CSV files without
reference throws. Each row of the result is one variant of machine or recorder, and whether the diagnosis
named what was there.
"""

import argparse
import csv
import json
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import mujoco
import numpy as np

from benchmarks.result_file import RESULTS, Row, describe, row, write_result
from diagnosis.diagnose import diagnose_throws
from diagnosis.loading.logs import load_throws
from diagnosis.loading.throw_data import LoadedSet
from machine.calibration import actuator_ratio, nominal_calibration
from machine.conventions import ACTIVE_JOINTS, GRAVITY_M_PER_S2, PASSIVE_JOINTS, Array
from machine.spec import MJCF_PATH, load_spec
from sim_twin.twin.profile import nominal_profile

SEED = 91
STEP_S, TICK_STEPS = 0.001, 10
TICKS, OPEN_TICK = 200, 90
ARMATURE = 1e9
SLEW_DAMPING_RATIO = 0.25
SLEW_LAG_S = 0.08
"""Of the valve in front of the oil spring."""
SLEW_DELAY_S = 0.15
"""In addition to the nominal dead time: an oil spring comes up sooner than the nominal lag of 0.5 s."""
SLEW_ACCELERATION_RAD_PER_S2 = 1.4
"""Torque limit over inertia."""
FOUR_ZEROS = (0.0, 0.0, 0.0, 0.0)
IMU_UNITS = (("gyro", "rad_per_s"), ("accel", "m_per_s2"))
UNITS = dict(zip(ACTIVE_JOINTS, ("rad", "rad", "rad", "m"), strict=True))


class Variant(NamedTuple):
    """Deviations of this plant's machine and its recorder."""

    speed_reduction_ratio: tuple[float, float, float, float] = FOUR_ZEROS
    noise_ratio: float = 1.0
    """Noise of the joint sensors over that of the twin's."""
    filter_s: float = 0.0
    """Time constant of all joint sensors, positions and velocities alike."""
    row_ticks: int = 1
    """Every so many ticks a row is recorded."""
    release_delay_s: float = 0.0
    has_switch: bool = True
    slew_frequency_hz: float = 0.0
    """Above 0 the slew is an inertia on an oil spring of this frequency; its torque is limited."""


def throws(folder: Path, variant: Variant, count: int = 6, first: int = 0) -> LoadedSet:
    """Throw, write one CSV file a throw, and load them; `first` numbers the commands."""
    rng = np.random.default_rng([SEED, first] if first else SEED)
    folder.mkdir(parents=True, exist_ok=True)
    for number in range(first, first + count):
        _write(folder / f"other-{number}.csv", number, variant, rng)
    return load_throws([folder])


@cache
def _model() -> mujoco.MjModel:
    tree = mujoco.MjSpec.from_file(str(MJCF_PATH))
    for geom in tree.geoms:
        geom.contype = geom.conaffinity = 0
    for joint in tree.joints:
        if joint.name in ACTIVE_JOINTS:
            joint.armature, joint.limited = ARMATURE, 0
    sensor = tree.add_sensor()
    sensor.type, sensor.name = mujoco.mjtSensor.mjSENS_GYRO, "gyro"
    force = tree.add_sensor()
    force.type, force.name = mujoco.mjtSensor.mjSENS_ACCELEROMETER, "accel"
    for one in (sensor, force):
        one.objtype, one.objname = mujoco.mjtObj.mjOBJ_SITE, "imu"
    tree.option.timestep = STEP_S
    tree.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    return tree.compile()


def _commands(number: int) -> tuple[Array, Array]:
    """Start pose (4,) and valve commands (TICKS, 4): up to full speed and back, sizes and times vary."""
    rng = np.random.default_rng([number, 17])
    side = -1.0 if number % 2 else 1.0
    size, onset = rng.uniform(0.6, 1.0, 4), rng.uniform(0.0, 0.15, 4)
    phase = np.clip((np.arange(TICKS)[:, None] * 0.01 - onset) / 1.1, 0.0, 1.5)
    shape = np.array([1.0 * side, -0.7, 0.9, 0.5])
    return np.array([0.1 * side, 1.0, -0.3, 0.4]), shape * size * np.sin(np.pi * phase)


class _Drives:
    """Pure delay, steady speed, cap, and two lags in a row."""

    def __init__(self, variant: Variant) -> None:
        spec = load_spec()
        lag_s = np.asarray(spec.response.lag_s)
        self._variant, self._spec, self._lags_s = variant, spec, (0.35 * lag_s, 0.65 * lag_s)
        self._delay = np.rint(np.asarray(spec.response.dead_time_s) / STEP_S).astype(int)
        self._tables = nominal_calibration(spec).tables
        self._past: list[Array] = []
        self._first, self.velocity = np.zeros(4), np.zeros(4)
        self._slew_acceleration = 0.0
        if variant.slew_frequency_hz > 0.0:
            self._lags_s[0][0] = SLEW_LAG_S
            self._delay[0] += round(SLEW_DELAY_S / STEP_S)

    def step(self, valve: Array, position: Array) -> Array:
        """Velocity (4,) after a step."""
        self._past.append(valve)
        at = len(self._past) - 1 - self._delay
        ratio = np.abs(actuator_ratio(self._spec, position[None]))[0]
        target = np.zeros(4)
        for joint, table in enumerate(self._tables):
            command = self._past[at[joint]][joint] if at[joint] >= 0 else 0.0
            speed = np.interp(command, table.valve_ratio, table.actuator_speed_rad_m_per_s)
            target[joint] = speed / ratio[joint]
        limits = self._spec.limits
        rated = np.where(
            target >= 0.0, limits.speed_positive_rad_m_per_s, limits.speed_negative_rad_m_per_s
        )
        cap = (1.0 - np.asarray(self._variant.speed_reduction_ratio)) * rated
        target = np.clip(target, -cap, cap)
        self._first = self._first + STEP_S * (target - self._first) / self._lags_s[0]
        before = self.velocity[0]
        self.velocity = self.velocity + STEP_S * (self._first - self.velocity) / self._lags_s[1]
        if self._variant.slew_frequency_hz > 0.0:
            self.velocity[0] = self._sprung(before, self._first[0])
        return self.velocity

    def _sprung(self, speed_rad_per_s: float, target_rad_per_s: float) -> float:
        """Slew speed after a step, of an inertia between oil springs with a torque limit."""
        w = 2.0 * np.pi * self._variant.slew_frequency_hz
        pull = w**2 * (target_rad_per_s - speed_rad_per_s)
        pull -= 2.0 * SLEW_DAMPING_RATIO * w * self._slew_acceleration
        self._slew_acceleration += STEP_S * pull
        limit = SLEW_ACCELERATION_RAD_PER_S2
        return speed_rad_per_s + STEP_S * float(np.clip(self._slew_acceleration, -limit, limit))


class _Thrown(NamedTuple):
    position: Array
    velocity: Array
    imu: Array
    release_s: float
    load: Array
    """(6,) position and velocity as it leaves."""


def _throw(start: Array, valve: Array, variant: Variant, delay_s: float) -> _Thrown:
    model = _model()
    data, drives = mujoco.MjData(model), _Drives(variant)
    data.qpos[:4], data.qpos[4] = start, -(start[1] + start[2])
    body = model.body("payload").id
    release_step = round((OPEN_TICK * 0.01 + delay_s) / STEP_S)
    rows: list[Array] = []
    load, evaluated = np.zeros(6), np.concatenate([data.qpos, data.qvel])
    share = 1.0 if variant.filter_s == 0.0 else -np.expm1(-STEP_S / variant.filter_s)
    for step in range(TICKS * TICK_STEPS):
        evaluated = evaluated + share * (np.concatenate([data.qpos, data.qvel]) - evaluated)
        if step % TICK_STEPS == 0:
            mujoco.mj_forward(model, data)
            rows.append(np.concatenate([evaluated, data.sensordata]))
        if step == release_step:
            mujoco.mj_forward(model, data)
            spatial = np.zeros(6)
            mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_BODY, body, spatial, 0)
            load = np.concatenate([data.xpos[body], spatial[3:]])
        wanted = drives.step(valve[step // TICK_STEPS], np.array(data.qpos[:4]))
        data.qfrc_applied[:4] = ARMATURE * (wanted - data.qvel[:4]) / STEP_S
        mujoco.mj_step(model, data)
    table = np.array(rows)
    return _Thrown(table[:, :6], table[:, 6:12], table[:, 12:18], release_step * STEP_S, load)


def _fly(load: Array) -> tuple[Array, Array]:
    """Track (n, 3) every step until the load touches the ground, and where it does (3,)."""
    ball = load_spec().ball
    drag = ball.air_density_kg_per_m3 * ball.drag_coefficient_ratio * np.pi * ball.radius_m**2
    at, speed, track = load[:3].copy(), load[3:].copy(), [load[:3].copy()]
    while at[2] > ball.radius_m:
        pull = -drag / (2.0 * ball.mass_kg) * np.linalg.norm(speed) * speed
        pull[2] -= GRAVITY_M_PER_S2
        at = at + STEP_S * speed + 0.5 * STEP_S**2 * pull
        speed = speed + STEP_S * pull
        track.append(at.copy())
    above, below = track[-2], track[-1]
    share = (above[2] - ball.radius_m) / (above[2] - below[2])
    impact = above + share * (below - above)
    return np.array(track[:-1]), np.array([impact[0], impact[1], 0.0])


def _write(path: Path, number: int, variant: Variant, rng: np.random.Generator) -> None:
    start, valve = _commands(number)
    delay_s = 0.258 + variant.release_delay_s + 0.015 * float(rng.standard_normal())
    done = _throw(start, valve, variant, delay_s)
    track, impact = _fly(done.load)
    normal = rng.standard_normal
    t_s: Array = np.arange(TICKS, dtype=np.float64) * 0.01
    joints = done.position + variant.noise_ratio * 1e-3 * normal((TICKS, 6))
    speeds = done.velocity + variant.noise_ratio * 5e-3 * normal((TICKS, 6))
    columns: dict[str, Array] = {"t_s": t_s}
    for i, joint in enumerate(ACTIVE_JOINTS):
        unit = UNITS[joint]
        for name in ("sensor_position", "position"):
            columns[f"{joint}_{name}_{unit}"] = joints[:, i]
        for name in ("sensor_velocity", "velocity"):
            columns[f"{joint}_{name}_{unit}_per_s"] = speeds[:, i]
        columns[f"{joint}_valve_applied_ratio"] = valve[:, i]
    for i, joint in enumerate(PASSIVE_JOINTS, start=4):
        columns[f"{joint}_position_rad"] = joints[:, i]
        columns[f"{joint}_velocity_rad_per_s"] = speeds[:, i]
    columns["motion_code_count"] = np.where(t_s < done.release_s + 0.05, 2.0, 3.0)
    columns["gripper_open_commanded_ratio"] = (np.arange(TICKS) >= OPEN_TICK).astype(float)
    if variant.has_switch:
        columns["payload_held_ratio"] = (t_s < done.release_s + 0.03).astype(float)
    columns["imu_t_s"] = t_s
    imu = done.imu + np.repeat([6e-4, 4e-3], 3) * normal((TICKS, 6))
    names = [f"{kind}_{axis}_{unit}" for kind, unit in IMU_UNITS for axis in "xyz"]
    columns |= dict(zip(names, imu.T, strict=True))
    columns = {name: values[:: variant.row_ticks] for name, values in columns.items()}
    evaluated = track[::20] + 0.02 * normal((len(track[::20]), 3))
    columns["ball_t_s"] = done.release_s + 0.02 * np.arange(len(evaluated), dtype=np.float64)
    columns |= {f"ball_{axis}_m": values for axis, values in zip("xyz", evaluated.T, strict=True)}
    impact[:2] += 0.02 * normal(2)
    flight_s = STEP_S * len(track)
    context = {
        "throw_id": path.stem,
        "machine_id": "odd",
        "mode": "3d",
        "target": {"x_m": 8.0, "y_m": 0.0, "z_m": 0.0},
        "calibration": nominal_calibration(load_spec()).model_dump(),
        "impact": {"position_m": impact.tolist(), "sd_m": 0.02, "source": "survey"},
        "impact_t_mono_ns": round((done.release_s + flight_s) * 1e9),
        "start_t_mono_ns": 0,
    }
    with path.open("w", encoding="utf-8", newline="") as file:
        file.writelines(f"# {key}: {json.dumps(value)}\n" for key, value in context.items())
        writer = csv.writer(file)
        writer.writerow(columns)
        for row in range(max(map(len, columns.values()))):
            writer.writerow([repr(float(v[row])) if row < len(v) else "" for v in columns.values()])


VARIANTS = (
    ("healthy", Variant(), 6, None),
    ("noisy joint sensors", Variant(noise_ratio=4.0), 6, None),
    ("quiet joint sensors", Variant(noise_ratio=0.02), 6, None),
    ("filtered joint sensors", Variant(filter_s=0.008), 6, None),
    ("50 rows a second", Variant(row_ticks=2), 6, None),
    (
        "slew's speed limited by 40 %",
        Variant(speed_reduction_ratio=(0.4, 0.0, 0.0, 0.0)),
        12,
        ("speed_limit", "slew", "reduction_ratio"),
    ),
    (
        "release 80 ms late, no switch",
        Variant(release_delay_s=0.08, has_switch=False),
        6,
        ("release_delay", None, "extra_delay_s"),
    ),
)
"""Name, variant, throws, and the parameter that should be named; None for a healthy machine."""


def diagnosed(folder: Path, only: str | None = None) -> list[Row]:
    """Diagnose every variant, or one; print and return what was named."""
    rows: list[Row] = []
    for name, variant, count, expected in VARIANTS:
        if only not in (None, name):
            continue
        loaded = throws(folder / name.replace(" ", "-"), variant, count)
        found = diagnose_throws(loaded, nominal_profile(load_spec()))
        named = {
            (e.effect, e.joint, p): fitted.value
            for e in found.causes[0].effects
            for p, fitted in e.parameters.items()
        }
        is_right = found.causes[0].name == "none" if expected is None else expected in named
        size = None if expected is None else named.get(expected)
        print(f"{name:<32} {found.verdict.value:<10} {found.causes[0].name} {size}", flush=True)
        labels = {"variant": name, "verdict": found.verdict.value, "cause": found.causes[0].name}
        rows.append(row(count, labels, {"right_count": float(is_right), "size": size}))
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, default=RESULTS / "other_plant.json")
    parser.add_argument("--variant", choices=[name for name, *_ in VARIANTS], default=None)
    options = parser.parse_args()
    with TemporaryDirectory() as folder:
        rows = diagnosed(Path(folder), options.variant)
    title = "Diagnosis of an independent plant"
    write_result(describe("other_plant", title, rows, seed=SEED), options.json)


if __name__ == "__main__":
    main()
