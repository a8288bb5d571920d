"""Throws of a machine while it was healthy, and what they show about it.

Healthy machines of a type scatter more than one of them does over time, and a machine may be of another type.
Reference throws make the machine its own baseline (population/machine_baseline.py): its deviations from the
twin, the covariance of what the twin misses on it, and the scatter above which an effect has to show.
"""

from collections.abc import Sequence
from typing import Any

from diagnosis.healthy.health import Health
from diagnosis.hypotheses.gap_problem import pose_problem
from diagnosis.linearisation.parameters import layout
from diagnosis.loading.prepared import prepare
from diagnosis.loading.throw_data import LoadedSet, ThrowData, refusals
from diagnosis.population.machine_baseline import ReferenceThrows, machine_model
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
    throws = ReferenceThrows(problem.prepared, problem.linear, problem.beside)
    return Health(problem.healthy, machine_model(problem.model, throws), is_own=True)
