"""Rollouts in the database, and where their machines stand by deployments, events and throws."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession

from evaluation.validation.gates import Gates
from machine.conventions import Mode
from server.clock import utc_now
from server.deployments.machine_policies import policy_aboard
from server.errors import NotFoundError
from server.rollouts.rollout_figures import MachineThrows, figures, machine_throws, worse_sentence
from server.rollouts.rollout_rules import MachineStanding
from server.rollouts.rollout_views import (
    RolloutMachineView,
    RolloutState,
    RolloutStepView,
    RolloutView,
    StagePlan,
    StageTest,
)
from server.rollouts.stage_test import FALSE_ALARM_RATIO, stage_test
from server.schemas.deployments import DeploymentOutcome
from server.store.models import Deployment
from server.store.rollout_tables import RolloutMachine, RolloutRow, RolloutStep

OPEN_STATES: Final = (RolloutState.RUNNING.value, RolloutState.PAUSED.value)
LISTED_COUNT: Final = 20

Name = Callable[[str], str]


@dataclass(frozen=True, slots=True)
class StandingThrows:
    """Where a machine stands, and the throws that say so."""

    standing: MachineStanding
    throws: MachineThrows | None
    """None before it was asked."""
    before_sha256: str | None


def row_of(database: DatabaseSession, rollout_id: str) -> RolloutRow:
    """A rollout.

    Raises:
        NotFoundError: there is none.
    """
    row = database.get(RolloutRow, rollout_id)
    if row is None:
        raise NotFoundError("no_rollout", f"There is no rollout {rollout_id[:40]}.")
    return row


def stages_of(row: RolloutRow) -> list[StagePlan]:
    """The stages in their order."""
    return [StagePlan.model_validate(stage) for stage in row.stages]


def steps_of(database: DatabaseSession, rollout_id: str) -> Sequence[RolloutStep]:
    """What happened, oldest first."""
    query = select(RolloutStep).where(RolloutStep.rollout_id == rollout_id)
    return database.scalars(query.order_by(RolloutStep.step_count)).all()


def open_ids(database: DatabaseSession, mode: Mode | None = None) -> list[str]:
    """Rollouts that run or are paused."""
    newest = (
        select(RolloutStep.state)
        .where(RolloutStep.rollout_id == RolloutRow.rollout_id)
        .order_by(RolloutStep.step_count.desc())
        .limit(1)
        .correlate(RolloutRow)
        .scalar_subquery()
    )
    query = select(RolloutRow.rollout_id).where(newest.in_(OPEN_STATES))
    if mode is not None:
        query = query.where(RolloutRow.mode == mode.value)
    return list(database.scalars(query.order_by(RolloutRow.rollout_id)))


def newest_deployment(database: DatabaseSession, machine_id: str, mode: str) -> Deployment | None:
    """The deployment that counts."""
    query = select(Deployment).where(Deployment.machine_id == machine_id, Deployment.mode == mode)
    return database.scalars(query.order_by(Deployment.deployment_count.desc()).limit(1)).first()


def add_step(
    database: DatabaseSession,
    rollout_id: str,
    state: RolloutState,
    stage_count: int,
    actor: str,
    sentence: str,
) -> RolloutStep:
    """Add what happened."""
    step = RolloutStep(
        rollout_id=rollout_id,
        state=state.value,
        stage_count=stage_count,
        actor=actor[:64],
        sentence=sentence[:2000],
        at_utc=utc_now(),
    )
    database.add(step)
    database.flush()
    return step


def note_asked(
    database: DatabaseSession,
    row: RolloutRow,
    machine_id: str,
    before_sha256: str | None,
    deployment_count: int | None,
) -> None:
    """Keep that a machine was asked; inside the transaction of its deployment, where it has one."""
    database.add(
        RolloutMachine(
            rollout_id=row.rollout_id,
            machine_id=machine_id,
            before_sha256=before_sha256,
            deployment_count=deployment_count,
            asked_utc=utc_now(),
        )
    )


def standing_of(
    database: DatabaseSession, row: RolloutRow, machine_id: str, gates: Gates, name_of: Name
) -> StandingThrows:
    """Where a machine stands.

    Args:
        database: a transaction.
        row: rollout.
        machine_id: one of its machines.
        gates: in force for the mode.
        name_of: id of a version by its hash.
    """
    asked = database.get(RolloutMachine, (row.rollout_id, machine_id))
    if asked is None:
        return StandingThrows(MachineStanding(machine_id, None, is_aboard=False), None, None)
    aboard = policy_aboard(database, machine_id, Mode(row.mode))
    is_aboard = aboard == row.policy_sha256
    throws = machine_throws(
        database,
        machine_id,
        row.mode,
        before_sha256=asked.before_sha256,
        policy_sha256=row.policy_sha256,
        since_utc=asked.asked_utc,
        throws_count=row.throws_count,
    )
    finding = stage_test(
        throws.before,
        throws.since,
        gates,
        machine_count=sum(len(stage.machine_ids) for stage in stages_of(row)),
        throws_count=row.throws_count,
    )
    standing = MachineStanding(
        machine_id,
        asked.asked_utc,
        is_aboard=is_aboard,
        problem="" if is_aboard else _problem(database, row, asked, aboard, name_of),
        finding=finding,
        worse=worse_sentence(machine_id, finding, throws, gates),
    )
    return StandingThrows(standing, throws, asked.before_sha256)


def _problem(
    database: DatabaseSession,
    row: RolloutRow,
    asked: RolloutMachine,
    aboard: str | None,
    name_of: Name,
) -> str:
    """Why a machine that was asked will not switch; empty where it still may."""
    machine_id = asked.machine_id
    newest = newest_deployment(database, machine_id, row.mode)
    if newest is not None and newest.policy_sha256 != row.policy_sha256:
        return f"{machine_id} was asked for {name_of(newest.policy_sha256)} since, by {newest.created_by}."
    if newest is not None and newest.outcome == DeploymentOutcome.REFUSED.value:
        return f"{machine_id} refused it: {newest.detail.rstrip('.')}."
    if newest is None or newest.outcome == DeploymentOutcome.SWITCHED.value:
        now = "no usable version" if aboard is None else name_of(aboard)
        return f"{machine_id} has {now} on board again."
    return ""


def rollout_view(
    database: DatabaseSession, row: RolloutRow, gates: Gates, name_of: Name
) -> RolloutView:
    """A rollout with its machines."""
    steps = steps_of(database, row.rollout_id)
    stages = stages_of(row)
    machines = [
        _machine_view(standing_of(database, row, machine_id, gates, name_of), count, name_of)
        for count, stage in enumerate(stages)
        for machine_id in stage.machine_ids
    ]
    return RolloutView(
        rollout_id=row.rollout_id,
        mode=Mode(row.mode),
        policy_sha256=row.policy_sha256,
        policy_id=name_of(row.policy_sha256),
        state=RolloutState(steps[-1].state),
        stage_count=steps[-1].stage_count,
        stages=tuple(stages),
        machines=tuple(machines),
        steps=tuple(
            RolloutStepView.model_validate(
                {name: getattr(step, name) for name in RolloutStepView.model_fields}
            )
            for step in steps
        ),
        reason=row.reason,
        throws_count=row.throws_count,
        deadline_s=row.deadline_s,
        false_alarm_ratio=FALSE_ALARM_RATIO,
        created_by=row.created_by,
        created_utc=row.created_utc,
    )


def _machine_view(found: StandingThrows, stage_count: int, name_of: Name) -> RolloutMachineView:
    standing, throws = found.standing, found.throws
    before = found.before_sha256
    return RolloutMachineView(
        machine_id=standing.machine_id,
        stage_count=stage_count,
        state=_state(standing),
        sentence=standing.worse or standing.problem,
        failed_count=0 if throws is None else sum(throw is None for throw in throws.since),
        before_policy_id=None if before is None else name_of(before),
        before=None if throws is None else figures(throws.before),
        since=None if throws is None else figures(throws.since),
    )


def _state(standing: MachineStanding) -> StageTest:
    if standing.asked_utc is None or standing.finding is None:
        return "waiting"
    if standing.finding.verdict == "worse":
        return "worse"
    if standing.problem:
        return "error"
    if not standing.is_aboard:
        return "asked"
    return standing.finding.verdict
