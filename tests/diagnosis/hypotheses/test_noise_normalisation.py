"""Noise of a set's own is no evidence."""

import numpy as np
import pytest

from diagnosis.hypotheses.noise_normalisation import in_common_noise
from diagnosis.inference.evidence import log_likelihood, screen, total
from diagnosis.linearisation.whitening import information, whiten_throw
from tests.diagnosis.twin_throws import posed, throws

WIDER = 1.5


def test_no_effect_has_the_same_evidence_in_either_noise() -> None:
    problem = posed(throws((), 3))
    wide = [[WIDER * block for block in factor] for factor in problem.factor]
    there = information(
        [
            whiten_throw(p, linear, problem.model, factor, basis)
            for p, linear, factor, basis in zip(
                problem.prepared, problem.linear, wide, problem.basis, strict=True
            )
        ]
    )
    mean = screen(total(problem.information), problem.layout.priors).mean
    common = [log_likelihood(one, mean) for one in problem.information]
    before = [log_likelihood(one, mean) for one in there]
    after = [
        log_likelihood(one, mean) for one in in_common_noise(problem.no_effect_throw, wide, there)
    ]
    assert np.abs(np.subtract(before, common)).min() > 100.0
    assert after == pytest.approx(common)
    assert [one.log_likelihood for one in problem.no_effect_throw] == pytest.approx(common)
