"""Validations on the twin, or without a throw, and ones that go wrong; a process can run each of them."""

import os
import time
from collections.abc import Callable

import numpy as np

from evaluation.execution.executor import LocalProcesses
from evaluation.measures import Estimate, Failure, TargetRow, deviation_estimate, mean_estimate
from evaluation.validation.gates import check_gates
from evaluation.validation.parts import PartAnswer, ValidationPart, VersionFiles
from evaluation.validation.results import Latency, UnitLandings, VersionResult
from evaluation.validation.validation import (
    ValidationJob,
    ValidationListener,
    ValidationResult,
    validate,
)
from machine.errors import UsageError
from server.child_process import ChildFailedError, ChildKilledError
from server.validation.validation_worker import (
    CampaignProcesses,
    Validate,
)

PART = "part "


class InThread:
    """Runs a validation without a process of its own, for tests of what is around it."""

    def __init__(self, how: Validate) -> None:
        self._how = how

    def run(
        self, job: ValidationJob, listener: ValidationListener, is_cancelled: Callable[[], bool]
    ) -> ValidationResult:
        def progress(share: float, text: str) -> None:
            if is_cancelled():
                raise ChildKilledError
            listener.progress(share, text)

        try:
            return self._how(job, CampaignProcesses(), listener._replace(progress=progress))
        except UsageError as error:
            raise ChildFailedError(str(error)) from error


COUNT = 20


def in_twin(
    job: ValidationJob, processes: CampaignProcesses, listener: ValidationListener
) -> ValidationResult:
    """Two throws at two targets with each version."""
    plan = job.plan.model_copy(update={"plant": "twin", "ranges_m": job.plan.ranges_m[:2]})
    return validate(job._replace(plan=plan), LocalProcesses(1), listener)


def made_up(unit_seed: int, lost: int = 0) -> UnitLandings:
    """Twenty throws at one target, of which the last ones did not land."""
    errors = np.random.default_rng(unit_seed).normal(0.0, 0.03, COUNT - lost)
    row = TargetRow(
        range_m=9.0,
        throws=COUNT,
        landed=COUNT - lost,
        success_ratio=Estimate(value=1.0 - lost / COUNT, ci95=None),
        mean_downrange_error_m=mean_estimate(errors),
        sd_downrange_m=deviation_estimate(errors),
        mean_crossrange_error_m=mean_estimate(errors),
        sd_crossrange_m=deviation_estimate(errors),
        downrange_error_m=tuple(errors.tolist()),
        crossrange_error_m=tuple(errors.tolist()),
    )
    failures = [
        Failure(
            range_m=9.0, number=COUNT - 1 - k, outcome="no_release", after_release=False, log=None
        )
        for k in range(lost)
    ]
    return UnitLandings(
        unit_seed=unit_seed,
        is_registered=True,
        registration_note="made up",
        targets=(row,),
        failures=tuple(failures),
        is_repeatable=True,
    )


def _result(job: ValidationJob, lost: int = 0) -> ValidationResult:
    def version(files: VersionFiles, lost: int) -> VersionResult:
        names = {seed: ValidationPart(files, job.plan, seed).name for seed in job.plan.unit_seeds}
        units = (job.finished.get(name) or made_up(seed, lost) for seed, name in names.items())
        return VersionResult(
            policy_id=files.policy_id,
            policy_sha256=files.policy_sha256,
            units=tuple(units),
            latency=Latency(p50_s=5e-5, p99_s=1e-4, run_count=100),
        )

    candidate = version(job.candidate, lost)
    active = None if job.active is None else version(job.active, 0)
    checks = check_gates(job.gates, candidate, active)
    return ValidationResult(
        plan=job.plan,
        gates=job.gates,
        candidate=candidate,
        active=active,
        checks=checks,
        is_passed=all(check.is_passed for check in checks),
    )


def passing(
    job: ValidationJob, processes: CampaignProcesses, listener: ValidationListener
) -> ValidationResult:
    return _result(job)


def losing(
    job: ValidationJob, processes: CampaignProcesses, listener: ValidationListener
) -> ValidationResult:
    """Four of twenty throws do not land."""
    listener.progress(0.5, "half way")
    return _result(job, lost=4)


def patient(
    job: ValidationJob, processes: CampaignProcesses, listener: ValidationListener
) -> ValidationResult:
    """Ends its first part and then never ends by itself."""
    part = ValidationPart(job.candidate, job.plan, 0)
    listener.part(part.name, PartAnswer(made_up(0, lost=1), {}))
    while True:
        listener.progress(0.5, PART + part.name)
        time.sleep(0.05)


def only_missing(
    job: ValidationJob, processes: CampaignProcesses, listener: ValidationListener
) -> ValidationResult:
    """Goes on where one part is known already."""
    if len(job.finished) != 1:
        raise UsageError(f"{len(job.finished)} parts are known")
    return _result(job)


def refusing(
    job: ValidationJob, processes: CampaignProcesses, listener: ValidationListener
) -> ValidationResult:
    raise UsageError("the machine cannot be calibrated")


def dying(
    job: ValidationJob, processes: CampaignProcesses, listener: ValidationListener
) -> ValidationResult:
    os._exit(7)
