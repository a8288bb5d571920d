"""Diagnoses that are quick, and ones that go wrong; each runs in the real process, so each is a function."""

import os
import time
from contextlib import closing

from diagnosis.verdict import (
    Cause,
    Diagnosis,
    FittedEffect,
    FittedParameter,
    Gap,
    Miss,
    Stage,
    StageGap,
    VerdictKind,
)
from diagnosis.worker_process import WorkerProcess
from machine.errors import UsageError
from server.gap.gap_worker import GapJob, Progress

EXTRA_S = 0.06


def explained(value: float = EXTRA_S) -> Diagnosis:
    """A dipper that is late."""
    effect = FittedEffect(
        effect="valve_dead_time",
        joint="dipper",
        parameters={"extra_dead_time_s": FittedParameter(value=value, ci90=(0.05, 0.07), unit="s")},
    )
    return Diagnosis(
        verdict=VerdictKind.EXPLAINED,
        sentence="The dipper is late by 60 ms.",
        gap=Gap(impact_rms_m=0.4),
        stages=(
            StageGap(
                stage=Stage.ACTUATION,
                joint="dipper",
                miss_m=Miss(downrange=-0.4, crossrange=0.0),
                share_ratio=1.0,
                ci90_m=(-0.5, -0.3),
            ),
        ),
        causes=(
            Cause(effects=(effect,), probability=0.95, name="valve dead time of the dipper"),
            Cause(effects=(), probability=0.05, name="none"),
        ),
        evidence={"note": "<script>alert(1)</script>", "missing": float("nan")},
    )


def quick(job: GapJob, progress: Progress) -> Diagnosis:
    progress(0.5, "half way")
    return explained().model_copy(
        update={
            "evidence": {
                **explained().evidence,
                "logs": len(job.log_paths),
                "healthy": len(job.reference_paths),
                "material_m": job.material_m,
            }
        }
    )


def nothing_found(job: GapJob, progress: Progress) -> Diagnosis:
    return Diagnosis(verdict=VerdictKind.NONE, sentence="A healthy machine.")


def patient(job: GapJob, progress: Progress) -> Diagnosis:
    """Never ends by itself; leaves its processes' numbers where the test finds them."""
    with closing(WorkerProcess()) as worker:
        ours, theirs = worker.split(process_ids, None, [0, 1])
        (job.log_paths[0].parent / "gap.pid").write_text(f"{ours} {theirs} {os.nice(0)}")
        progress(0.25, "which: sets of effects")
        while True:
            time.sleep(0.05)


def process_ids(value: None, items: list[int]) -> list[int]:
    return [os.getpid()] * len(items)


def dying(job: GapJob, progress: Progress) -> Diagnosis:
    os._exit(7)


def mistaken(job: GapJob, progress: Progress) -> Diagnosis:
    raise KeyError("boom")


def infinite(job: GapJob, progress: Progress) -> Diagnosis:
    found = explained()
    stage = found.stages[0].model_copy(update={"share_ratio": float("nan")})
    return found.model_copy(update={"stages": (stage,)})


def refusing(job: GapJob, progress: Progress) -> Diagnosis:
    raise UsageError("0 usable healthy throws to compare with")
