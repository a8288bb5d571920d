"""The console's view of machines, and the events that keep browsers and 3D view up to date."""

import logging

from machine.messages import JointStream, MachineState
from server.clock import utc_now
from server.event_hub import EventHub
from server.machines.lease_service import LeaseService
from server.machines.machine_registry import KnownMachine, MachineRegistry
from server.machines.stop_service import StopService
from server.metrics import ServiceMetrics
from server.plans.policy_store import PolicyStore
from server.schemas.console import Lamp, LinkView, MachineView, TargetView
from server.schemas.events import MachineLostEvent, MachineRetiredEvent, MachineStateEvent
from server.throws.throw_store import ThrowStore
from server.viewer.scene import ViewerScene

logger = logging.getLogger(__name__)


class MachineViews:
    """Builds views and keeps browsers and 3D view up to date."""

    def __init__(
        self,
        registry: MachineRegistry,
        leases: LeaseService,
        policies: PolicyStore,
        throws: ThrowStore,
        stops: StopService,
        hub: EventHub,
        scene: ViewerScene,
        metrics: ServiceMetrics,
    ) -> None:
        self._registry = registry
        self._leases = leases
        self._policies = policies
        self._throws = throws
        self._stops = stops
        self._hub = hub
        self._scene = scene
        self._metrics = metrics
        registry.on_state.append(self._take_state)
        registry.on_joints.append(self._take_joints)
        registry.on_found.append(self._found)
        registry.on_lost.append(self._lost)

    def view(self, machine_id: str, target: TargetView | None = None) -> MachineView:
        """One machine.

        Raises:
            NotFoundError: there is none of this name.
        """
        return self._view(self._registry.get(machine_id), target)

    def _view(self, known: KnownMachine, target: TargetView | None = None) -> MachineView:
        lamp, text = lamp_of(known)
        return MachineView(
            machine_id=known.machine_id,
            site=known.site,
            name=known.name,
            lamp=lamp,
            lamp_text=text,
            link=LinkView(
                is_connected=known.is_connected,
                last_seen_utc=known.last_seen_utc,
                last_seen_age_s=_age_s(known),
                round_trip_s=known.round_trip_s,
                state_rate_hz=known.state_rate_hz,
            ),
            lease=self._leases.view(known.machine_id),
            state=known.state,
            reach=self._policies.reach({} if known.state is None else known.state.policy_sha256),
            target=target,
            unknown_throw_id=self._throws.unknown_of(known.machine_id),
            is_stop_pending=self._stops.is_pending(known.machine_id),
        )

    def publish(self, machine_id: str) -> None:
        """Send a machine's present view to all browsers now."""
        known = self._registry.get(machine_id)
        self._hub.publish_state(
            machine_id, lambda: MachineStateEvent(machine=self._view(known)), is_urgent=True
        )

    def publish_retired(self, machine_id: str) -> None:
        """Tell all browsers that a machine is out of service."""
        self._hub.publish(MachineRetiredEvent(machine_id=machine_id))

    def _take_state(self, known: KnownMachine, state: MachineState) -> None:
        self._metrics.outbox_count.labels(machine_id=known.machine_id).set(state.outbox_count)
        self._hub.publish_state(
            known.machine_id, lambda: MachineStateEvent(machine=self._view(known))
        )

    def _take_joints(self, joints: JointStream) -> None:
        self._scene.update_machine(
            joints.machine_id,
            joints.joint_position_rad_m,
            joints.ball_position_m,
            is_load_held=joints.payload_held,
        )

    def _found(self, machine_id: str) -> None:
        logger.info("%s is connected", machine_id)
        self.publish(machine_id)

    def _lost(self, machine_id: str) -> None:
        known = self._registry.get(machine_id)
        logger.warning("%s is lost", machine_id)
        self._scene.mark_lost(machine_id, _age_s(known) or 0.0)
        self._hub.publish(
            MachineLostEvent(
                machine_id=machine_id,
                last_seen_utc=known.last_seen_utc,
                detail=f"The link to {machine_id} is lost. What it shows is old.",
            )
        )
        self.publish(machine_id)


def lamp_of(known: KnownMachine) -> tuple[Lamp, str]:
    """The state lamp and its words."""
    if known.is_connected and known.state is not None:
        lamp = Lamp(known.state.state.value)
        fault = known.state.fault
        return lamp, f"fault: {fault}" if lamp is Lamp.FAULT and fault else lamp.value
    age_s = _age_s(known)
    if age_s is None:
        return Lamp.NEVER_SEEN, "never seen"
    return Lamp.LOST, f"lost since {duration_text(age_s)}"


def duration_text(seconds: float) -> str:
    """A duration in the largest unit that says enough."""
    if seconds < 120.0:
        return f"{seconds:.0f} s"
    if seconds < 7200.0:
        return f"{seconds / 60.0:.0f} min"
    if seconds < 172_800.0:
        return f"{seconds / 3600.0:.0f} h"
    return f"{seconds / 86_400.0:.0f} days"


def _age_s(known: KnownMachine) -> float | None:
    if known.last_seen_utc is None:
        return None
    return max((utc_now() - known.last_seen_utc).total_seconds(), 0.0)
