"""Tells machines the lease epoch: after every change, and when a machine connects with an older one.

A machine that hears of a higher epoch disarms. So does every machine that was armed when the server went
down: at the start all leases are freed, which counts their epochs up.
"""

import logging
from concurrent.futures import ThreadPoolExecutor

from machine.messages import LeaseNotice
from server.accounts.audit_chain import SERVER
from server.clock import new_id
from server.errors import ApiError
from server.machines.lease_service import LeaseService
from server.machines.machine_commands import MachineCommands
from server.machines.machine_registry import MachineRegistry

logger = logging.getLogger(__name__)


class LeaseNotices:
    """Sends notices in the background."""

    def __init__(
        self, leases: LeaseService, registry: MachineRegistry, commands: MachineCommands
    ) -> None:
        self._leases = leases
        self._registry = registry
        self._commands = commands
        self._senders = ThreadPoolExecutor(8, "lease-notice")
        leases.on_new_epoch.append(self._changed)
        registry.on_found.append(self._found)

    def close(self) -> None:
        """Wait for notices under way."""
        self._senders.shutdown(wait=True, cancel_futures=True)

    def _changed(self, machine_id: str, epoch_count: int) -> None:
        # A machine that is away gets its notice when it connects.
        if self._registry.is_connected(machine_id):
            self._senders.submit(self._send, machine_id, epoch_count)

    def _found(self, machine_id: str) -> None:
        state = self._registry.get(machine_id).state
        epoch_count = self._leases.epoch(machine_id)
        if state is not None and state.epoch_count < epoch_count:
            self._senders.submit(self._send, machine_id, epoch_count)

    def _send(self, machine_id: str, epoch_count: int) -> None:
        notice = LeaseNotice(
            command_id=new_id(),
            machine_id=machine_id,
            issuer=SERVER.name,
            epoch_count=epoch_count,
        )
        try:
            self._commands.send(notice, SERVER)
        except ApiError as error:
            # The machine enforces epochs by itself: an arm or fire of an older one is refused there.
            logger.warning("%s did not receive epoch %d: %s", machine_id, epoch_count, error)
