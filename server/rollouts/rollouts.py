"""Rollouts: started, paused, resumed, promoted and aborted by people, moved on by what machines tell.

Everything is in the database: a restart goes on, and an action that was cut off is looked at and done again.
The server only asks; a machine switches by itself while no plan is armed.
"""

import logging
import threading
from collections.abc import Callable, Iterator
from typing import Any, Final

from pydantic import JsonValue
from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession

from machine.conventions import Mode
from machine.messages import EventKind, MachineEvent
from server.accounts.accounts import Session
from server.accounts.audit_chain import SERVER, Actor, AuditChain, Entry
from server.alerts.alert_rules import Judgement, Subject
from server.clock import new_id, utc_now
from server.deployments.asker import Asker, DeploymentAsking
from server.deployments.machine_policies import policy_aboard, version_before
from server.errors import ApiError, ConflictError
from server.event_hub import EventHub
from server.machines.machine_registry import MachineRegistry
from server.plans.policy_store import PolicyStore
from server.rollouts.rollout_rules import Decision, Next, decide
from server.rollouts.rollout_store import (
    LISTED_COUNT,
    OPEN_STATES,
    add_step,
    newest_deployment,
    note_asked,
    open_ids,
    rollout_view,
    row_of,
    stages_of,
    standing_of,
    steps_of,
)
from server.rollouts.rollout_views import (
    ChannelsView,
    RolloutRequest,
    RolloutState,
    RolloutView,
    StagePlan,
    StageRequest,
)
from server.schemas.alerts import AlertRule
from server.schemas.events import RolloutUpdatedEvent
from server.store.database import Database
from server.store.models import Deployment
from server.store.rollout_tables import RolloutMachine, RolloutRow, RolloutStep
from server.validation.gate_settings import GateSettings

logger = logging.getLogger(__name__)

PERIOD_S: Final = 5.0
"""Between looks at deadlines; news of machines is looked at at once."""
CLOSE_S: Final = 5.0

RolloutListener = Callable[[DatabaseSession, dict[str, Any]], None]


