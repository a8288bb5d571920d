"""Replays of recorded throws in the twin: open loop, from logged valve commands or measured motion.

Open loop: no policy, no controller, no random numbers.
"""

from collections.abc import Sequence

import numpy as np

from machine.calibration import ValveCalibration
from machine.conventions import (
    ACTIVE_COUNT,
    CONTROL_PERIOD_NS,
    CONTROL_PERIOD_S,
    Array,
    IntArray,
)
from machine.errors import UsageError
from machine.spec import load_spec
from runtime.driver import ValveCommand
from sim_twin.effects.arrays import effect_arrays
from sim_twin.effects.effect import Effect, deterministic
from sim_twin.replay.motion import ReplayMotion, padded
from sim_twin.replay.types import Flight, ReplayElement, ReplayInput, ReplayOutput
from sim_twin.twin.payload import NEVER_NS, Payload
from sim_twin.twin.profile import TwinProfile, exact_profile
from sim_twin.twin.twin import Twin

__all__ = [
    "Flight",
    "ReplayElement",
    "ReplayInput",
    "ReplayOutput",
    "fly",
    "replay",
]

MAX_FLIGHT_TICKS = 600


def replay(
    inputs: Sequence[ReplayInput],
    elements: Sequence[ReplayElement],
    profile: TwinProfile,
    calibration: ValveCalibration,
) -> ReplayOutput:
    """Simulate all elements side by side.

    Args:
        inputs: recorded throws.
        elements: simulations.
        profile: profile of the machine; its effects act in every element.
        calibration: valve tables of the machine.

    Raises:
        UsageError: an element refers to a missing input or measurement, or an input's arrays have
            inconsistent shapes.
    """
    _check(inputs, elements)
    throws = [inputs[e.throw] for e in elements]
    twin = Twin(
        count=len(elements),
        profile=exact_profile(profile),
        calibration=calibration,
        effects=[deterministic(e.effects) for e in elements],
        progress_ratio=np.array([t.progress_ratio for t in throws]),
        sees_contacts=False,
    )
    ticks = max(t.valve_ratio.shape[0] for t in throws)
    motion = ReplayMotion(twin, throws, elements, ticks)
    twin.reset(motion.reported_start, 0)
    twin.start_moving(*motion.start)
    twin.payload.surface_height_m[:] = [t.surface_height_m for t in throws]
    start_ns = twin.now_ns()
    twin.payload.open_at(*_openings(throws, elements, start_ns))
    tape = _Tape(twin, ticks)
    closed = np.zeros(twin.count, dtype=np.bool_)
    valve = np.stack([padded(t.valve_ratio, ticks, hold=False) for t in throws], axis=1)
    tape.state(0)
    for tick in range(ticks):
        twin.prescribe(motion.after(tick))
        twin.write(ValveCommand(valve[tick], closed))
        twin.advance(twin.now_ns() + CONTROL_PERIOD_NS)
        tape.imu(tick)
        if tick + 1 < ticks:
            tape.state(tick + 1)
    _land(twin.payload, twin.now_ns())
    length = np.array([t.valve_ratio.shape[0] for t in throws])
    return tape.output(length, start_ns)


def _check(inputs: Sequence[ReplayInput], elements: Sequence[ReplayElement]) -> None:
    if not elements:
        raise UsageError("a replay needs at least one element")
    for number, throw in enumerate(inputs):
        ticks = throw.valve_ratio.shape[0]
        wanted = {
            "valve_ratio": (ticks, ACTIVE_COUNT),
            "gripper_open": (ticks,),
            "position_rad_m": (ticks, ACTIVE_COUNT),
            "velocity_rad_m_per_s": (ticks, ACTIVE_COUNT),
            "swing_start_rad": (2,),
            "swing_rate_start_rad_per_s": (2,),
            "swing_rad": (ticks, 2),
            "swing_rate_rad_per_s": (ticks, 2),
            "gyro_rad_per_s": (ticks, 3),
            "start_force_m_per_s2": (3,),
        }
        for name, shape in wanted.items():
            value = getattr(throw, name)
            if value is None:
                continue
            if ticks < 2 or value.shape != shape or not np.isfinite(value).all():
                raise UsageError(
                    f"replay input {number}: {name} must be finite numbers of shape {shape} over 2 or "
                    f"more ticks, got shape {value.shape}"
                )
    for number, element in enumerate(elements):
        if not 0 <= element.throw < len(inputs):
            raise UsageError(
                f"replay element {number} names throw {element.throw} of {len(inputs)} inputs"
            )
        throw = inputs[element.throw]
        if element.measured_swing and (
            throw.swing_rad is None or throw.swing_rate_rad_per_s is None
        ):
            raise UsageError(
                f"replay element {number} takes the swing as measured, but throw {element.throw} has "
                "no swing_rad and swing_rate_rad_per_s"
            )
        if element.measured_opening and not np.isfinite(throw.opening_t_s):
            raise UsageError(
                f"replay element {number} takes the opening as measured, but throw {element.throw} "
                "has no opening_t_s"
            )


