"""The identified profile predicts motion of the machine that was not used to find it."""

from typing import Any

import numpy as np
import pytest

from machine.spec import load_spec
from sim_twin.commissioning.excitation import identify_profile, record_valve_response
from sim_twin.commissioning.response_fit import simulate_response
from sim_twin.commissioning.valve_calibration import CALIBRATION_STEP_COUNT, calibrate
from sim_twin.twin.profile import TwinProfile, nominal_profile
from sim_twin.virtual_machine import VirtualMachine
from tests.cases import each

SPEC = load_spec()
UNIT_SEED = 3


@pytest.fixture(scope="module")
def identified() -> tuple[Any, ...]:
    plant = VirtualMachine(count=CALIBRATION_STEP_COUNT, unit_seed=UNIT_SEED)
    calibration = calibrate(plant, SPEC, "m003")
    plant.close()
    plant = VirtualMachine(count=12, unit_seed=UNIT_SEED)
    profile, _ = identify_profile(plant, SPEC, calibration, "m003", seed=1)
    fresh = record_valve_response(plant, SPEC, calibration, seed=2)
    plant.close()
    return profile, fresh


@each("joint", range(4))
def test_prediction_of_fresh_motion_beats_the_nominal_twin(
    identified: tuple[Any, ...], joint: int
) -> None:
    profile, (joints, steady, measured) = identified
    own = joints == joint

    def error(p: TwinProfile) -> float:
        model = simulate_response(
            steady[own],
            p.dead_time_s[joint],
            p.natural_frequency_rad_per_s[joint],
            p.damping_ratio[joint],
            p.gain_ratio[joint],
        )
        return float(np.sqrt(np.mean((model - measured[own]) ** 2)))

    assert error(profile) < error(nominal_profile(SPEC))


def test_profile_is_the_machines_own_first_version(identified: tuple[Any, ...]) -> None:
    profile, _ = identified
    assert profile.machine_id == "m003"
    assert profile.version_count == 1
    assert "R2" in profile.note
