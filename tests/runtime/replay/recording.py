"""Recorded sensor samples of one machine and the outputs that the control step gave for them.

A recording is one compressed file in tests/runtime/data. Its inputs never change; its outputs are what
`replay` gives for these inputs, and are replaced when a change is accepted (record.py).
"""

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from machine.calibration import nominal_calibration
from machine.conventions import CONTROL_PERIOD_NS, Array, Mode
from machine.spec import load_spec
from runtime.control import control_loop
from runtime.control.control_loop import ControlInputs, ControlOutputs, ControlParams
from runtime.control.policy import PolicyRunner
from runtime.driver import SensorSample

FOLDER = Path(__file__).parents[1] / "data"
POLICIES = Path(__file__).parents[3] / "policies"
POLICY_IDS = {Mode.PLANAR: "m545-2d-v7", Mode.SPATIAL: "m545-3d-v7"}
"""Named, not `active`: a newly shipped policy is no change of the control step."""
SPEC = load_spec()

ROW_CHANNELS = (
    "joint_position_rad_m",
    "joint_velocity_rad_m_per_s",
    "velocity_request_rad_m_per_s",
    "velocity_reference_rad_m_per_s",
    "valve_requested_ratio",
    "valve_applied_ratio",
    "safety_code_count",
    "gripper_open_commanded",
)
FLAG_CHANNELS = (
    "release_commanded",
    "load_gone",
    "throw_done",
    "aligned",
    "settled",
    "violation_count",
)

Channels = dict[str, Array]
"""Output channels by name, first axis ticks."""


@dataclass(frozen=True, slots=True)
class Recording:
    """One machine's inputs, first axis ticks T, and the accepted outputs."""

    name: str
    mode: Mode
    target_m: Array
    """(3,) frame `machine`."""
    pace_ratio: float
    motion: Array
    """(T,) conventions.Motion"""
    samples: Channels
    """Fields of `SensorSample` that the driver measured, each (T, ...), without the machine axis."""
    outputs: Channels


def names() -> list[str]:
    """All recordings."""
    return sorted(path.stem for path in FOLDER.glob("*.npz"))


def load(name: str) -> Recording:
    """One recording."""
    with np.load(FOLDER / f"{name}.npz") as file:
        data = {key: file[key] for key in file.files}
    return Recording(
        name,
        Mode(str(data["mode"])),
        data["target_m"],
        float(data["pace_ratio"]),
        data["motion"],
        _under("sample.", data),
        _under("output.", data),
    )


def save(recording: Recording) -> None:
    """Write one recording."""
    FOLDER.mkdir(exist_ok=True)
    np.savez_compressed(
        FOLDER / f"{recording.name}.npz",
        mode=np.array(recording.mode.value),
        target_m=recording.target_m,
        pace_ratio=recording.pace_ratio,
        motion=recording.motion,
        **{f"sample.{name}": values for name, values in recording.samples.items()},
        **{f"output.{name}": values for name, values in recording.outputs.items()},
    )


def replay(recording: Recording) -> Channels:
    """Run the recorded samples through the control step; floats are rounded to single precision."""
    params = _params(recording.mode)
    target_m = recording.target_m[None]
    now_ns = CONTROL_PERIOD_NS * np.arange(100, 100 + len(recording.motion))
    state = control_loop.initial_state(params, _sample(recording, 0), target_m, int(now_ns[0]))
    found: list[Channels] = []
    for tick, tick_ns in enumerate(now_ns):
        motion = recording.motion[tick : tick + 1].astype(np.int64)
        inputs = ControlInputs(_sample(recording, tick), motion, target_m, recording.pace_ratio)
        state, outputs = control_loop.step(params, state, inputs, int(tick_ns))
        found.append(_channels(outputs))
    return {name: np.stack([row[name] for row in found]) for name in found[0]}


@cache
def _params(mode: Mode) -> ControlParams:
    policy = PolicyRunner(POLICIES / POLICY_IDS[mode], SPEC)
    return ControlParams(SPEC, nominal_calibration(SPEC), mode, policy)


def _sample(recording: Recording, tick: int) -> SensorSample:
    """The sample of one tick, with the machine axis."""
    values: dict[str, object] = {}
    for name, channel in recording.samples.items():
        value = channel[tick]
        if name == "t_mono_ns":
            values[name] = int(value)
        elif value.dtype == np.float32:
            values[name] = value[None].astype(np.float64)
        else:
            values[name] = value[None]
    return SensorSample(**values)  # pyright: ignore[reportArgumentType]


def _channels(outputs: ControlOutputs) -> Channels:
    row = outputs.row[0]
    channels = {name: np.asarray(row[name]) for name in ROW_CHANNELS}
    channels |= {name: np.asarray(getattr(outputs, name)[0]) for name in FLAG_CHANNELS}
    policy_row = outputs.policy_row
    action = np.zeros(5) if policy_row is None else policy_row["action_ratio"][0]
    channels["action_ratio"] = action
    return {
        name: values.astype(np.float32) if values.dtype == np.float64 else values
        for name, values in channels.items()
    }


def _under(prefix: str, data: Channels) -> Channels:
    return {
        key.removeprefix(prefix): values for key, values in data.items() if key.startswith(prefix)
    }
