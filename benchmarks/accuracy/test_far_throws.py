"""Far throws of the shipped policies end well: nothing touches anything, before the release or after it."""

from pathlib import Path

import numpy as np
import pytest

from machine.calibration import ValveCalibration
from machine.conventions import Mode
from machine.spec import load_spec
from machine.starts import sample_starts
from runtime.control.control_loop import ControlParams
from runtime.control.policy import PolicyRunner, find_policy
from sim_twin.commissioning.valve_calibration import CALIBRATION_STEP_COUNT, calibrate
from sim_twin.throws.campaign import ThrowOutcome, run_throws
from sim_twin.virtual_machine import VirtualMachine
from tests.cases import each

SPEC = load_spec()
POLICIES = Path(__file__).parents[2] / "policies"
UNIT_SEED = 4
THROW_COUNT = 20


@pytest.fixture(scope="module")
def calibration() -> ValveCalibration:
    plant = VirtualMachine(count=CALIBRATION_STEP_COUNT, unit_seed=UNIT_SEED)
    try:
        return calibrate(plant, SPEC, "m004")
    finally:
        plant.close()


@each("mode", list(Mode))
def test_ten_metres_on_a_machine_of_its_own(calibration: ValveCalibration, mode: Mode) -> None:
    policy = PolicyRunner(find_policy(POLICIES, mode), SPEC)
    params = ControlParams(SPEC, calibration, mode, policy)
    targets = np.tile([10.0, 0.0, 0.0], (THROW_COUNT, 1))
    starts = sample_starts(SPEC, mode, targets, np.random.default_rng(8))
    plant = VirtualMachine(count=THROW_COUNT, unit_seed=UNIT_SEED)
    try:
        results = run_throws(plant, params, targets, starts, seed=8)
    finally:
        plant.close()
    assert [result.outcome for result in results] == [ThrowOutcome.LANDED] * THROW_COUNT
    misses = [np.hypot(r.downrange_error_m, r.crossrange_error_m) for r in results]
    assert np.median(misses) < 1.0
