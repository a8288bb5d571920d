"""Throws of the twin itself with effects, open loop, as the diagnosis loads them."""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np

from diagnosis.healthy.filters import nothing
from diagnosis.healthy.health import Health
from diagnosis.healthy.noise import ChannelNoise, NoiseModel, Scatter
from diagnosis.hypotheses.gap_problem import GapProblem, pose_problem
from diagnosis.linearisation.nuisances import THROW_NUISANCES, throw_nuisances
from diagnosis.linearisation.parameters import SET_NUISANCES, layout, library, scatter_names
from diagnosis.linearisation.unmodelled_effects import unmodelled_least_sd
from diagnosis.loading.prepared import prepare
from diagnosis.loading.throw_data import LoadedSet, ThrowData
from machine.calibration import nominal_calibration
from machine.conventions import ACTIVE_JOINTS, Array
from machine.kinematics import hanging_pitch_rad
from machine.spec import load_spec
from sim_twin.effects.effect import Effect
from sim_twin.replay.replay import ReplayElement, ReplayInput, ReplayOutput, replay
from sim_twin.twin.profile import TwinProfile, nominal_profile

TICKS = 200
OPEN_TICK = 90
SWITCH_LAG_S = 0.0275


def profile() -> TwinProfile:
    """Of the nominal machine."""
    return nominal_profile(load_spec())


def posed(loaded: LoadedSet) -> GapProblem:
    """Throws of the nominal machine as the diagnosis begins with them."""
    known = health()
    prepared = prepare(loaded.throws, profile())
    return pose_problem(
        prepared, profile(), loaded.throws[0].calibration, known, layout(known.noise)
    )


@cache
def posed_healthy(count: int) -> GapProblem:
    """So many throws without an effect; to be read, never changed."""
    return posed(throws((), count))


