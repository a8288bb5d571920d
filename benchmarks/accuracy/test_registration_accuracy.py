"""What is left of a bias that the policy cannot know of, after registration off the ground."""

from pathlib import Path

import numpy as np

from machine.conventions import Mode
from machine.registration import TermKind
from runtime.control.control_loop import ControlParams
from runtime.control.policy import PolicyRunner, find_policy
from sim_twin.commissioning.registration_throws import (
    GROUND_THROW_COUNT,
    RAISED_THROW_COUNT,
    register_machine,
    registration_throw_count,
)
from tests.sim_twin.commissioning.test_registration_throws import (
    CALIBRATION,
    SPEC,
    mean_miss_m,
    twin,
)


def test_a_policy_for_heights_is_registered_off_the_ground_too() -> None:
    runner = PolicyRunner(find_policy(Path("policies"), Mode.PLANAR), SPEC)
    plain = ControlParams(SPEC, CALIBRATION, Mode.PLANAR, runner)
    count = registration_throw_count(runner.card)
    assert count == GROUND_THROW_COUNT + RAISED_THROW_COUNT
    found = register_machine(twin(count), plain, SPEC)
    assert {term.kind for term in found.terms} == {TermKind.HEIGHT, TermKind.HEIGHT_SQUARED}
    corrected = CALIBRATION.model_copy(update={"registrations": (found,)})
    aimed = ControlParams(SPEC, corrected, Mode.PLANAR, runner)
    places = ((9.5, -1.0), (8.5, 1.5), (7.5, 2.5))
    before_m = [mean_miss_m(plain, *place) for place in places]
    after_m = [mean_miss_m(aimed, *place) for place in places]
    assert np.abs(before_m).mean() > 0.1
    # A gale of 4 m/s hangs on the height by more than the registration's prior lets a pit differ: of 0.35 m
    # 0.05 to 0.07 m stay there, whatever the seed and the starts. Elsewhere at most 0.035 m stay.
    assert abs(after_m[0]) < 0.08
    assert np.abs(after_m[1:]).max() < 0.05
