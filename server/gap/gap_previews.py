"""One target previewed twice: without and with what a diagnosis found, before and after it is applied.

Same policy, pose, calibration and random numbers, so that all of the difference is the profile's.
"""

import threading
from collections.abc import Iterable
from concurrent.futures import CancelledError, Future, TimeoutError
from dataclasses import dataclass
from pathlib import Path

from machine.conventions import Mode
from machine.errors import RefusedError
from machine.messages import Target
from machine.reach import check_target
from machine.starts import safe_pose
from server.clock import new_id
from server.errors import TooManyRequestsError, UnavailableError, from_refusal
from server.gap.twin_versions import TwinVersions
from server.machines.machine_registry import MachineRegistry
from server.machines.twin_files import TwinFiles
from server.plans.plan_views import prediction_of
from server.plans.policy_store import PolicyStore
from server.plans.preview_pool import PreviewPool
from server.plans.preview_worker import CancelledPreviewError, PreviewJob, Six
from server.schemas.console import TargetView
from server.schemas.gap import GapPreviewView, GapSideView
from server.schemas.plans import RefusalView
from sim_twin.throws.preview import ThrowPreview
from sim_twin.twin.profile import save_profile

FOLDER = "gap"
ROLLOUT_COUNT = 60
WAIT_S = 60.0
AT_ONCE_COUNT = 4
"""Comparisons that may wait for the preview processes; each keeps one of the server's threads."""
SEED = 1


@dataclass(frozen=True, slots=True)
class _Start:
    """The pose both previews begin from."""

    joints: Six
    is_machine_pose: bool


class GapPreviews:
    """Compares previews; nothing is stored, nothing can be armed."""

    def __init__(
        self,
        registry: MachineRegistry,
        policies: PolicyStore,
        pool: PreviewPool,
        twins: TwinFiles,
        versions: TwinVersions,
        data_dir: Path,
    ) -> None:
        self._registry = registry
        self._policies = policies
        self._pool = pool
        self._twins = twins
        self._versions = versions
        self._folder = data_dir / FOLDER
        self._places = threading.BoundedSemaphore(AT_ONCE_COUNT)

    def compare(
        self, machine_id: str, gap_run_id: str, mode: Mode, target: Target
    ) -> GapPreviewView:
        """Preview a target without and with what a run found, also while that is in use.

        Raises:
            ApiError: nothing to apply, target out of reach, no policy, or previews are busy or away.
        """
        known = self._registry.get(machine_id)
        profiles = self._versions.compared(machine_id, gap_run_id)
        aboard = {} if known.state is None else known.state.policy_sha256
        policy = self._policies.on_machine(mode, aboard.get(mode.value))
        try:
            check_target(policy.card, target)
        except RefusedError as error:
            raise from_refusal(error) from error
        start = _Start(_six(safe_pose()), is_machine_pose=False)
        if known.is_connected and known.state is not None:
            start = _Start(_six(known.state.joint_position_rad_m), is_machine_pose=True)
        self._folder.mkdir(parents=True, exist_ok=True)
        paths = [self._folder / f"{new_id()}.profile.json" for _ in profiles]
        try:
            for profile, path in zip(profiles, paths, strict=True):
                save_profile(profile, path)
            jobs = [
                PreviewJob(
                    job_id=new_id(),
                    slot=0,
                    policy_dir=policy.folder,
                    target=target,
                    joint_position_rad_m=start.joints,
                    rollout_count=ROLLOUT_COUNT,
                    calibration_path=self._twins.calibration_path(machine_id),
                    profile_path=path,
                    seed=SEED,
                )
                for path in paths
            ]
            previews = self._previews(jobs)
        finally:
            for path in paths:
                path.unlink(missing_ok=True)
        return GapPreviewView(
            machine_id=machine_id,
            mode=mode,
            target=TargetView.of(target),
            is_machine_pose=start.is_machine_pose,
            before=_side(profiles[0].version_count, target, previews[0]),
            after=_side(profiles[1].version_count, target, previews[1]),
        )

    def _previews(self, jobs: list[PreviewJob]) -> list[ThrowPreview]:
        if not self._places.acquire(blocking=False):
            raise TooManyRequestsError(
                "previews_busy",
                f"{AT_ONCE_COUNT} comparisons are being previewed already. Try again in a moment.",
            )
        futures: list[Future[ThrowPreview]] = []
        try:
            futures = [self._pool.submit(job, lambda _: None) for job in jobs]
            return [future.result(WAIT_S) for future in futures]
        except (TimeoutError, CancelledError, CancelledPreviewError, RuntimeError) as error:
            for job in jobs:
                self._pool.cancel(job.job_id)
            raise UnavailableError(
                "preview", f"The previews did not come within {WAIT_S:.0f} s. Try again."
            ) from error
        finally:
            self._places.release()


def _six(values: Iterable[float]) -> Six:
    a, b, c, d, e, f = (float(value) for value in values)
    return (a, b, c, d, e, f)


def _side(version_count: int, target: Target, preview: ThrowPreview) -> GapSideView:
    return GapSideView(
        version_count=version_count,
        prediction=prediction_of(target, preview),
        refusals=tuple(
            RefusalView(reason=item.reason.value, detail=item.detail) for item in preview.refused
        ),
    )