class Rollouts:
    """All rollouts; thread-safe."""

    def __init__(
        self,
        database: Database,
        audit: AuditChain,
        registry: MachineRegistry,
        policies: PolicyStore,
        deployments: DeploymentAsking,
        hub: EventHub,
    ) -> None:
        self._database = database
        self._audit = audit
        self._registry = registry
        self._policies = policies
        self._deployments = deployments
        self._hub = hub
        self._gates = GateSettings(database, audit)
        self._lock = threading.RLock()
        self._news = threading.Event()
        self._is_alert_due = threading.Event()
        self._is_alert_due.set()
        self._is_closing = False
        self._thread: threading.Thread | None = None
        self.on_change: list[RolloutListener] = []
        """Called inside the transaction that stores a step."""

    def begin(self) -> None:
        """Go on with what is open."""
        self._thread = threading.Thread(target=self._run, name="rollouts", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop looking; the next start goes on."""
        self._is_closing = True
        self._news.set()
        if self._thread is not None:
            self._thread.join(CLOSE_S)

    def note(self, _machine_id: str) -> None:
        """A throw of a machine has news."""
        self._news.set()

    def take_event(self, event: MachineEvent) -> None:
        """An event that has been stored may say that another version is on board."""
        if event.kind in (EventKind.BOOTED, EventKind.POLICY_SWITCHED, EventKind.POLICY_REFUSED):
            self._news.set()

    def verdicts(self) -> Iterator[Judgement]:
        """The alert about paused rollouts, where a rollout has changed."""
        if not self._is_alert_due.is_set():
            return
        self._is_alert_due.clear()
        try:
            text = self._paused()
        except Exception:
            self._is_alert_due.set()
            raise
        yield Judgement(Subject(AlertRule.ROLLOUT, None), text or None)

    def _paused(self) -> str:
        """What is paused and why; empty where nothing is."""
        with self._database.read() as database:
            return " ".join(
                f"Rollout of {self._policies.name_of(row_of(database, one).policy_sha256)} is paused: "
                f"{step.sentence}"
                for one in open_ids(database)
                if (step := steps_of(database, one)[-1]).state == RolloutState.PAUSED.value
            )

    # People ---------------------------------------------------------------------------------------

    def start(self, mode: Mode, body: RolloutRequest, session: Session) -> RolloutView:
        """Begin to bring a version to machines.

        Raises:
            NotFoundError: no such machine, or no files of such a version.
            ConflictError: the version is not approved or for another mode, one is open in this mode, or a
                stage has no machine.
        """
        self._deployments.require_usable(mode, body.policy_sha256)
        stages = self._resolve(body.stages)
        row = RolloutRow(
            rollout_id=new_id(),
            mode=mode.value,
            policy_sha256=body.policy_sha256,
            stages=[stage.model_dump(mode="json") for stage in stages],
            deadline_s=body.deadline_s,
            throws_count=body.throws_count,
            reason=body.reason,
            created_by=session.username,
            created_utc=utc_now(),
        )
        with self._lock:
            with self._database.write() as database:
                if open_ids(database, mode):
                    raise ConflictError(
                        "rollout_open", f"A rollout in {mode.value} is open; abort it first."
                    )
                database.add(row)
                database.flush()
                self._add(database, row, RolloutState.RUNNING, 0, session.actor, body.reason)
            self._publish(row.rollout_id)
            self.advance(row.rollout_id)
        return self.view(row.rollout_id)

    def pause(self, rollout_id: str, reason: str, session: Session) -> RolloutView:
        """Ask no further machine; those that have switched throw on with the version.

        Raises:
            NotFoundError: no such rollout.
            ConflictError: it does not run.
        """
        return self._change(
            rollout_id, (RolloutState.RUNNING,), RolloutState.PAUSED, reason, session
        )

    def resume(self, rollout_id: str, reason: str, session: Session) -> RolloutView:
        """Go on; the deadlines count anew.

        Raises:
            NotFoundError: no such rollout.
            ConflictError: it is not paused.
        """
        return self._change(
            rollout_id, (RolloutState.PAUSED,), RolloutState.RUNNING, reason, session
        )

    def promote(self, rollout_id: str, reason: str, session: Session) -> RolloutView:
        """End the stage by a person's decision: the next one begins, or the rollout is completed.

        Raises:
            NotFoundError: no such rollout.
            ConflictError: it has ended.
        """
        with self._lock:
            with self._database.write() as database:
                row, step = self._open(database, rollout_id, OPEN_STATES)
                self._end_stage(database, row, step, session.actor, reason)
            self._publish(rollout_id)
            self.advance(rollout_id)
        return self.view(rollout_id)

    def abort(self, rollout_id: str, reason: str, session: Session) -> RolloutView:
        """End it; machines go back to the version before.

        Raises:
            NotFoundError: no such rollout.
            ConflictError: it has ended.
        """
        with self._lock:
            with self._database.read() as database:
                row, step = self._open(database, rollout_id, OPEN_STATES)
            notes = self._roll_back(row, Asker(session.actor, session.username, reason))
            with self._database.write() as database:
                sentence = " ".join([reason, *notes])
                self._add(
                    database, row, RolloutState.ABORTED, step.stage_count, session.actor, sentence
                )
            self._publish(rollout_id)
        return self.view(rollout_id)

    def view(self, rollout_id: str) -> RolloutView:
        """One rollout.

        Raises:
            NotFoundError: there is none.
        """
        with self._database.read() as database:
            row = row_of(database, rollout_id)
        gates = self._gates.view(Mode(row.mode)).gates
        with self._database.read() as database:
            return rollout_view(database, row, gates, self._policies.name_of)

    def newest(self) -> list[RolloutView]:
        """The newest twenty, newest first."""
        query = select(RolloutRow.rollout_id).order_by(RolloutRow.rollout_id.desc())
        with self._database.read() as database:
            found = database.scalars(query.limit(LISTED_COUNT)).all()
        return [self.view(rollout_id) for rollout_id in found]

    def channels(self) -> list[ChannelsView]:
        """Candidate and stable version of each mode."""
        found: list[ChannelsView] = []
        for mode in Mode:
            with self._database.read() as database:
                query = select(RolloutRow).where(RolloutRow.mode == mode.value)
                rows = database.scalars(query.order_by(RolloutRow.rollout_id.desc())).all()
                states = {
                    row.rollout_id: steps_of(database, row.rollout_id)[-1].state for row in rows
                }
            candidate = [r for r in rows if states[r.rollout_id] in OPEN_STATES]
            stable = [r for r in rows if states[r.rollout_id] == RolloutState.COMPLETED.value]
            found.append(
                ChannelsView(
                    mode=mode,
                    candidate_policy_id=self._name(candidate),
                    stable_policy_id=self._name(stable) or self._active_name(mode),
                )
            )
        return found

    def _name(self, rows: list[RolloutRow]) -> str | None:
        return self._policies.name_of(rows[0].policy_sha256) if rows else None

    def _active_name(self, mode: Mode) -> str | None:
        try:
            return self._policies.active(mode).card.policy_id
        except ApiError:
            return None

    # Work -----------------------------------------------------------------------------------------

    def advance(self, rollout_id: str) -> None:
        """Do what the rules say, until they say to wait."""
        with self._lock:
            while self._advance_once(rollout_id):
                pass

    def _run(self) -> None:
        while not self._is_closing:
            try:
                with self._database.read() as database:
                    found = open_ids(database)
                for rollout_id in found:
                    self.advance(rollout_id)
            except Exception:
                logger.exception("rollouts could not be looked at")
            self._news.wait(PERIOD_S)
            self._news.clear()

    def _advance_once(self, rollout_id: str) -> bool:
        """Do the next thing; whether there may be more to do."""
        with self._database.read() as database:
            row = row_of(database, rollout_id)
        gates = self._gates.view(Mode(row.mode)).gates
        with self._database.read() as database:
            steps = steps_of(database, rollout_id)
            step = steps[-1]
            if step.state not in OPEN_STATES:
                return False
            stages = stages_of(row)
            members = stages[step.stage_count].machine_ids
            name_of = self._policies.name_of
            found = [standing_of(database, row, one, gates, name_of).standing for one in members]
        decision = decide(
            found,
            now_utc=utc_now(),
            resumed_utc=max(s.at_utc for s in steps if s.state == RolloutState.RUNNING.value),
            deadline_s=row.deadline_s,
            is_last=step.stage_count + 1 == len(stages),
            is_paused=step.state == RolloutState.PAUSED.value,
        )
        if decision.next is Next.WAIT:
            return False
        if decision.next is Next.ASK:
            decision = self._ask(row, [one.machine_id for one in found if one.asked_utc is None])
        self._do(row, step, decision)
        self._publish(rollout_id)
        return True

    def _do(self, row: RolloutRow, step: RolloutStep, decision: Decision) -> None:
        sentence, stage = decision.sentence, step.stage_count
        if decision.next is Next.ROLL_BACK:
            notes = self._roll_back(row, Asker(SERVER, SERVER.name, f"rollout: {sentence}"))
            sentence = " ".join([sentence, "Its machines go back to the version before.", *notes])
        with self._database.write() as database:
            if decision.next is Next.ROLL_BACK:
                self._add(database, row, RolloutState.ROLLED_BACK, stage, SERVER, sentence)
            elif decision.next is Next.PAUSE:
                self._add(database, row, RolloutState.PAUSED, stage, SERVER, sentence)
            elif decision.next in (Next.NEXT_STAGE, Next.COMPLETE):
                count = row.throws_count
                words = f"Every machine of the stage passed {count} throws."
                self._end_stage(database, row, step, SERVER, words)

    def _ask(self, row: RolloutRow, machine_ids: list[str]) -> Decision:
        """Ask machines to switch; a pause where one cannot be asked."""
        mode = Mode(row.mode)
        asker = Asker(SERVER, row.created_by, f"rollout: {row.reason}")
        for machine_id in machine_ids:
            with self._database.read() as database:
                aboard = policy_aboard(database, machine_id, mode)
                before = version_before(database, machine_id, mode)
            if aboard == row.policy_sha256:
                with self._database.write() as database:
                    note_asked(database, row, machine_id, before, None)
                continue

            def note(
                database: DatabaseSession,
                deployment: Deployment,
                machine_id: str = machine_id,
                aboard: str | None = aboard,
            ) -> None:
                count = deployment.deployment_count
                note_asked(database, row, machine_id, aboard, count)

            try:
                self._deployments.ask(
                    machine_id, mode, row.policy_sha256, asker, is_rollback=False, on_add=note
                )
            except ApiError as error:
                return Decision(Next.PAUSE, f"{machine_id} cannot be asked: {error.message}")
        return Decision(Next.WAIT)

    def _roll_back(self, row: RolloutRow, asker: Asker) -> list[str]:
        """Ask every machine that was asked to go back; what could not be asked, in sentences."""
        mode, notes = Mode(row.mode), list[str]()
        with self._database.read() as database:
            query = select(RolloutMachine).where(RolloutMachine.rollout_id == row.rollout_id)
            rows = database.scalars(query.order_by(RolloutMachine.machine_id)).all()
            newest = {
                one.machine_id: newest_deployment(database, one.machine_id, row.mode)
                for one in rows
            }
            aboard = {one.machine_id: policy_aboard(database, one.machine_id, mode) for one in rows}
        for one in rows:
            last = newest[one.machine_id]
            wanted = aboard[one.machine_id] if last is None else last.policy_sha256
            if wanted != row.policy_sha256:
                continue  # asked for another version since
            if one.before_sha256 is None:
                notes.append(f"{one.machine_id} has no version before and keeps it.")
                continue
            try:
                self._deployments.ask(
                    one.machine_id,
                    mode,
                    one.before_sha256,
                    asker,
                    is_rollback=True,
                    on_add=lambda _database, _row: None,
                )
            except ApiError as error:
                notes.append(f"{one.machine_id} cannot go back: {error.message}")
        return notes

    # Parts ----------------------------------------------------------------------------------------

    def _resolve(self, requests: tuple[StageRequest, ...]) -> list[StagePlan]:
        """Machines of each stage; one that an earlier stage has is left out."""
        listed = sorted(self._registry.listed(), key=lambda known: known.machine_id)
        seen: set[str] = set()
        stages: list[StagePlan] = []
        for request in requests:
            for machine_id in request.machine_ids:
                self._registry.get(machine_id)
            tagged = [k.machine_id for k in listed if set(k.tags) & set(request.tags)]
            wanted = dict.fromkeys((*request.machine_ids, *tagged))
            members = tuple(one for one in wanted if one not in seen)
            name = ", ".join((*request.machine_ids, *(f"tag {tag}" for tag in request.tags)))
            if not members:
                raise ConflictError(
                    "empty_stage",
                    f"Stage {len(stages) + 1} ({name or 'nothing named'}) has no machine.",
                )
            seen |= set(members)
            stages.append(StagePlan(name=name, machine_ids=members))
        return stages

    def _change(
        self,
        rollout_id: str,
        from_states: tuple[RolloutState, ...],
        state: RolloutState,
        reason: str,
        session: Session,
    ) -> RolloutView:
        with self._lock:
            with self._database.write() as database:
                row, step = self._open(database, rollout_id, [one.value for one in from_states])
                self._add(database, row, state, step.stage_count, session.actor, reason)
            self._publish(rollout_id)
            self.advance(rollout_id)
        return self.view(rollout_id)

    @staticmethod
    def _open(
        database: DatabaseSession, rollout_id: str, states: tuple[str, ...] | list[str]
    ) -> tuple[RolloutRow, RolloutStep]:
        row = row_of(database, rollout_id)
        step = steps_of(database, rollout_id)[-1]
        if step.state not in states:
            shown = step.state.replace("_", " ")
            raise ConflictError(
                "rollout_state", f"The rollout is {shown}, not {' or '.join(states)}."
            )
        return row, step

    def _end_stage(
        self,
        database: DatabaseSession,
        row: RolloutRow,
        step: RolloutStep,
        actor: Actor,
        words: str,
    ) -> None:
        stage = step.stage_count + 1
        is_last = stage == len(row.stages)
        state = RolloutState.COMPLETED if is_last else RolloutState.RUNNING
        self._add(database, row, state, step.stage_count if is_last else stage, actor, words)

    def _add(
        self,
        database: DatabaseSession,
        row: RolloutRow,
        state: RolloutState,
        stage_count: int,
        actor: Actor,
        sentence: str,
    ) -> None:
        add_step(database, row.rollout_id, state, stage_count, actor.name, sentence)
        data: dict[str, JsonValue] = {
            "rollout_id": row.rollout_id,
            "mode": row.mode,
            "policy_sha256": row.policy_sha256,
            "state": state.value,
            "stage_count": stage_count,
            "actor": actor.name,
            "sentence": sentence,
        }
        self._audit.append(database, Entry(actor, f"rollout.{state.value}", "fact", detail=data))
        for listener in self.on_change:
            listener(database, dict(data))

    def _publish(self, rollout_id: str) -> None:
        self._is_alert_due.set()
        self._hub.publish(RolloutUpdatedEvent(rollout_id=rollout_id))
