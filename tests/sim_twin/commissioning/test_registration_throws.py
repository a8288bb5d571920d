"""Registration throws take a bias away that the policy cannot know of."""

from pathlib import Path

import numpy as np
import pytest

from machine.calibration import nominal_calibration
from machine.conventions import Mode
from machine.errors import UsageError
from machine.kinematics import aligned_slew_rad
from machine.registration import Registration
from machine.spec import load_spec
from machine.starts import safe_pose
from runtime.control.control_loop import ControlParams
from runtime.control.policy import PolicyRunner, find_policy
from sim_twin.commissioning.registration_throws import (
    FLAT_THROW_COUNT,
    register_machine,
)
from sim_twin.throws.campaign import run_throws
from sim_twin.twin.profile import nominal_profile
from sim_twin.twin.twin import Twin

SPEC = load_spec()
CALIBRATION = nominal_calibration(SPEC)


@pytest.fixture(scope="module")
def runner():
    return PolicyRunner(find_policy(Path("policies"), Mode.SPATIAL), SPEC)


@pytest.fixture(scope="module")
def registered(runner):
    """Of a machine that had no registration."""
    params = ControlParams(SPEC, CALIBRATION, Mode.SPATIAL, runner)
    return register_machine(twin(FLAT_THROW_COUNT), params, SPEC)


def twin(count):
    """A machine whose load flies into a head wind that nobody told the policy of."""
    profile = nominal_profile(SPEC).model_copy(update={"wind_m_per_s": (-4.0, 0.0, 0.0)})
    return Twin(count=count, profile=profile, calibration=CALIBRATION)


def mean_miss_m(params, range_m=9.0, height_m=0.0):
    count = 40
    target = np.tile([range_m, 0.0, height_m], (count, 1))
    starts = np.tile(safe_pose(), (count, 1))
    starts[:, 0] = np.random.default_rng(1).uniform(-3.0, 3.0, count)
    if params.mode is Mode.PLANAR:
        starts[:, 0] = aligned_slew_rad(SPEC, target)
    return np.mean(
        [r.downrange_error_m for r in run_throws(twin(count), params, target, starts, 7)]
    )


def test_the_registered_machine_hits_on_average(runner, registered):
    params = ControlParams(SPEC, CALIBRATION, Mode.SPATIAL, runner)
    assert registered.throw_count > 0.95 * FLAT_THROW_COUNT
    corrected = CALIBRATION.model_copy(update={"registrations": (registered,)})
    before_m = mean_miss_m(params)
    after_m = mean_miss_m(ControlParams(SPEC, corrected, Mode.SPATIAL, runner))
    assert before_m < -0.15
    assert abs(after_m) < 0.06


def test_an_earlier_registration_does_not_count_twice(runner, registered):
    old = Registration(
        policy_sha256=runner.card.policy_sha256,
        throw_count=1,
        range_m=(9.0,),
        downrange_m=(0.4,),
        crossrange_m=(0.3,),
    )
    earlier = CALIBRATION.model_copy(update={"registrations": (old,)})
    params = ControlParams(SPEC, earlier, Mode.SPATIAL, runner)
    assert register_machine(twin(FLAT_THROW_COUNT), params, SPEC) == registered


def test_without_a_policy_nothing_is_thrown():
    params = ControlParams(SPEC, CALIBRATION, Mode.SPATIAL, None)
    with pytest.raises(UsageError, match="needs a policy"):
        register_machine(twin(1), params, SPEC)
