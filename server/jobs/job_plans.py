"""Plans of the next loads, one at a time beside the server; a newer version of a job cancels the older."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from bulk.height_field import HeightField
from bulk.job_file import JobFile
from bulk.placement import middle_height_m
from bulk.planner import LoadPlanner, PlannedLoad
from bulk.throw_model import (
    LandingScatter,
    PolicyFolder,
    ThrowModel,
    learned_models,
    measured_model,
)
from machine.conventions import Mode
from machine.errors import DownrangeError
from machine.messages import Target
from machine.site.job_surface import with_job_surface
from machine.site.objects import SiteObject
from machine.spec import MachineSpec
from server.child_process import ChildFailedError, ChildKilledError
from server.clock import new_id
from server.errors import ApiError, ConflictError
from server.job_queue import Job, JobQueue
from server.jobs.job_ground import JobGround
from server.jobs.job_planning import PlanLoads, PlanTask
from server.jobs.job_store import JobRecord, Planned
from server.jobs.job_views import JobProposal, PlanningState
from server.jobs.throw_loads import measured_loads, measured_scatter
from server.machines.machine_registry import MachineRegistry
from server.plans.policy_store import PolicyStore, StoredPolicy
from server.plans.site_store import SiteStore
from server.plans.zone_store import ZoneStore
from server.store.database import Database
from sim_twin.throws.landing import SiteLanding

logger = logging.getLogger(__name__)

USUAL_SCATTER: Final = LandingScatter(8.0, 0.15, 0.1)
"""For the check of a new job, before the scatter of its throws is known; assumed."""
MODEL_COUNT: Final = 16


class KeptModels(NamedTuple):
    """Throws that the last plan of a job was made with."""

    made_from: object
    predicted: tuple[ThrowModel, ...]
    learned: tuple[ThrowModel, ...]
    """With what measured loads showed."""


@dataclass(slots=True, kw_only=True)
class OpenPlan(Job):
    """A plan that waits or is under way."""

    record: JobRecord
    ground: JobGround
    field: HeightField


class JobPlans:
    """All plans of loads."""

    def __init__(
        self,
        database: Database,
        registry: MachineRegistry,
        policies: PolicyStore,
        sites: SiteStore,
        zones: ZoneStore,
        spec: MachineSpec,
        plan: PlanLoads,
    ) -> None:
        self._database = database
        self._registry = registry
        self._policies = policies
        self._sites = sites
        self._zones = zones
        self._spec = spec
        self._plan = plan
        self._models: dict[str, KeptModels] = {}
        """By job."""
        self.on_planned: list[Callable[[str, int, Planned], None]] = []
        """Called with job, its version, and what the plan gave."""
        self._queue = JobQueue[OpenPlan]("plans of loads", "job_plans_full", self._run)

    def start(self) -> None:
        """Begin to work."""
        self._queue.start()

    def close(self) -> None:
        """Kill what runs; the next start plans anew."""
        self._queue.close()

    def submit(self, record: JobRecord, ground: JobGround, field: HeightField) -> None:
        """Plan the next loads of a job on its present surface, in place of any other plan of it."""
        row = record.row
        self.cancel(row.job_id)
        plan = OpenPlan(job_id=new_id(), record=record, ground=ground, field=field)
        self._queue.add(lambda: plan, is_bounded=False)

    def cancel(self, job_id: str) -> None:
        """Nobody waits for the plan of a job any more."""
        for plan in self._queue.open_jobs():
            if plan.record.row.job_id == job_id:
                self._queue.cancel(plan)

    def policy(self, machine_id: str, mode: Mode) -> StoredPolicy:
        """The version that a machine throws with.

        Raises:
            ApiError: no such machine, or none that can be used.
        """
        state = self._registry.get(machine_id).state
        aboard = {} if state is None else state.policy_sha256
        return self._policies.on_machine(mode, aboard.get(mode.value))

    def policies(self, machine_id: str, file: JobFile) -> tuple[PolicyFolder, ...]:
        """The versions that a job may be thrown with: of its mode, or of every mode that the machine has.

        Raises:
            ApiError: no such machine, or none that can be used.
        """
        if file.mode is not None:
            return (_folder(self.policy(machine_id, Mode(file.mode))),)
        found: list[PolicyFolder] = []
        refused: list[ApiError] = []
        for mode in Mode:
            try:
                found.append(_folder(self.policy(machine_id, mode)))
            except ApiError as error:
                refused.append(error)
        if not found:
            raise refused[0]
        return tuple(found)

    def require_reachable(self, machine_id: str, file: JobFile, ground: JobGround) -> None:
        """Refuse a job that cannot be thrown at.

        Raises:
            UsageError: with the numbers.
        """
        job, height_m = ground.job, middle_height_m(ground.job)
        models = [
            measured_model(
                one.card, self._spec, job.material, [USUAL_SCATTER], height_m, file.grab_m3
            )
            for one in self.policies(machine_id, file)
        ]
        zones = self._zones.approved(machine_id).zones
        LoadPlanner(job.goal, job.field, models, file.grab_m3, zones)

    def moved(
        self, record: JobRecord, ground: JobGround, field: HeightField, to: JobProposal
    ) -> JobProposal:
        """A proposal at another place.

        Raises:
            UsageError: it cannot be thrown at; with the numbers.
            ConflictError: no plan was made since the server started.
        """
        row, file = record.row, record.file
        kept = self._models.get(row.job_id)
        if kept is None:
            raise ConflictError("not_planned", "The next loads are being planned; wait for them.")
        zones = self._zones.approved(row.machine_id).zones
        planner = LoadPlanner(ground.job.goal, ground.job.field, kept.learned, file.grab_m3, zones)
        load = planner.load_at(field, to.x_m, to.y_m, to.volume_m3)
        return self._proposal(load, to.proposal_count, self._sites.objects(row.machine_id))

    def _run(self, plan: OpenPlan) -> None:
        row = plan.record.row
        try:
            planned = self._planned(plan)
        except ChildKilledError:
            return
        except (ChildFailedError, DownrangeError) as error:
            planned = Planned(PlanningState.FAILED, str(error))
        if not self._queue.must_end(plan):
            for listener in self.on_planned:
                listener(row.job_id, row.version_count, planned)

    def _planned(self, plan: OpenPlan) -> Planned:
        record, row, file = plan.record, plan.record.row, plan.record.file
        policies = self.policies(row.machine_id, file)
        stuff = plan.ground.job.material.name
        with self._database.read() as database:
            of = [(row.machine_id, one.card.mode, one.card.policy_sha256) for one in policies]
            landing = {which[1]: measured_scatter(database, *which) for which in of}
            loads = {which[1]: measured_loads(database, *which, stuff) for which in of}
        key = tuple(one.card.policy_sha256 for one in policies)
        kept = self._models.get(row.job_id)
        answer = self._plan(
            PlanTask(
                file=file,
                ground=record.ground,
                height_m=plan.field.height_m,
                passed_m=tuple((float(x), float(y)) for x, y in row.passed_m),
                zones=self._zones.approved(row.machine_id).zones,
                policies=policies,
                landing=landing,
                loads=loads,
                models=None if kept is None or kept.made_from != key else kept.predicted,
            ),
            lambda: self._queue.must_end(plan),
        )
        learned = learned_models(answer.models, landing, loads)
        self._models[row.job_id] = KeptModels(key, answer.models, learned)
        while len(self._models) > MODEL_COUNT:
            self._models.pop(next(iter(self._models)))
        objects = self._sites.objects(row.machine_id)
        return Planned(
            PlanningState.READY if answer.loads else PlanningState.NOTHING_LEFT,
            landing_by="measured" if any((*landing.values(), *loads.values())) else "predicted",
            proposals=tuple(
                self._proposal(load, number, objects)
                for number, load in enumerate(answer.loads, start=1)
            ),
        )

    @staticmethod
    def _proposal(load: PlannedLoad, number: int, objects: Sequence[SiteObject]) -> JobProposal:
        return JobProposal(
            proposal_count=number,
            mode=load.mode,
            pace_ratio=load.pace_ratio,
            x_m=load.x_m,
            y_m=load.y_m,
            z_m=target_height_m(objects, load),
            surface_m=load.z_m,
            volume_m3=load.volume_m3,
            spill_ratio=load.spill_ratio,
            sentence=load.sentence,
        )


def _folder(policy: StoredPolicy) -> PolicyFolder:
    return PolicyFolder(policy.folder, policy.card)


def target_height_m(objects: Sequence[SiteObject], load: PlannedLoad) -> float:
    """Height that a preview takes at a load's place: that of the material, if an object can stand for it."""
    target = Target(x_m=load.x_m, y_m=load.y_m, z_m=load.z_m)
    around = with_job_surface(objects, load.x_m, load.y_m, load.z_m)
    refusal = SiteLanding.of(around, target).target_refusal(target)
    known_m = None if refusal is None else refusal.surface_m
    return load.z_m if known_m is None else known_m
