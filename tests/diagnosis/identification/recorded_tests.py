"""Identification tests of a virtual unit, recorded and loaded."""

from functools import cache
from pathlib import Path
from tempfile import mkdtemp

from diagnosis.loading.logs import load_throws
from diagnosis.loading.throw_data import ThrowData
from machine.calibration import nominal_calibration
from machine.conventions import Array, Mode
from machine.spec import load_spec
from runtime.control.control_loop import ControlParams
from sim_twin.commissioning.motions import MotionProgram, TestKind, motion_program
from sim_twin.commissioning.recording import record_test
from sim_twin.throws.throw_logs import CampaignRecorder, LogContext
from sim_twin.virtual_machine import VirtualMachine

SPEC = load_spec()


@cache
def recorded(
    kind: TestKind, unit_seed: int, seed: int, tracker: bool = True
) -> tuple[ThrowData, ...]:
    """Logs of one test."""
    return load(kind, motion_program(kind, seed), unit_seed, seed, tracker)


def load(
    kind: str, program: MotionProgram, unit_seed: int, seed: int, tracker: bool = True
) -> tuple[ThrowData, ...]:
    out = Path(mkdtemp())
    params = ControlParams(SPEC, nominal_calibration(SPEC), Mode.PLANAR, policy=None)
    context = LogContext("m", f"{kind}-{seed}", 0, out, test=kind)
    plant = VirtualMachine(count=program.start_rad_m.shape[0], unit_seed=unit_seed, tracker=tracker)
    record_test(plant, params, program, seed, CampaignRecorder(params, context))
    plant.close()
    loaded = load_throws([out], SPEC)
    assert not loaded.refused
    return loaded.throws


def some(program: MotionProgram, rows: Array) -> MotionProgram:
    """A program for fewer machines."""
    return MotionProgram(
        program.start_rad_m[rows], program.valve_ratio[:, rows], program.open_s[rows]
    )
