"""Opens the router anew when an account was added or retired, at a moment that disturbs no throw.

Zenoh reads passwords and access rules once, when its session opens. Machines reconnect by themselves.
"""

import logging
import threading
from collections.abc import Callable, Mapping
from typing import Final

import zenoh

from machine.messages import ThrowState
from server.machines.machine_link import MachineLink
from server.machines.machine_registry import MachineRegistry

logger = logging.getLogger(__name__)

LOOK_S: Final = 0.2
ACCOUNTS_LOOK_S: Final = 2.0
"""Between two looks for accounts of further routers, which another process writes."""
QUIET_STATES: Final = frozenset({ThrowState.DISARMED, ThrowState.STOPPED, ThrowState.FAULT})


class RouterRenewal:
    """One thread that waits for the moment."""

    def __init__(
        self,
        link: MachineLink,
        registry: MachineRegistry,
        make_config: Callable[[], zenoh.Config],
        read_routers: Callable[[], Mapping[str, str]],
    ) -> None:
        self._link = link
        self._registry = registry
        self._make_config = make_config
        self._read_routers = read_routers
        self._routers = read_routers()
        """Accounts of further routers that the open router knows."""
        self._asked = threading.Event()
        self._is_closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="router-renewal", daemon=True)

    def start(self) -> None:
        """Begin to listen for changed accounts."""
        self._registry.on_account_change.append(lambda _: self._asked.set())
        self._thread.start()

    def close(self) -> None:
        """Stop."""
        self._is_closing.set()
        self._asked.set()
        self._thread.join(timeout=5.0)

    def is_quiet(self) -> bool:
        """Whether no connected machine is armed or throws."""
        return all(
            known.state is None or known.state.state in QUIET_STATES
            for known in self._registry.all()
            if known.is_connected
        )

    def _wait_for_change(self) -> None:
        while not self._asked.wait(ACCOUNTS_LOOK_S):
            try:
                routers = self._read_routers()
            except OSError:
                logger.exception("accounts of further routers could not be read; tried again")
                continue
            if routers != self._routers:
                self._routers = routers
                return

    def _run(self) -> None:
        while not self._is_closing.is_set():
            self._wait_for_change()
            while not self._is_closing.wait(LOOK_S):
                try:
                    self._asked.clear()
                    if self.is_quiet() and self._link.renew(self._make_config()):
                        break
                except Exception:
                    logger.exception("the router could not be opened anew; tried again")
                self._asked.set()
