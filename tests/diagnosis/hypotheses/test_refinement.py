"""Line search over sizes that slopes do not show."""

from types import SimpleNamespace

import numpy as np
import pytest

from diagnosis.hypotheses import refinement
from diagnosis.hypotheses.comparison import CandidateSet

MEMBERS = (0, 1)


def at(*sizes):
    """A candidate of some effect and a gain beside it."""
    sizes = np.array(sizes)
    priors = SimpleNamespace(groups=(np.array([0]), np.array([1])))
    return CandidateSet(MEMBERS, sizes, sizes, {}, [], priors, priors, None, (0,))


def problem_of(effect):
    groups = [(effect, "slew"), ("valve_gain", "slew")]
    return SimpleNamespace(layout=SimpleNamespace(groups=groups))


@pytest.fixture
def evaluated(monkeypatch):
    """Simulated sizes, and whether in a preview; the evidence is highest nearest to `best`."""
    asked = SimpleNamespace(best=0.0, previews=[])

    def simulated(problem, points, *, is_preview=False):
        asked.previews += [is_preview] * len(points)
        return [at(*sizes) for _, sizes in points]

    def nearest(found):
        return sorted(found, key=lambda t: abs(t.at[0] - asked.best))[:1]

    monkeypatch.setattr(refinement, "evaluate", simulated)
    monkeypatch.setattr(refinement, "best_of_each", nearest)
    return asked


@pytest.mark.parametrize(
    ("effect", "begin", "best"),
    [("speed_limit", 0.6, 0.4), ("speed_limit", 0.3, 0.52), ("valve_dead_time", 0.08, 0.12)],
)
def test_the_coarse_line_search_goes_both_ways(evaluated, effect, begin, best):
    evaluated.best = best
    (_, kept), (_, moved) = refinement.coarse_line_search(problem_of(effect), [at(begin, 0.2)])
    assert kept[0] == begin, "all throws decide between them"
    assert moved[0] == pytest.approx(best, rel=0.15)
    assert moved[1] == 0.2
    assert all(evaluated.previews)


def test_the_fine_line_search_uses_all_throws(evaluated):
    evaluated.best = 0.5
    (found,) = refinement.fine_line_search(problem_of("speed_limit"), [at(0.57, 0.2)])
    np.testing.assert_allclose(found.at, [0.57 / 1.1 / 1.05, 0.2])
    assert evaluated.previews == [False] * 4


def test_the_fine_line_search_keeps_the_best_size(evaluated):
    evaluated.best = 0.5
    first = at(0.5, 0.2)
    assert refinement.fine_line_search(problem_of("speed_limit"), [first]) == [first]


@pytest.mark.parametrize("effect", ["load_dependent_speed", "base_tilt"])
def test_effects_with_useful_slopes_have_no_line_search(evaluated, effect):
    problem, first = problem_of(effect), at(0.3, 0.2)
    ((_, sizes),) = refinement.coarse_line_search(problem, [first])
    assert sizes is first.at
    assert refinement.fine_line_search(problem, [first]) == [first]
    assert not evaluated.previews
