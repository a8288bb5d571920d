"""Throws of a machine while it was healthy, and what they show about it.

Healthy machines of a type scatter more than one of them does over time. The reference throws estimate the
machine's own share of that scatter (hierarchical_prior.py). Its estimate becomes the mean, and its posterior
covariance the scatter above which an effect has to show.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from diagnosis.healthy.health import Health
from diagnosis.healthy.noise import NoiseModel, Scatter
from diagnosis.hypotheses.gap_problem import GapProblem, pose_problem
from diagnosis.inference.evidence import total
from diagnosis.linearisation.parameters import layout, scatter_names
from diagnosis.loading.prepared import prepare
from diagnosis.loading.throw_data import LoadedSet, ThrowData, refusals
from diagnosis.population.hierarchical_prior import Levels, of_machine, set_likelihood
from machine.errors import UsageError
from sim_twin.twin.profile import TwinProfile


def check_reference(reference: LoadedSet, diagnosed: Sequence[ThrowData]) -> None:
    """Refuse reference throws that cannot be compared with the diagnosed ones.

    Raises:
        UsageError: too few, of another machine, or among those that are diagnosed.
    """
    shortage = reference.shortage("usable reference throws")
    if shortage is not None:
        raise UsageError(shortage)
    own, other = diagnosed[0].machine_id, reference.throws[0].machine_id
    if own != other:
        raise UsageError(
            f"the reference throws are of machine {other!r}, the diagnosed ones of {own!r}: a machine can "
            "only be compared with itself. Give healthy throws of the same machine, or none"
        )
    both = sorted({t.throw_id for t in diagnosed} & {t.throw_id for t in reference.throws})
    if both:
        raise UsageError(
            f"{len(both)} throws are to be diagnosed and are reference throws as well "
            f"({', '.join(both[:3])}): what both have would not show. Give each throw once"
        )


def reference_evidence(reference: LoadedSet | None) -> dict[str, Any] | None:
    """For `Diagnosis.evidence`; None where the machine was compared with healthy machines of its type."""
    if reference is None:
        return None
    return {
        "throws_count": len(reference.throws),
        "throw_ids": [throw.throw_id for throw in reference.throws],
        "refused": refusals(reference.refused),
    }


def health_from_reference(reference: LoadedSet, profile: TwinProfile, health: Health) -> Health:
    """The model of this machine from that of its type and from throws while it was healthy."""
    plan = layout(health.noise)
    prepared, calibration = prepare(reference.throws, profile), reference.throws[0].calibration
    problem = pose_problem(prepared, profile, calibration, health, plan)
    return Health(problem.healthy, _with_posterior(problem.model, problem), is_own=True)


def _with_posterior(model: NoiseModel, problem: GapProblem) -> NoiseModel:
    """The model with the posterior of this machine's own share of the scatter."""
    names = scatter_names()
    levels = Levels(
        np.zeros(len(names)),
        model.machine_scatter.covariance(names),
        model.set_scatter.covariance(names),
    )
    mean, covariance = of_machine(
        [set_likelihood(total(problem.information), problem.layout)], levels
    )
    return model.model_copy(
        update={
            "healthy_mean": {
                name: model.healthy_mean.get(name, 0.0) + float(off)
                for name, off in zip(names, mean, strict=True)
            },
            "machine_scatter": Scatter.of(names, covariance),
        }
    )
