"""A validation: the candidate and the active version thrown with the same machines, and the gates."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import NamedTuple

from pydantic import BaseModel, ConfigDict

from evaluation.execution.executor import Executor
from evaluation.validation.gates import GateCheck, Gates, check_gates
from evaluation.validation.parts import (
    PartAnswer,
    ValidationPart,
    VersionFiles,
    measure_latency,
    throw_part,
)
from evaluation.validation.results import UnitLandings, ValidationPlan, VersionResult

LATENCY_SHARE = 0.02
"""Of the progress; a few seconds beside minutes."""


class ValidationResult(BaseModel):
    """What a validation found; `plan` and the versions' files give every landing again."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)
    plan: ValidationPlan
    gates: Gates
    candidate: VersionResult
    active: VersionResult | None
    """None where the candidate is the active version, or there is none."""
    checks: tuple[GateCheck, ...]
    is_passed: bool


class ValidationJob(NamedTuple):
    """One validation."""

    plan: ValidationPlan
    gates: Gates
    candidate: VersionFiles
    active: VersionFiles | None
    finished: Mapping[str, UnitLandings]
    """Parts that are known already, by name."""


class ValidationListener(NamedTuple):
    """What is called while a validation runs."""

    progress: Callable[[float, str], None]
    """Share that is done, and the step in words."""
    part: Callable[[str, PartAnswer], None]
    """A part that has ended."""


def validate(
    job: ValidationJob, executor: Executor, listener: ValidationListener
) -> ValidationResult:
    """Throw the parts that are missing and check the gates; the numbers do not depend on the executor.

    Raises:
        DownrangeError: a version or target that cannot be thrown.
    """
    plan = job.plan
    versions = [job.candidate, *([] if job.active is None else [job.active])]
    parts = [
        ValidationPart(version, plan, unit_seed)
        for version in versions
        for unit_seed in plan.unit_seeds
    ]
    listener.progress(0.0, "timing the network")
    latencies = [measure_latency(version) for version in versions]
    known = dict(job.finished)
    missing = [part for part in parts if part.name not in known]

    def tell(next_part: int) -> None:
        share = LATENCY_SHARE + (1.0 - LATENCY_SHARE) * (
            len(parts) - len(missing) + next_part
        ) / len(parts)
        if next_part < len(missing):
            part = missing[next_part]
            text = f"{part.version.policy_id} with virtual machine {part.unit_seed}"
            listener.progress(share, text)

    tell(0)
    tasks = [partial(throw_part, part) for part in missing]
    for ended, (place, answer) in enumerate(executor.run(tasks), 1):
        known[missing[place].name] = answer.landings
        listener.part(missing[place].name, answer)
        tell(ended)
    found = [
        VersionResult(
            policy_id=version.policy_id,
            policy_sha256=version.policy_sha256,
            units=tuple(
                known[ValidationPart(version, plan, unit_seed).name]
                for unit_seed in plan.unit_seeds
            ),
            latency=latency,
        )
        for version, latency in zip(versions, latencies, strict=True)
    ]
    candidate, active = found[0], found[1] if len(found) > 1 else None
    checks = check_gates(job.gates, candidate, active)
    return ValidationResult(
        plan=plan,
        gates=job.gates,
        candidate=candidate,
        active=active,
        checks=checks,
        is_passed=all(check.is_passed for check in checks),
    )
