"""From throws to a registration: planted misses come back, chance does not, faults are not aimed away."""

import numpy as np
import pytest

from machine.registration import MAX_CORRECTION_M, TermKind
from sim_twin.commissioning.registration_fit import Surveyed, register

KINDS = tuple(TermKind)
SCATTER_M = 0.08


def miss(range_m, height_m, turn_rad):
    """A machine's true mean miss: of the ground behind the target, more to the side when it stands near."""
    at = range_m + 0.4 * height_m
    down = -0.15 * np.exp(-(((at - 9.0) / 0.9) ** 2)) - 0.02 * height_m
    near = np.exp(-0.5 * (turn_rad / 0.25) ** 2)
    return down, 0.1 * near - 0.08 * turn_rad / np.pi


def thrown(rng, count=240, *, height_m=None):
    range_m = rng.uniform(6.0, 10.5, count)
    height = rng.uniform(-1.0, 3.0, count) if height_m is None else np.full(count, height_m)
    turn = rng.uniform(-np.pi, np.pi, count)
    turn[::2] = rng.uniform(-0.1, 0.1, turn[::2].size)
    down, cross = miss(range_m, height, turn)
    noise = SCATTER_M * rng.standard_normal((2, count))
    return Surveyed(range_m, height, turn, down + noise[0], cross + noise[1])


def left_m(found, rng):
    """What is left (2, 400) of the true miss once aimed by `found`."""
    at = thrown(rng, 400)
    true = miss(at.range_m, at.height_m, at.turn_rad)
    return np.array(true) - found.miss(at.range_m, at.height_m, at.turn_rad)


def test_the_miss_over_range_height_and_turn_comes_back():
    rng = np.random.default_rng(0)
    rest = left_m(register("sha", thrown(rng), KINDS), rng)
    # 240 throws that scatter by 0.08 m, eight or so to each bend of the tables: 0.03 m at best.
    assert np.sqrt(np.mean(rest**2)) < 0.03
    assert np.sqrt(np.mean(np.square(miss(*thrown(rng)[:3])))) > 0.07


def test_throws_at_the_ground_alone_give_raised_targets_the_ground_behind_them():
    rng = np.random.default_rng(1)
    found = register("sha", thrown(rng, height_m=0.0), KINDS)
    range_m, zero = np.array([8.0]), np.zeros(1)
    raised = found.miss(range_m, np.array([2.5]), zero)
    assert np.array_equal(raised, found.miss(range_m + 0.4 * 2.5, zero, zero))


def test_chance_is_hardly_aimed_at():
    rng = np.random.default_rng(2)
    at = thrown(rng)
    noise = SCATTER_M * rng.standard_normal((2, at.range_m.size))
    found = register("sha", at._replace(downrange_m=noise[0], crossrange_m=noise[1]), KINDS)
    aimed = np.array(found.miss(at.range_m, at.height_m, at.turn_rad))
    assert np.sqrt(np.mean(aimed**2)) < 0.35 * SCATTER_M


def test_one_odd_throw_moves_the_aim_by_half_of_its_miss_at_most():
    one = np.ones(1)
    found = register("sha", Surveyed(9.0 * one, 0.0 * one, 0.0 * one, 0.3 * one, 0.0 * one))
    assert 0.0 < max(found.downrange_m) <= 0.15


def test_a_miss_too_large_to_aim_away_is_refused_with_its_size():
    rng = np.random.default_rng(3)
    at = thrown(rng)
    with pytest.raises(ValueError, match=rf"\d\.\d\d m is more than the {MAX_CORRECTION_M} m"):
        register("sha", at._replace(downrange_m=at.downrange_m - 1.0))


def test_a_few_throws_at_the_last_of_the_reach_may_fall_farther_short():
    at = thrown(np.random.default_rng(4), 400, height_m=0.0)
    short = np.where(at.range_m > 10.2, -1.2, -0.2)
    assert np.mean(at.range_m > 10.2) < 0.1
    found = register("sha", at._replace(downrange_m=short))
    assert min(found.downrange_m) == -MAX_CORRECTION_M


def test_no_throws_is_no_registration():
    none = np.zeros(0)
    with pytest.raises(ValueError, match="at least one throw"):
        register("sha", Surveyed(none, none, none, none, none))
