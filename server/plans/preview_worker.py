"""Computes parts of previews in a worker process, one at a time, with the twin loaded once."""

import logging
import os
from dataclasses import dataclass, field
from functools import partial
from multiprocessing.queues import SimpleQueue
from pathlib import Path
from typing import Any

from machine.calibration import load_calibration, nominal_calibration
from machine.conventions import DEFAULT_PACE_RATIO
from machine.errors import DownrangeError
from machine.messages import Target
from machine.policy_card import POLICY_FILE
from machine.site.objects import SiteObject
from machine.site.zones import Zone
from machine.spec import MachineSpec, load_spec
from machine.starts import safe_pose
from runtime.control.control_loop import ControlParams
from runtime.control.policy import PolicyRunner
from sim_twin.child_processes import end_with_parent
from sim_twin.throws.preview import (
    PreviewRequest,
    ScatteredThrows,
    ScatterPart,
    ThrowPreview,
    nominal_throw,
    preview,
    scattered_throws,
)
from sim_twin.twin.profile import TwinProfile, load_profile, nominal_profile

logger = logging.getLogger(__name__)

NICENESS = 5
"""Previews give way to a control loop that shares the computer, as in the demo."""
Six = tuple[float, float, float, float, float, float]


@dataclass(frozen=True, slots=True)
class PreviewJob:
    """One preview, as it travels to a worker process."""

    job_id: str
    slot: int
    """Place of this job's cancel flag."""
    policy_dir: Path
    target: Target
    joint_position_rad_m: Six
    rollout_count: int
    calibration_path: Path | None
    profile_path: Path | None
    seed: int
    pace_ratio: float = DEFAULT_PACE_RATIO
    site: tuple[SiteObject, ...] = ()
    zones: tuple[Zone, ...] = ()
    aim: Target | None = None
    """Where the aim correction lets the policy aim."""


class CancelledPreviewError(Exception):
    """The preview was cancelled."""


@dataclass(slots=True)
class Worker:
    """State of a worker process."""

    updates: "SimpleQueue[tuple[str, ThrowPreview]]"
    cancelled: Any
    """Shared flags, one a slot."""
    spec: MachineSpec = field(default_factory=load_spec)
    runners: dict[tuple[Path, int], PolicyRunner] = field(
        default_factory=dict[tuple[Path, int], PolicyRunner]
    )

    def nominal(self, job: PreviewJob) -> ThrowPreview:
        """Simulate the throw that is shown, sending what is known on the way.

        Raises:
            CancelledPreviewError: the job's flag was raised.
            DownrangeError: policy, calibration or profile cannot be used.
        """
        self._check(job)
        request = self.request(job)
        return nominal_throw(request, partial(self._progress, job), partial(self._check, job))

    def scattered(self, job: PreviewJob, part: ScatterPart) -> ScatteredThrows:
        """Simulate one part of the scattered throws.

        Raises:
            CancelledPreviewError, DownrangeError: as `nominal`.
        """
        self._check(job)
        return scattered_throws(self.request(job), part, partial(self._check, job))

    def request(self, job: PreviewJob) -> PreviewRequest:
        """What is asked for, with the files loaded."""
        runner = self._runner(job.policy_dir)
        calibration = (
            nominal_calibration(self.spec)
            if job.calibration_path is None
            else load_calibration(job.calibration_path).for_twin()
        )
        return PreviewRequest(
            params=ControlParams(self.spec, calibration, runner.card.mode, runner),
            profile=self._profile(job.profile_path),
            target=job.target,
            joint_position_rad_m=job.joint_position_rad_m,
            rollout_count=job.rollout_count,
            seed=job.seed,
            pace_ratio=job.pace_ratio,
            site=job.site,
            zones=job.zones,
            aim=job.aim,
        )

    def _progress(self, job: PreviewJob, so_far: ThrowPreview) -> None:
        self._check(job)
        self.updates.put((job.job_id, so_far))

    def _check(self, job: PreviewJob) -> None:
        if self.cancelled[job.slot]:
            raise CancelledPreviewError

    def _runner(self, folder: Path) -> PolicyRunner:
        key = (folder, (folder / POLICY_FILE).stat().st_mtime_ns)
        if key not in self.runners:
            self.runners[key] = PolicyRunner(folder, self.spec)
        return self.runners[key]

    def _profile(self, path: Path | None) -> TwinProfile:
        return nominal_profile(self.spec) if path is None else load_profile(path)


_worker: Worker | None = None


def start_worker(
    updates: "SimpleQueue[tuple[str, ThrowPreview]]", cancelled: Any, warm_up: tuple[Path, ...]
) -> None:
    """First thing in a new process: load everything once, so that no operator waits for it."""
    global _worker  # a worker process is this one object
    os.nice(NICENESS)
    end_with_parent()
    _worker = Worker(updates, cancelled)
    for folder in warm_up:
        try:
            preview(_worker.request(_warm_up_job(folder, _worker.spec)))
        except DownrangeError as error:
            # A policy that cannot be used is refused where it is asked for, with its cause.
            logger.warning("preview process not warmed up with %s: %r", folder, error)


def run_nominal(job: PreviewJob) -> ThrowPreview:
    """Entry point of a job's nominal throw in the worker process."""
    assert _worker is not None
    return _worker.nominal(job)


def run_scattered(job: PreviewJob, part: ScatterPart) -> ScatteredThrows:
    """Entry point of a part of a job's scattered throws in the worker process."""
    assert _worker is not None
    return _worker.scattered(job, part)


def _warm_up_job(folder: Path, spec: MachineSpec) -> PreviewJob:
    pose = safe_pose()
    return PreviewJob(
        job_id="",
        slot=0,
        policy_dir=folder,
        target=Target(x_m=8.0, y_m=0.0),
        joint_position_rad_m=(pose[0], pose[1], pose[2], pose[3], pose[4], pose[5]),
        rollout_count=2,
        calibration_path=None,
        profile_path=None,
        seed=0,
    )


def unit_of(name: str) -> str:
    """Unit of a clearance by its name: joint limits of the hinges are angles, the rest is distance."""
    return "rad" if name.startswith(("boom", "dipper")) and name.endswith("limit") else "m"
