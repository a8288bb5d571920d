"""Friction and length of free swings are found."""

import numpy as np
import pytest

from diagnosis.identification.free_swing import FreeSwing, identify_swing, simulate_swing
from diagnosis.identification.profile_update import (
    extra_length,
    next_profile,
    swing_length,
    with_swing,
)
from sim_twin.commissioning.motions import motion_program
from sim_twin.twin.profile import nominal_profile
from tests.diagnosis.identification.recorded_tests import SPEC, load, some

NOMINAL_PITCH_M, NOMINAL_ROLL_M = 0.9185, 0.8041
"""Inertia over mass moment of the compiled model with its load (mj_fullM, qfrc_bias)."""


@pytest.fixture(scope="module")
def axes():
    """Three swings of each axis."""
    return identify_swing(load("swing", some(motion_program("swing", 3), np.arange(6)), 0, 3), SPEC)


def test_the_nominal_machine_swings_with_the_papers_friction(axes):
    for axis in axes:
        assert axis.swing_count >= 3
        assert axis.coulomb_friction_rad_per_s2.value == pytest.approx(0.1, abs=0.01)
        assert axis.viscous_friction_per_s.value == pytest.approx(0.03, abs=0.015)


def test_length_is_that_of_the_compiled_model(axes):
    for axis, true in zip(axes, (NOMINAL_PITCH_M, NOMINAL_ROLL_M), strict=True):
        assert axis.length_m.value == pytest.approx(true, abs=0.006)
    assert swing_length(SPEC, 0) == pytest.approx(NOMINAL_PITCH_M, abs=0.002)
    assert swing_length(SPEC, 1) == pytest.approx(NOMINAL_ROLL_M, abs=0.002)
    assert extra_length(axes, SPEC)[0] == pytest.approx(0.0, abs=0.01)


def test_the_prediction_lies_on_the_measurement(axes):
    for axis in axes:
        measured, predicted = (np.asarray(axis.plot[k]) for k in ("measured_rad", "predicted_rad"))
        assert np.max(np.abs(measured)) > 0.15
        assert np.sqrt(np.mean((measured - predicted) ** 2)) < 0.02


def test_without_viscous_friction_the_amplitude_falls_evenly():
    t = np.arange(2000) * 0.01
    swing = FreeSwing("t", t, np.zeros(t.size), np.zeros(t.size), np.zeros(t.size))
    angle, _ = simulate_swing(swing, np.array([0.0, 0.1, 0.9, 0.5, 0.0]))
    peaks = angle[1:-1][(angle[1:-1] > angle[2:]) & (angle[1:-1] > angle[:-2])]
    steps = -np.diff(peaks[:5])
    # 4 c L / g a period.
    assert steps == pytest.approx(np.full(steps.size, 4 * 0.1 * 0.9 / 9.81), rel=0.1)


def test_a_pin_that_the_load_pulls_up_and_down_is_taken_into_account():
    t = np.arange(1500) * 0.01
    angle, rate, lift, length, ratio = 0.6, 0.0, np.zeros(t.size), 0.9, 0.03
    rates = np.zeros(t.size)
    for k in range(t.size):
        rates[k] = rate
        # As far as the load pulls beyond its weight, twice a period.
        pull = rate**2 * length * np.cos(angle) + 9.81 * (np.cos(angle) ** 2 - 1.0)
        lift[k] = ratio * pull
        for _ in range(10):
            rate -= 0.001 * (9.81 + lift[k]) / length * np.sin(angle)
            angle += 0.001 * rate
    swing = FreeSwing("t", t, rates, np.zeros(t.size), lift)
    truth = np.array([0.0, 0.0, length, 0.6, 0.0])
    left = simulate_swing(swing, truth)[1] - rates
    unaware = simulate_swing(swing._replace(lift_m_per_s2=0.0 * lift), truth)[1] - rates
    assert np.sqrt(np.mean(left**2)) < 0.2 * np.sqrt(np.mean(unaware**2))


def test_throws_without_a_free_swing_say_so():
    short = load("release", some(motion_program("release", 1), np.arange(2)), 0, 1)
    axis, _ = identify_swing(short, SPEC)
    assert axis.viscous_friction_per_s.value is None
    assert "cannot be known from these logs" in axis.viscous_friction_per_s.why
    profile = nominal_profile(SPEC)
    assert next_profile(profile, with_swing(profile, [axis], SPEC), "m", "n") is None


def test_a_longer_gripper_becomes_an_effect_of_the_profile(axes):
    longer = tuple(
        axis.model_copy(
            update={
                "length_m": axis.length_m.model_copy(
                    update={
                        "value": swing_length(SPEC, k, 0.05),
                        "ci90": (swing_length(SPEC, k, 0.04), swing_length(SPEC, k, 0.06)),
                    }
                )
            }
        )
        for k, axis in enumerate(axes)
    )
    before = nominal_profile(SPEC)
    after = next_profile(before, with_swing(before, longer, SPEC), "m", "n")
    (effect,) = after.effects
    assert effect.parameters["extra_length_m"] == pytest.approx(0.05, abs=1e-6)
    assert after.intervals["gripper_length.extra_length_m"] == pytest.approx((0.04, 0.06))
    assert after.intervals["viscous_friction_per_s.pitch"][0] >= 0.0
