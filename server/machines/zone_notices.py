"""Sends machines their approved exclusion zones: after an approval, and whenever they report another set."""

import logging
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Final

from machine.messages import ZONES_VERSION, MachineState, ThrowState, ZonesRequest
from machine.site.zones import ZoneSet
from server.accounts.audit_chain import SERVER
from server.clock import new_id
from server.errors import ApiError
from server.machines.machine_commands import MachineCommands
from server.machines.machine_registry import KnownMachine, MachineRegistry

logger = logging.getLogger(__name__)

RETRY_S: Final = 2.0
"""A machine that refuses, as during a throw, is asked again no sooner."""
TAKING: Final = frozenset(
    {ThrowState.DISARMED, ThrowState.ARMED, ThrowState.STOPPED, ThrowState.FAULT}
)
"""States in which a machine takes zones."""


class ZoneNotices:
    """Sends sets in the background; a machine never has two of them on their way."""

    def __init__(
        self,
        active: Callable[[str], ZoneSet],
        registry: MachineRegistry,
        commands: MachineCommands,
    ) -> None:
        """Begin to listen.

        Args:
            active: the approved set of a machine.
            registry: tells states as they come.
            commands: sends.
        """
        self._active = active
        self._registry = registry
        self._commands = commands
        self._lock = threading.Lock()
        self._busy: set[str] = set()
        self._tried_s: dict[str, float] = {}
        self._senders = ThreadPoolExecutor(4, "zone-notice")
        registry.on_state.append(self._take_state)

    def close(self) -> None:
        """Wait for what is under way."""
        self._senders.shutdown(wait=True, cancel_futures=True)

    def changed(self, machine_id: str) -> None:
        """Another set may have been approved: try at once."""
        with self._lock:
            self._tried_s.pop(machine_id, None)
        known = self._registry.get(machine_id)
        if known.is_connected and known.state is not None:
            self._take_state(known, known.state)

    def _take_state(self, known: KnownMachine, state: MachineState) -> None:
        machine_id = known.machine_id
        if state.protocol_version < ZONES_VERSION or state.state not in TAKING:
            return
        if state.zones_sha256 == self._active(machine_id).sha256:
            return
        with self._lock:
            now_s = time.monotonic()
            is_early = now_s - self._tried_s.get(machine_id, -RETRY_S) < RETRY_S
            if machine_id in self._busy or is_early:
                return
            self._busy.add(machine_id)
            self._tried_s[machine_id] = now_s
        try:
            self._senders.submit(self._send, machine_id)
        except RuntimeError:
            return  # closing

    def _send(self, machine_id: str) -> None:
        request = ZonesRequest(
            command_id=new_id(),
            machine_id=machine_id,
            issuer=SERVER.name,
            zone_set=self._active(machine_id),
        )
        try:
            self._commands.send(request, SERVER)
        except ApiError as error:
            # The machine refuses plans of zones that it does not have; it is asked again.
            logger.warning("%s did not take its exclusion zones: %s", machine_id, error)
        finally:
            with self._lock:
                self._busy.discard(machine_id)
