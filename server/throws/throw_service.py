"""Arm and fire: lease, plan, nonce; every throw has a name before the machine hears of it.

The nonce of an armed machine stays here and is used once. A fire whose answer is lost is not repeated.
"""

import threading
import time
from dataclasses import dataclass

from sqlalchemy.orm import Session as DatabaseSession

from machine.messages import ArmRequest, FireRequest, RejectReason, ThrowPlan
from server.accounts.accounts import Session
from server.aim.aim_corrections import AimCorrections
from server.clock import new_id
from server.errors import ApiError, UnavailableError, UnknownOutcomeError, from_reason
from server.machines.lease_service import LeaseService
from server.machines.machine_commands import MachineCommands
from server.machines.machine_registry import MachineRegistry
from server.plans.plan_store import PlanStore
from server.plans.site_store import SiteStore
from server.plans.zone_store import ZoneStore
from server.schemas.history import Outcome
from server.schemas.plans import ArmView, FireView
from server.store.database import Database
from server.throws.hold_relay import HoldRelay
from server.throws.throw_store import ThrowStore


@dataclass(frozen=True, slots=True)
class ArmedPlan:
    """What a machine is armed for."""

    plan: ThrowPlan
    epoch_count: int
    nonce: str
    session_id: str
    until_s: float
    """Server's monotonic time; the machine's own clock decides, this only spares a useless fire."""


class ThrowService:
    """The way from a plan to a throw."""

    def __init__(
        self,
        database: Database,
        registry: MachineRegistry,
        leases: LeaseService,
        plans: PlanStore,
        sites: SiteStore,
        zones: ZoneStore,
        throws: ThrowStore,
        commands: MachineCommands,
        holds: HoldRelay,
        aim: AimCorrections,
    ) -> None:
        self._database = database
        self._registry = registry
        self._leases = leases
        self._plans = plans
        self._sites = sites
        self._zones = zones
        self._throws = throws
        self._commands = commands
        self._holds = holds
        self._aim = aim
        self._lock = threading.Lock()
        self._armed: dict[str, ArmedPlan] = {}
        leases.on_new_epoch.append(lambda machine_id, _: self.forget(machine_id))

    def arm(self, plan_id: str, shown_hash: str | None, session: Session) -> ArmView:
        """Arm the plan's machine.

        Raises:
            ApiError: no lease, unusable plan, blocked, lost or refusing machine.
        """
        machine_id = self._plans.row(plan_id).machine_id
        lease = self._leases.require(machine_id, session)
        self._throws.require_known(machine_id)
        state = self._registry.get(machine_id).state
        if state is None or not self._registry.is_connected(machine_id):
            raise from_reason(RejectReason.MACHINE_LOST, self._commands.lost_text(machine_id))
        plan = self._plans.freeze(plan_id, shown_hash, state)
        self._sites.require_unchanged(machine_id, plan.target, plan.site)
        self._zones.require_approved(machine_id, plan.zones_sha256)
        self._aim.require_current(plan)
        self.forget(machine_id)
        request = ArmRequest(
            command_id=new_id(),
            machine_id=machine_id,
            issuer=session.username,
            epoch_count=lease.epoch_count,
            plan=plan,
        )
        reply = self._commands.send(
            request,
            session.actor,
            with_intent=lambda database: self._plans.store_frozen(database, plan),
        )
        if reply.nonce is None:
            raise UnknownOutcomeError(
                RejectReason.UNKNOWN_OUTCOME.value,
                f"{machine_id} accepted but gave no permission to fire. Disarm and arm again.",
            )
        valid_s = reply.nonce_valid_s or 0.0
        armed = ArmedPlan(
            plan, lease.epoch_count, reply.nonce, session.session_id, time.monotonic() + valid_s
        )
        with self._lock:
            self._armed[machine_id] = armed
        return ArmView(
            plan_id=plan_id,
            machine_id=machine_id,
            plan_hash=plan.plan_hash,
            epoch_count=lease.epoch_count,
            valid_s=valid_s,
        )

    def forget(self, machine_id: str) -> None:
        """A machine is not armed any more."""
        with self._lock:
            self._armed.pop(machine_id, None)

    def fire(self, plan_id: str, session: Session) -> FireView:
        """Fire the armed plan, once.

        Raises:
            ApiError: no lease, not armed for this plan, lost or refusing machine.
        """
        machine_id = self._plans.row(plan_id).machine_id
        self._leases.require(machine_id, session)
        self._throws.require_known(machine_id)
        armed = self._use_armed(machine_id, plan_id, session)
        throw_id = new_id()
        request = FireRequest(
            command_id=new_id(),
            machine_id=machine_id,
            issuer=session.username,
            throw_id=throw_id,
            epoch_count=armed.epoch_count,
            nonce=armed.nonce,
            plan_hash=armed.plan.plan_hash,
            seen_t_mono_ns=self._registry.seen_t_mono_ns(machine_id),
        )
        row = self._throws.new_row(throw_id, armed.plan, session, armed.epoch_count)
        self._holds.begin(machine_id, throw_id, session.session_id, armed.epoch_count)

        def accepted(database: DatabaseSession) -> None:
            self._plans.note_fired(database, plan_id)
            self._throws.note_accepted(database, throw_id)

        try:
            reply = self._commands.send(
                request,
                session.actor,
                throw_id=throw_id,
                with_intent=lambda database: database.add(row),
                with_acceptance=accepted,
            )
        except UnknownOutcomeError as error:
            with self._database.write() as database:
                self._plans.note_fired(database, plan_id)
            self._throws.mark_unknown(machine_id, throw_id)
            return FireView(
                throw_id=throw_id, machine_id=machine_id, state="unknown", detail=error.message
            )
        except UnavailableError as error:
            self._throws.end(throw_id, Outcome.NOT_EXECUTED, error.message)
            raise
        except ApiError as error:
            self._throws.end(throw_id, Outcome.REFUSED, error.message)
            raise
        self._throws.publish(throw_id)
        return FireView(
            throw_id=throw_id, machine_id=machine_id, state="accepted", detail=reply.detail
        )

    def _use_armed(self, machine_id: str, plan_id: str, session: Session) -> ArmedPlan:
        with self._lock:
            armed = self._armed.get(machine_id)
            is_usable = (
                armed is not None
                and armed.plan.plan_id == plan_id
                and armed.session_id == session.session_id
                and armed.until_s > time.monotonic()
            )
            if is_usable:
                # Used up, whatever becomes of it: a second press finds nothing to fire.
                del self._armed[machine_id]
        if armed is None or not is_usable:
            raise from_reason(
                RejectReason.NOT_ARMED,
                f"{machine_id} is no longer armed for this plan: let go, then press and hold again.",
            )
        return armed