def _openings(
    throws: Sequence[ReplayInput], elements: Sequence[ReplayElement], start_ns: int
) -> tuple[IntArray, IntArray]:
    """Times of opening commands and of measured releases, ns; `NEVER_NS` for never."""
    command = np.full(len(throws), NEVER_NS)
    gone = np.full(len(throws), NEVER_NS)
    for row, (throw, element) in enumerate(zip(throws, elements, strict=True)):
        command_s = throw.release_t_s
        opened = np.flatnonzero(throw.gripper_open)
        if not np.isfinite(command_s) and opened.size:
            command_s = float(opened[0]) * CONTROL_PERIOD_S
        if np.isfinite(command_s):
            command[row] = start_ns + round(command_s * 1e9)
        if element.measured_opening:
            gone[row] = start_ns + round(throw.opening_t_s * 1e9)
    return command, gone


def _land(load: Payload, now_ns: int) -> None:
    """Advance loads in flight until they land; nothing else moves."""
    for _ in range(MAX_FLIGHT_TICKS):
        if not load.flying.any():
            return
        now_ns += CONTROL_PERIOD_NS
        load.fly(now_ns, CONTROL_PERIOD_S)


class _Tape:
    """Channels recorded at every tick."""

    def __init__(self, twin: Twin, ticks: int) -> None:
        self._twin = twin
        shape = (twin.count, ticks)
        self._position = np.full((*shape, ACTIVE_COUNT), np.nan)
        self._velocity = np.full((*shape, ACTIVE_COUNT), np.nan)
        self._swing = np.full((*shape, 2), np.nan)
        self._swing_rate = np.full((*shape, 2), np.nan)
        self._gyro = np.full((*shape, 3), np.nan)
        self._accel = np.full((*shape, 3), np.nan)
        self._ball = np.full((*shape, 3), np.nan)

    def state(self, tick: int) -> None:
        """Joints and load at a tick."""
        sample = self._twin.read()
        self._position[:, tick] = sample.joint_position_rad_m
        self._velocity[:, tick] = sample.joint_velocity_rad_m_per_s
        self._swing[:, tick] = self._twin.joint_position_rad_m[:, ACTIVE_COUNT:]
        self._swing_rate[:, tick] = self._twin.joint_velocity_rad_m_per_s[:, ACTIVE_COUNT:]
        self._ball[:, tick] = sample.ball_position_m

    def imu(self, tick: int) -> None:
        """The IMU at a tick: it is read one tick later."""
        sample = self._twin.read()
        self._gyro[:, tick] = sample.imu_gyro_rad_per_s
        self._accel[:, tick] = sample.imu_accel_m_per_s2

    def output(self, tick_count: IntArray, start_ns: int) -> ReplayOutput:
        """All channels, NaN from each throw's number of ticks (M,) on."""
        load = self._twin.payload
        beyond = np.arange(self._position.shape[1]) >= tick_count[:, None]
        for channel in (
            self._position,
            self._velocity,
            self._swing,
            self._swing_rate,
            self._gyro,
            self._accel,
            self._ball,
        ):
            channel[beyond] = np.nan
        release_s = (load.release_t_ns - start_ns) * 1e-9
        gone = ~load.held & (release_s <= tick_count * CONTROL_PERIOD_S)
        landed = gone & (load.impact_t_ns > 0)
        return ReplayOutput(
            joint_position_rad_m=self._position,
            joint_velocity_rad_m_per_s=self._velocity,
            passive_position_rad=self._swing,
            passive_velocity_rad_per_s=self._swing_rate,
            gyro_rad_per_s=self._gyro,
            accel_m_per_s2=self._accel,
            release_t_s=np.where(gone, release_s, np.nan),
            release_position_m=np.where(gone[:, None], load.release_position_m, np.nan),
            release_velocity_m_per_s=np.where(gone[:, None], load.release_velocity_m_per_s, np.nan),
            ball_position_m=self._ball,
            impact_m=np.where(landed[:, None], load.impact_m, np.nan),
            impact_t_s=np.where(landed, (load.impact_t_ns - start_ns) * 1e-9, np.nan),
        )


def fly(
    release_position_m: Array,
    release_velocity_m_per_s: Array,
    profile: TwinProfile,
    effects: Sequence[Sequence[Effect]] | None = None,
    *,
    surface_height_m: Array | float = 0.0,
    progress_ratio: Array | float = 0.0,
) -> Flight:
    """Simulate the flight of loads from given release states.

    Only effects on the flight act: drag, wind, spin and the load's mass.

    Args:
        release_position_m: (M, 3) survey frame.
        release_velocity_m_per_s: (M, 3) survey frame.
        profile: drag, wind and effects of the machine.
        effects: one set per load in addition to the profile's.
        surface_height_m: (M,) height of the surface at the impact.
        progress_ratio: (M,) position of each throw in its set.
    """
    count = release_position_m.shape[0]
    arrays = effect_arrays(count, profile.effects, effects, progress_ratio)
    load = Payload(load_spec(), exact_profile(profile), count, arrays)
    load.reset(np.zeros((count, 4)))
    load.surface_height_m[:] = surface_height_m
    load.launch(release_position_m, release_velocity_m_per_s)
    track = [load.position_m.copy()]
    now_ns = 0
    while load.flying.any() and len(track) <= MAX_FLIGHT_TICKS:
        now_ns += CONTROL_PERIOD_NS
        load.fly(now_ns, CONTROL_PERIOD_S)
        track.append(load.position_m.copy())
    landed = load.impact_t_ns > 0
    return Flight(
        impact_m=load.impact_m,
        flight_s=np.where(landed, load.impact_t_ns * 1e-9, np.nan),
        track_m=np.stack(track, axis=1),
    )
