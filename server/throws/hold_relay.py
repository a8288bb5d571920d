"""The operator's hold: each message of the browser is forwarded as one heartbeat, or not at all.

Nothing is repeated, stored or delayed: without messages from the browser the machine gets none. A hold
counts only for the throw, session and lease epoch for which fire was pressed, and from the machine's time
that the browser had when it sent it: what waits in a network or a browser grows old.
"""

import threading
import time
from dataclasses import dataclass

from machine.messages import OperatorHeartbeat
from server.machines.machine_link import MachineLink
from server.machines.machine_registry import MachineRegistry
from server.metrics import ServiceMetrics

GRANT_S = 120.0
"""No throw lasts longer; a grant that was left open ends here."""


@dataclass(slots=True)
class Grant:
    """Whose hold counts for a machine."""

    throw_id: str
    session_id: str
    epoch_count: int
    until_s: float
    sequence_count: int = 0


class HoldRelay:
    """Forwards holds as heartbeats."""

    def __init__(
        self, link: MachineLink, registry: MachineRegistry, metrics: ServiceMetrics
    ) -> None:
        self._link = link
        self._registry = registry
        self._metrics = metrics
        self._lock = threading.Lock()
        self._grants: dict[str, Grant] = {}

    def begin(self, machine_id: str, throw_id: str, session_id: str, epoch_count: int) -> None:
        """From now on this session's hold counts for this throw."""
        with self._lock:
            self._grants[machine_id] = Grant(
                throw_id, session_id, epoch_count, time.monotonic() + GRANT_S
            )

    def revoke(self, machine_id: str) -> None:
        """No hold counts any more: the lease changed hands."""
        with self._lock:
            self._grants.pop(machine_id, None)

    def end(self, throw_id: str) -> None:
        """A throw is over."""
        with self._lock:
            for machine_id, grant in list(self._grants.items()):
                if grant.throw_id == throw_id:
                    del self._grants[machine_id]

    def let_go(self, machine_id: str, session_id: str) -> None:
        """Send a release at once when the browser disconnects."""
        with self._lock:
            grant = self._grants.get(machine_id)
            if grant is None or grant.session_id != session_id or not grant.sequence_count:
                return
            throw_id = grant.throw_id
        self.relay(machine_id, throw_id, session_id, is_holding=False, echo_ns=None)

    def let_go_all(self, session_id: str) -> None:
        """A session ended."""
        with self._lock:
            held = [m for m, grant in self._grants.items() if grant.session_id == session_id]
        for machine_id in held:
            self.let_go(machine_id, session_id)

    def machine_t_mono_ns(self, machine_id: str) -> int | None:
        """Present time of the machine's clock as the server knows it, ns; None = it has not been heard."""
        return self._registry.machine_t_mono_ns(machine_id)

    def relay(
        self,
        machine_id: str,
        throw_id: str,
        session_id: str,
        *,
        is_holding: bool,
        echo_ns: int | None,
    ) -> str:
        """Pass one message on; returns why it does not count, empty when it was passed on.

        Args:
            machine_id: the machine.
            throw_id: the throw that was fired.
            session_id: whose message it is.
            is_holding: False = the operator let go, which has no age.
            echo_ns: the machine's time that the browser had, ns; a hold needs it.
        """
        now_ns = self.machine_t_mono_ns(machine_id)
        seen_ns = now_ns
        with self._lock:
            grant = self._grants.get(machine_id)
            refusal = _refusal(grant, throw_id, session_id)
            if not refusal and is_holding:
                if echo_ns is None or now_ns is None:
                    refusal = "the machine's time is not known yet"
                else:
                    seen_ns = min(echo_ns, now_ns)
            if grant is None or refusal:
                self._metrics.heartbeats_count.labels(result="refused").inc()
                return refusal
            grant.sequence_count += 1
            heartbeat = OperatorHeartbeat(
                machine_id=machine_id,
                throw_id=throw_id,
                epoch_count=grant.epoch_count,
                sequence_count=grant.sequence_count,
                is_holding=is_holding,
                seen_t_mono_ns=seen_ns,
            )
        self._link.put_heartbeat(heartbeat)
        self._metrics.heartbeats_count.labels(result="relayed").inc()
        return ""


def _refusal(grant: Grant | None, throw_id: str, session_id: str) -> str:
    if grant is None or grant.until_s < time.monotonic():
        return "no throw of yours is running, or control changed hands"
    if grant.session_id != session_id:
        return "another session fired this throw"
    if grant.throw_id != throw_id:
        return f"the running throw is {grant.throw_id}"
    return ""
