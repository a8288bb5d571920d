"""Sets that are told in noise of their own: what the noise alone is worth belongs to nobody."""

from collections.abc import Sequence

from diagnosis.causes.problem import Problem
from diagnosis.causes.selection import Information, log_likelihood, screen, total
from diagnosis.causes.whitening import information, whiten_throw
from machine.conventions import Array


def in_common_noise(
    problem: Problem, factors: Sequence[Sequence[Array]], found: Sequence[Information]
) -> list[Information]:
    """What throws say in some noise, less what that noise has ahead of all other sets' at no effect.

    Joints that an effect shakes are told in wider noise, which makes all that is left there more probable,
    whatever explains the rest: with it a telescope's bias that did not exist came out 900 ahead beside a
    sticking boom that had been told in the common noise.

    Args:
        problem: the throws.
        factors: of the noise that is their own, of every throw's blocks.
        found: what they say in it, throw after throw.
    """
    mean = screen(total(problem.information), problem.layout.priors).mean
    there = information(
        [
            whiten_throw(p, linear, problem.model, factor, basis)
            for p, linear, factor, basis in zip(
                problem.prepared, problem.linear, factors, problem.basis, strict=True
            )
        ]
    )
    ahead = [
        log_likelihood(own, mean) - log_likelihood(common, mean)
        for own, common in zip(there, problem.information, strict=True)
    ]
    return [
        one._replace(log_volume=one.log_volume + more)
        for one, more in zip(found, ahead, strict=True)
    ]
