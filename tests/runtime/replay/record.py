"""Makes the recordings, or accepts a change of the outputs.

    python -m tests.runtime.replay.record accept           the present outputs become the reference
    python -m tests.runtime.replay.record accept NAME ...  of these recordings only
    python -m tests.runtime.replay.record show             print the differences, change nothing
    python -m tests.runtime.replay.record new              throw on the virtual machine again: new inputs

Read every difference before accepting it: the test's message shows the same text as `show`.
"""

import sys
from dataclasses import fields, replace

import numpy as np

from machine.calibration import nominal_calibration
from machine.conventions import CONTROL_PERIOD_NS, Array, Mode, Motion
from machine.kinematics import aligned_slew_rad
from machine.starts import safe_pose
from runtime.control import control_loop
from runtime.control.control_loop import ControlInputs, ControlParams
from runtime.control.policy import PolicyRunner
from runtime.driver import SensorSample
from sim_twin.virtual_machine import VirtualMachine
from tests.runtime.replay import recording
from tests.runtime.replay.difference import differences
from tests.runtime.replay.recording import Channels, Recording

HOLD_TICKS = 20
SETTLE_TICKS = 150
LIMIT_TICKS = 1200
UNIT = 7
"""A virtual machine that differs from the nominal one."""


def record(
    name: str,
    mode: Mode,
    target_m: Array,
    pace_ratio: float,
    abort_tick: int = LIMIT_TICKS,
) -> Recording:
    """One throw on the virtual machine: hold, align, throw, settle; or hold again from `abort_tick` on."""
    spec, target = recording.SPEC, target_m[None]
    policy = PolicyRunner(recording.POLICIES / recording.POLICY_IDS[mode], spec)
    params = ControlParams(spec, nominal_calibration(spec), mode, policy)
    plant = VirtualMachine(count=1, unit_seed=UNIT)
    slew = float(aligned_slew_rad(spec, target)[0]) if mode is Mode.PLANAR else 0.4
    plant.reset(safe_pose(slew)[None], seed=1)
    start_ns = plant.now_ns()
    state = control_loop.initial_state(params, plant.read(), target, start_ns)
    motion, settled_ticks = np.array([int(Motion.HOLD)]), 0
    samples: list[SensorSample] = []
    motions: list[int] = []
    while settled_ticks < SETTLE_TICKS and len(samples) < LIMIT_TICKS:
        if len(samples) == HOLD_TICKS:
            motion = np.array([int(Motion.ALIGN)])
        if len(samples) >= abort_tick:
            motion, settled_ticks = np.array([int(Motion.HOLD)]), settled_ticks + 1
        now_ns, sample = plant.now_ns(), plant.read()
        samples.append(sample)
        motions.append(int(motion[0]))
        inputs = ControlInputs(sample, motion, target, pace_ratio)
        state, outputs = control_loop.step(params, state, inputs, now_ns)
        plant.write(outputs.command)
        plant.advance(now_ns + CONTROL_PERIOD_NS)
        motion = control_loop.next_motion(motion, outputs)
        settled_ticks += int(motion[0]) == Motion.SETTLE
    # The replay's clock starts at its hundredth period; sample times are moved to it.
    shift_ns = 100 * CONTROL_PERIOD_NS - start_ns
    return with_outputs(
        Recording(
            name,
            mode,
            target_m,
            pace_ratio,
            np.array(motions, dtype=np.int8),
            _stack(samples, shift_ns),
            {},
        )
    )


def _stack(samples: list[SensorSample], shift_ns: int) -> Channels:
    stacked: Channels = {}
    for field in fields(SensorSample):
        first = getattr(samples[0], field.name)
        if first is None:
            continue
        if isinstance(first, int):
            values = np.array([getattr(sample, field.name) for sample in samples])
        else:
            values = np.stack([getattr(sample, field.name)[0] for sample in samples])
        if field.name.endswith("_ns"):
            values = np.where(values > 0, values + shift_ns, values)
        stacked[field.name] = values.astype(np.float32) if values.dtype == np.float64 else values
    return stacked


def disturbed(source: Recording, name: str) -> Recording:
    """The same throw with broken inputs, one after the other, each for a tenth or half of a second."""
    start = int(np.flatnonzero(source.motion == Motion.THROW)[0])
    length = start + 320
    samples = {key: values[:length].copy() for key, values in source.samples.items()}
    motion = source.motion[:length].copy()

    def part(number: int, ticks: int = 10) -> slice:
        begin = start + 20 + 40 * number
        return slice(begin, begin + ticks)

    samples["local_enable"][part(0)] = False
    samples["emergency_stop"][part(1)] = True
    samples["t_mono_ns"][part(2)] = samples["t_mono_ns"][part(2).start]
    samples["joint_position_rad_m"][part(3), 1] = np.nan
    samples["joint_velocity_rad_m_per_s"][part(4), 2] = 9.0
    motion[part(5)] = int(Motion.STOP)
    silent = part(6, 30)
    samples["imu_t_mono_ns"][silent] = samples["imu_t_mono_ns"][silent.start]
    return with_outputs(replace(source, name=name, motion=motion, samples=samples))


def with_outputs(given: Recording) -> Recording:
    """The recording with the outputs that the present control step gives."""
    return replace(given, outputs=recording.replay(given))


def make_all() -> list[Recording]:
    """All recordings anew."""
    planar = record("throw_2d", Mode.PLANAR, np.array([8.5, 1.0, 0.0]), 1.0)
    target_m = np.array([7.5, -3.0, 0.0])
    spatial = record("throw_3d", Mode.SPATIAL, target_m, 0.5)
    return [
        planar,
        spatial,
        record("aborted_3d", Mode.SPATIAL, target_m, 0.5, abort_tick=110),
        disturbed(planar, "disturbed_2d"),
    ]


def main(arguments: list[str]) -> int:
    """Entry of the command line; returns its exit code."""
    verb, *chosen = arguments or ["show"]
    if verb == "new":
        for made in make_all():
            recording.save(made)
        return 0
    if verb not in ("accept", "show"):
        sys.stdout.write(f"{__doc__}\n")
        return 2
    for name in chosen or recording.names():
        known = recording.load(name)
        present = with_outputs(known)
        changes = differences(known.outputs, present.outputs)
        text = "\n".join([f"{name}: {len(changes)} columns changed", *changes])
        sys.stdout.write(f"{text}\n")
        if verb == "accept" and changes:
            recording.save(present)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