def _commands(number: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Start pose (4,) and valve commands (T, 4): boom down, dipper out, sizes and times vary."""
    t = np.arange(TICKS) * 0.01
    size = rng.uniform(0.5, 1.0, 4)
    onset = rng.uniform(0.0, 0.15, 4)
    valve = np.zeros((TICKS, 4))
    side = -1.0 if number % 2 else 1.0
    shapes = (0.6 * side, -0.7, 0.9, 0.5)
    for joint, shape in enumerate(shapes):
        phase = np.clip((t - onset[joint]) / 1.0, 0.0, 1.6)
        valve[:, joint] = shape * size[joint] * np.sin(np.pi * phase)
    return np.array([0.1 * side, 1.0, -0.3, 0.4]), valve


@cache
def _inputs(count: int) -> tuple[ReplayInput, ...]:
    rng = np.random.default_rng(7)
    found: list[ReplayInput] = []
    for number in range(count):
        start, valve = _commands(number, rng)
        position = np.tile(start, (TICKS, 1))
        found.append(
            ReplayInput(
                valve_ratio=valve,
                gripper_open=np.arange(TICKS) >= OPEN_TICK,
                position_rad_m=position,
                velocity_rad_m_per_s=np.zeros((TICKS, 4)),
                swing_start_rad=np.array([float(hanging_pitch_rad(start)), 0.0]),
                swing_rate_start_rad_per_s=np.zeros(2),
                release_t_s=OPEN_TICK * 0.01,
                progress_ratio=number / max(count - 1, 1),
            )
        )
    return tuple(found)


def throws(
    effects: tuple[Effect, ...] = (),
    count: int = 6,
    seed: int = 0,
    received: Callable[[Array], Array] | None = None,
) -> LoadedSet:
    """Throws of a machine that is the nominal twin plus effects, with sensor noise.

    `received` makes of the commands (T, 4) that are recorded those that reach the valves.
    """
    inputs = _inputs(count)
    calibration = nominal_calibration(load_spec())
    elements = [ReplayElement(i, effects) for i in range(count)]
    acting = inputs
    if received is not None:
        acting = tuple(one._replace(valve_ratio=received(one.valve_ratio)) for one in inputs)
    output = replay(acting, elements, profile(), calibration)
    rng = np.random.default_rng(seed)
    found = tuple(_throw(i, inputs[i], output, rng) for i in range(count))
    return LoadedSet(throws=found, refused=(), rates={"control": 100.0}, clocks={})


def _throw(
    number: int, data: ReplayInput, output: ReplayOutput, rng: np.random.Generator
) -> ThrowData:
    t_s: Array = np.arange(TICKS, dtype=np.float64) * 0.01
    noise = rng.standard_normal
    position = output.joint_position_rad_m[number]
    velocity = output.joint_velocity_rad_m_per_s[number]
    joints = np.hstack([position, output.passive_position_rad[number]])
    rates = np.hstack([velocity, output.passive_velocity_rad_per_s[number]])
    evaluated = np.flatnonzero(np.isfinite(output.ball_position_m[number, :, 0]))[::2]
    ball = output.ball_position_m[number, evaluated]
    impact = output.impact_m[number]
    release_s = float(output.release_t_s[number])
    target = np.array([impact[0], impact[1], 0.0])
    spec = load_spec()
    return ThrowData(
        throw_id=f"twin-{number:04d}",
        machine_id="twin",
        mode="3d",
        target_m=target,
        t_s=t_s,
        valve_ratio=data.valve_ratio,
        gripper_open=data.gripper_open,
        sensor_t_s=t_s,
        sensor_position_rad_m=position + 1e-3 * noise(position.shape),
        sensor_velocity_rad_m_per_s=velocity + 5e-3 * noise(velocity.shape),
        joint_position_rad_m=joints,
        joint_velocity_rad_m_per_s=rates,
        imu_t_s=t_s,
        gyro_rad_per_s=output.gyro_rad_per_s[number] + 6e-4 * noise((TICKS, 3)),
        accel_m_per_s2=output.accel_m_per_s2[number] + 4e-3 * noise((TICKS, 3)),
        open_command_t_s=OPEN_TICK * 0.01,
        switch_open_t_s=release_s + SWITCH_LAG_S + 0.005,
        ball_t_s=t_s[evaluated],
        ball_m=ball + 0.02 * noise(ball.shape),
        impact_m=impact + np.array([0.02, 0.02, 0.0]) * noise(3),
        impact_sd_m=0.02,
        impact_t_s=float(output.impact_t_s[number]),
        supply_pressure_pa=np.full(TICKS, 35e6),
        calibration=nominal_calibration(spec),
        spec_sha256=spec.sha256,
        twin_profile=None,
        recorded_at_ns=number,
        path=Path(f"twin-{number}.mcap"),
        notes=(),
    )


THROW_SD = {"release_delay_s": 0.015} | dict.fromkeys(("grasp_x_m", "grasp_y_m", "grasp_z_m"), 0.01)


def health() -> Health:
    """A type of machine whose twin is nearly exact: noise, and a little of everything."""
    blocks = {
        **{f"actuation.{j}": (0.006, 0.004) for j in ACTIVE_JOINTS},
        **{f"swing.gyro.{a}": (0.001, 0.02) for a in "xyz"},
        **{f"swing.accel.{a}": (0.01, 0.6) for a in "xyz"},
        "release.switch": (0.003, 0.0),
        "flight.ball": (0.02, 0.0),
        "flight.impact": (0.02, 0.0),
    }
    channels = {
        name: ChannelNoise(
            noise_sd=noise, floor_sd=floor, rate_ratio=0.0, push_ratio=0.0, memory_s=0.05
        )
        for name, (noise, floor) in blocks.items()
    }
    tolerance = [p.tolerance for p in library()]
    of_throw = [THROW_SD.get(name, 0.003) for name in THROW_NUISANCES]
    of_throw += [0.2 * sd for sd in tolerance]
    of_set = [*tolerance, *(0.003 for _ in SET_NUISANCES), *unmodelled_least_sd()]
    return Health(
        nothing(),
        NoiseModel(
            note="test",
            channels=channels,
            throw_scatter=Scatter.of(throw_nuisances(), np.diag(np.square(of_throw))),
            machine_scatter=Scatter.of(scatter_names(), np.diag(0.5 * np.square(of_set))),
            set_scatter=Scatter.of(scatter_names(), np.diag(0.5 * np.square(of_set))),
            drift_sd={p.key: p.tolerance for p in library()},
            # The smoother of the joints leads by a tick; calibrated machines have it here.
            healthy_mean={
                "imu_latency.extra_latency_s": 0.011,
                **{f"joint_sensor_latency.{j}.extra_latency_s": 0.010 for j in ACTIVE_JOINTS},
            },
            healthy_gap_m={"3d": 0.03},
            unknown_level={name: (0.0, 0.3) for name in blocks if name != "release.switch"},
        ),
    )
