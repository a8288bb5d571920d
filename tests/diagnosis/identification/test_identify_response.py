"""Drive responses are found from valve steps; what the motion does not determine is unknown."""

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.identification.drive_record import DriveRecord, drive_record
from diagnosis.identification.plots import SHOWN_TICKS, _busiest
from diagnosis.identification.profile_update import next_profile, with_response
from diagnosis.identification.rate_limits import acceleration_limit
from diagnosis.identification.response import identify_response
from diagnosis.identification.response_estimation import fit, quantities, simulate
from diagnosis.identification.training_ranges import training_ranges
from sim_twin.commissioning.motions import motion_program
from sim_twin.twin.profile import nominal_profile
from tests.diagnosis.identification.recorded_tests import SPEC, load, some

UP = np.array([0.09, 0.12, 0.8, 0.95])
DOWN = np.array([0.14, 0.06, 0.6, 1.10])
"""Dead time, lag, damping, gain."""


@pytest.fixture(scope="module")
def steps():
    """Of slew and telescope only: what a step is to the others it is to these."""
    program = motion_program("response", 2)
    rows = np.flatnonzero(np.any(program.valve_ratio[:, :, [0, 3]] != 0.0, axis=(0, 2)))
    return load("response", some(program, rows), 3, 2)


@pytest.fixture(scope="module")
def joints(steps):
    return identify_response(steps, SPEC)


def synthetic(noise=0.005, seed=0) -> DriveRecord:
    rng = np.random.default_rng(seed)
    pieces, block = [], []
    for k in range(30):
        level = (1 if k % 2 else -1) * rng.uniform(0.1, 0.5)
        pieces.append(np.concatenate([np.full(80, level), np.zeros(120)]))
        block.append(np.full(200, k))
    steady = np.concatenate(pieces)
    one = np.ones_like(steady)
    record = DriveRecord(
        steady, steady, steady, one, one > 0, np.concatenate(block).astype(np.int64), 30
    )
    measured = simulate(record, np.stack([UP, DOWN])) + noise * rng.standard_normal(steady.size)
    return replace(record, measured=measured)


def test_each_direction_of_a_known_response_lies_in_its_interval():
    inside = total = 0
    for seed in range(6):
        record = synthetic(seed=seed)
        rng = np.random.default_rng(1)
        everything = np.ones(30, np.bool_)
        free = fit(record, everything, False, rng, fit(record, everything, True, rng))
        assert free.x == pytest.approx(np.stack([UP, DOWN]), rel=0.08)
        for k, true in enumerate((UP, DOWN)):
            known = quantities(free, k, 15)
            for name, value in zip(
                ("dead_time_s", "lag_s", "damping_ratio", "gain_ratio"), true, strict=True
            ):
                inside += known[name].ci90[0] <= value <= known[name].ci90[1]
                total += 1
    assert inside / total > 0.7, f"{inside} of {total} intervals of 90 % hold the truth"


def test_valve_steps_explain_the_motion_and_reach_the_speed_limit(joints):
    for joint in (joints[0], joints[3]):
        assert joint.r2_ratio > 0.88
        assert 0.04 < joint.shared["dead_time_s"].value < 0.25
        for direction in joint.directions.values():
            assert direction["speed_limit"].count == 4
    slew = joints[0].directions
    assert 0.85 < slew["positive"]["speed_limit"].value < 1.05
    # The relief valve of the slew drive: 52 kN m over 30 t m2.
    assert 1.0 < slew["positive"]["acceleration_limit"].value < 2.5


def test_a_speed_limit_never_approached_cannot_be_known(steps):
    gentle = [t for t in steps if 0.2 < np.abs(t.valve_ratio[:, 3]).max() < 0.9]
    joint = identify_response(gentle, SPEC)[3]
    limit = joint.directions["positive"]["speed_limit"]
    assert limit.value is None
    assert "cannot be known from these logs: full valve" in limit.why
    assert 0.1 < limit.at_least < 0.4
    assert joint.directions["positive"]["dead_time_s"].value is not None


def test_a_joint_that_never_moved_cannot_be_known(steps):
    still = [t for t in steps if np.abs(t.valve_ratio[:, 3]).max() > 0.0]
    boom = identify_response(still, SPEC)[1]
    assert boom.best is None
    assert "moved in 0 pieces" in boom.shared["dead_time_s"].why
    profile = nominal_profile(SPEC)
    after = next_profile(profile, with_response(profile, [boom]), "m", "n")
    assert after is None


def test_acceleration_that_grows_with_the_step_has_no_limit():
    record = synthetic(noise=0.0)
    found = acceleration_limit(record, 1, 1.0, "rad/s2")
    assert found.value is None
    assert "it grows with the step" in found.why


def test_a_controllers_ramp_is_no_step():
    record = synthetic(noise=0.0)
    window = np.full(12, 1.0 / 12.0)
    ramped = replace(record, steady=np.convolve(record.steady, window)[: record.steady.size])
    found = acceleration_limit(ramped, 1, 1.0, "rad/s2")
    assert found.value is None
    assert found.why.endswith("0 steps from rest, 9 of different sizes are needed")
    assert found.at_least > 0.5


def test_the_next_profile_has_response_and_intervals(joints):
    before = nominal_profile(SPEC)
    after = next_profile(before, with_response(before, joints), "m003", "steps")
    assert after.dead_time_s[3] == joints[3].best["dead_time_s"]
    assert after.intervals["dead_time_s.telescope"] == joints[3].shared["dead_time_s"].ci90
    assert after.release_delay_s == before.release_delay_s


def test_open_loop_steps_give_no_ranges_for_training(steps):
    few = [t for t in steps if np.abs(t.valve_ratio[:, 3]).max() > 0.0][:6]
    ranges = training_ranges(few, SPEC)
    assert "cannot be known" in ranges["telescope"]["dead_time_s"]
    assert drive_record(few, SPEC, 3).block_count == 6


def test_what_is_drawn_lies_about_the_most_motion_each_way():
    speed = np.zeros(20_000)
    speed[3_000:3_100], speed[9_000:9_100], speed[15_000:15_100] = 0.1, 0.5, -0.4
    first, second = _busiest(speed)
    assert first[0] < 9_000 < 9_100 <= first[-1]
    assert second[0] < 15_000 < 15_100 <= second[-1]
    assert first.size + second.size == SHOWN_TICKS
    (all_of_it,) = _busiest(speed[:900])
    assert all_of_it.size == 900
