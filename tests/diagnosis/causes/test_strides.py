"""Sizes that slopes do not show are looked for stride by stride."""

from types import SimpleNamespace

import numpy as np
import pytest

from diagnosis.causes import strides
from diagnosis.causes.weighing import Trial

MEMBERS = (0, 1)


def at(*sizes):
    """A trial of some effect and a gain beside it."""
    sizes = np.array(sizes)
    priors = SimpleNamespace(groups=(np.array([0]), np.array([1])))
    return Trial(MEMBERS, sizes, sizes, {}, [], priors, priors, None, (0,))


def problem_of(effect):
    groups = [(effect, "slew"), ("valve_gain", "slew")]
    return SimpleNamespace(layout=SimpleNamespace(groups=groups))


@pytest.fixture
def seen(monkeypatch):
    """Sizes that are simulated, and whether at a glance; the nearest to `best` is told best."""
    asked = SimpleNamespace(best=0.0, glances=[])

    def simulated(problem, seeds, *, is_rough=False):
        asked.glances += [is_rough] * len(seeds)
        return [at(*sizes) for _, sizes in seeds]

    def nearest(found):
        return sorted(found, key=lambda t: abs(t.at[0] - asked.best))[:1]

    monkeypatch.setattr(strides, "try_sets", simulated)
    monkeypatch.setattr(strides, "best_of_each", nearest)
    return asked


@pytest.mark.parametrize(
    ("effect", "begin", "best"),
    [("speed_limit", 0.6, 0.4), ("speed_limit", 0.3, 0.52), ("valve_dead_time", 0.08, 0.12)],
)
def test_bent_and_late_effects_are_followed_both_ways(seen, effect, begin, best):
    """Slopes led a slew's limit of 0.4 from 0.6 to 0.71, a dead time of 0.148 s from 0.08 s to 0.036 s."""
    seen.best = best
    (_, kept), (_, moved) = strides.followed(problem_of(effect), [at(begin, 0.2)])
    assert kept[0] == begin, "all throws decide between them"
    assert moved[0] == pytest.approx(best, rel=0.15)
    assert moved[1] == 0.2
    assert all(seen.glances)


def test_what_was_settled_is_polished_on_all_throws(seen):
    """A slew's limit of 0.5 was left at 0.57."""
    seen.best = 0.5
    (found,) = strides.polished(problem_of("speed_limit"), [at(0.57, 0.2)])
    np.testing.assert_allclose(found.at, [0.57 / 1.1 / 1.05, 0.2])
    assert seen.glances == [False] * 4


def test_polishing_leaves_what_is_told_best(seen):
    seen.best = 0.5
    first = at(0.5, 0.2)
    assert strides.polished(problem_of("speed_limit"), [first]) == [first]


@pytest.mark.parametrize("effect", ["load_dependent_speed", "base_tilt"])
def test_effects_that_do_not_bend_are_left_to_their_slopes(seen, effect):
    problem, first = problem_of(effect), at(0.3, 0.2)
    ((_, sizes),) = strides.followed(problem, [first])
    assert sizes is first.at
    assert strides.polished(problem, [first]) == [first]
    assert not seen.glances
