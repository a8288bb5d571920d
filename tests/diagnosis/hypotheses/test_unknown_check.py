"""What the best set leaves is compared with what healthy throws leave."""

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.hypotheses.candidate import no_effect
from diagnosis.hypotheses.gap_problem import GapProblem
from diagnosis.hypotheses.marginal_likelihood import ThrowColumns, marginal_likelihood
from diagnosis.hypotheses.unknown_check import (
    Left,
    check,
    conflicts,
    left_by,
    levels_of,
    unknown_probability,
)
from machine.conventions import Array
from tests.diagnosis.twin_throws import posed_healthy


@pytest.fixture(scope="module")
def problem() -> GapProblem:
    """Throws of the twin, whose residual is the usual one."""
    found = posed_healthy(3)
    likelihood = marginal_likelihood(found)
    none = no_effect(likelihood)
    levels = levels_of(likelihood, none.change, none.healthy_mean)
    usual = {name: (level, 0.1) for name, level in levels.items()}
    return replace(found, model=found.model.model_copy(update={"unknown_level": usual}))


def test_healthy_throws_leave_what_is_usual(problem: GapProblem) -> None:
    usual = {name: level for name, (level, _) in problem.model.unknown_level.items()}
    left = check(problem, usual, usual)
    assert set(left) >= {"actuation.boom", "swing", "flight"}
    assert unknown_probability(left) < 1e-3


def test_a_part_that_leaves_more_is_unknown_and_named(problem: GapProblem) -> None:
    usual = {name: level for name, (level, _) in problem.model.unknown_level.items()}
    louder = usual | {"actuation.boom": usual["actuation.boom"] + 1.0}
    left = check(problem, louder, louder)
    assert max(left, key=lambda part: left[part].ratio) == "actuation.boom"
    assert unknown_probability(left) > 0.9
    # The form error of an effect that explains most of a large misfit is none.
    without = usual | {"actuation.boom": usual["actuation.boom"] + 5.0}
    assert unknown_probability(check(problem, louder, without)) < 0.1


@pytest.mark.parametrize(("explained_ratio", "is_unknown"), [(0.9, False), (0.7, True)])
def test_a_set_may_leave_a_share_of_the_power_that_it_explains(
    problem: GapProblem, explained_ratio: float, is_unknown: bool
) -> None:
    likelihood = marginal_likelihood(problem)
    none = no_effect(likelihood)
    changes: list[Array] = []
    throws: list[ThrowColumns] = []
    for i, (p, one) in enumerate(zip(problem.prepared, likelihood.throws, strict=True)):
        block = p.block("actuation.boom")
        assert block is not None
        change = np.zeros(one.residual.size)
        change[block.rows] = 0.1 * np.sin(np.arange(change[block.rows].size) / 5.0)
        changes.append(explained_ratio * change)
        acting = likelihood.whitened(i, change[:, None])[:, 0]
        throws.append(replace(one, residual=one.residual + acting))
    found = left_by(replace(likelihood, throws=throws), changes, none.healthy_mean)
    assert (unknown_probability(found) > 0.5) is is_unknown


def test_a_machine_that_had_to_move_too_far_is_unknown(problem: GapProblem) -> None:
    likelihood = marginal_likelihood(problem)
    scatter = problem.layout.priors.scatter
    small, large = (conflicts(likelihood, k * np.sqrt(np.diag(scatter))) for k in (0.1, 10.0))
    assert max(small.values()) < 0.5
    assert min(large.values()) > 1.0
    part = {"actuation.boom": Left(0.0, 0.0, large["actuation.boom"])}
    assert unknown_probability(part) > 0.5
