"""What the server knows about its machines: accounts in the database, the last state in memory.

A machine that was ever seen stays in the list; a lost one is shown with when it was last seen.
"""

import hashlib
import secrets
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from pydantic import JsonValue
from sqlalchemy import select, update

from machine.messages import JointStream, MachineState
from server.accounts.audit_chain import Actor, AuditChain, Entry
from server.clock import utc_now
from server.errors import ConflictError, NotFoundError
from server.machines.machine_clock import MachineClock
from server.secret_files import write_secret
from server.store.database import Database
from server.store.models import Lease, Machine

FRESH_S = 1.0
"""A state older than this is not the present (targets: loss seen within 1 s)."""
SECRETS_FOLDER = "machines"
_RATE_SMOOTHING_RATIO = 0.1
_REBOOT_NS = 1_000_000_000
"""A state older than the newest one by more is of another boot."""
_SEEN_PERIOD_S = 10.0
"""How often `last_seen_utc` is written while a machine is there."""


@dataclass(slots=True)
class KnownMachine:
    """One machine in memory."""

    machine_id: str
    site: str
    name: str
    is_listed: bool
    tags: tuple[str, ...] = ()
    has_token: bool = False
    state: MachineState | None = None
    received_s: float = -1e9
    """Server's monotonic time of the last state."""
    last_seen_utc: datetime | None = None
    written_s: float = -1e9
    round_trip_s: float | None = None
    state_rate_hz: float | None = None
    is_marked_lost: bool = True
    retired_utc: datetime | None = None
    """Since when it is out of service: nothing of it is taken, nothing is sent to it."""
    clock: MachineClock | None = None
    """The machine's own time, which commands and heartbeats carry so that it can tell a stale one."""

    @property
    def age_s(self) -> float:
        """Since the last state."""
        return time.monotonic() - self.received_s

    @property
    def is_connected(self) -> bool:
        """Its liveliness token stands and its state is fresh."""
        return self.has_token and self.state is not None and self.age_s <= FRESH_S


StateListener = Callable[[KnownMachine, MachineState], None]
LinkListener = Callable[[str], None]


class MachineRegistry:
    """All machines of the site; thread-safe."""

    def __init__(self, database: Database, audit: AuditChain, site: str, data_dir: Path) -> None:
        self._database = database
        self._audit = audit
        self._site = site
        self._folder = data_dir / SECRETS_FOLDER
        self._lock = threading.RLock()
        self._known: dict[str, KnownMachine] = {}
        self._tokens: dict[str, str] = {}
        self.on_state: list[StateListener] = []
        self.on_joints: list[Callable[[JointStream], None]] = []
        self.on_found: list[LinkListener] = []
        self.on_lost: list[LinkListener] = []
        self.on_account_change: list[LinkListener] = []
        """Called when the router knows an account too few, or one too many."""
        self._load()

    def _load(self) -> None:
        with self._database.read() as session:
            for row in session.scalars(select(Machine).order_by(Machine.machine_id)):
                self._tokens[row.machine_id] = row.token_sha256
                self._known[row.machine_id] = KnownMachine(
                    row.machine_id,
                    row.site,
                    row.name,
                    row.is_listed,
                    tuple(row.tags),
                    last_seen_utc=row.last_seen_utc,
                    retired_utc=row.retired_utc,
                )

    # Accounts -------------------------------------------------------------------------------------

    def provision(self, count: int) -> None:
        """Make machine accounts m001.. up to this number; each gets a secret file of its own."""
        for index in range(1, count + 1):
            machine_id = f"m{index:03d}"
            if machine_id not in self._known:
                self._create(machine_id)
            elif self._is_secret_missing(machine_id):
                self._renew_secret(machine_id)

    def enrol(self, machine_id: str | None, name: str, actor: Actor) -> str:
        """List a machine; returns its id.

        Args:
            machine_id: its id; None = the next free one. One without an account gets one, and the router is
                opened anew at the next moment at which no machine is armed or throws.
            name: how people call it.
            actor: who adds it.

        Raises:
            ConflictError: the machine of this id is retired, or in service.
        """
        with self._lock:
            if machine_id is None:
                machine_id = self._free_id()
            is_new = machine_id not in self._known
            if is_new:
                self._create(machine_id)
            known = self._known[machine_id]
            if known.retired_utc is not None:
                raise ConflictError(
                    "retired",
                    f"{machine_id} is retired; its id stays with its history. Choose another.",
                )
            if known.last_seen_utc is not None:
                raise ConflictError(
                    "machine_exists",
                    f"{machine_id} is in service. Its page makes a new token for another computer.",
                )
            # Nobody else is given it meanwhile.
            known.is_listed = True
        with self._database.write() as session:
            session.execute(
                update(Machine)
                .where(Machine.machine_id == machine_id)
                .values(is_listed=True, name=name)
            )
            self._audit.append(
                session,
                Entry(actor, "machine.enrol", "fact", machine_id=machine_id, detail={"name": name}),
            )
        with self._lock:
            known.name = name
        if is_new:
            for listener in self.on_account_change:
                listener(machine_id)
        return machine_id

    def _free_id(self) -> str:
        """The first account that nobody uses; else the number after them."""
        for machine_id in sorted(self._known):
            known = self._known[machine_id]
            if not known.is_listed and known.retired_utc is None:
                return machine_id
        index = 1
        while f"m{index:03d}" in self._known:
            index += 1
        return f"m{index:03d}"

    def retire(self, machine_id: str, reason: str, actor: Actor) -> None:
        """Take a machine out of service for good; its history stays. Its password is void at once.

        Raises:
            NotFoundError: there is none of this id.
            ConflictError: it is connected, or retired already.
        """
        known = self.get(machine_id)
        if known.is_connected:
            raise ConflictError(
                "machine_connected",
                f"{machine_id} is connected. Switch it off, so that it is seen who retires what, and "
                "retire it then.",
            )
        if known.retired_utc is not None:
            raise ConflictError("retired", f"{machine_id} is retired already.")
        now = utc_now()
        with self._database.write() as session:
            session.execute(
                update(Machine)
                .where(Machine.machine_id == machine_id)
                .values(retired_utc=now, is_listed=False, token_sha256="", stop_requested_utc=None)
            )
            entry = Entry(
                actor, "machine.retire", "fact", machine_id=machine_id, detail={"reason": reason}
            )
            self._audit.append(session, entry)
        with self._lock:
            known.retired_utc, known.is_listed, known.has_token = now, False, False
            self._tokens[machine_id] = ""
        self.secret_path(machine_id).unlink(missing_ok=True)
        for listener in self.on_account_change:
            listener(machine_id)

    def password(self, machine_id: str) -> str:
        """Password of a machine, to hand it over to it."""
        return self.secret_path(machine_id).read_text(encoding="utf-8").strip()

    def edit(
        self,
        machine_id: str,
        actor: Actor,
        *,
        name: str | None = None,
        tags: tuple[str, ...] | None = None,
    ) -> None:
        """Change how people call and sort a machine; None leaves it.

        Raises:
            NotFoundError: there is none of this id.
        """
        known = self.get(machine_id)
        new_name = known.name if name is None else name.strip()
        new_tags = known.tags if tags is None else tuple(dict.fromkeys(tags))
        with self._database.write() as session:
            session.execute(
                update(Machine)
                .where(Machine.machine_id == machine_id)
                .values(name=new_name, tags=list(new_tags))
            )
            detail: dict[str, JsonValue] = {"name": new_name, "tags": list(new_tags)}
            entry = Entry(actor, "machine.edit", "fact", machine_id=machine_id, detail=detail)
            self._audit.append(session, entry)
        with self._lock:
            known.name, known.tags = new_name, new_tags

    def secret_path(self, machine_id: str) -> Path:
        """File with the password of a machine, for `downrange machine --password-file`."""
        return self._folder / f"{machine_id}.password"

    def passwords(self) -> dict[str, str]:
        """Passwords of all machines, for the link's router."""
        return {
            known.machine_id: self.password(known.machine_id)
            for known in self.all()
            if known.retired_utc is None and self.secret_path(known.machine_id).exists()
        }

    def is_token_of(self, machine_id: str, token: str) -> bool:
        """Whether a bearer token is this machine's password."""
        expected = self._tokens.get(machine_id, "")
        return secrets.compare_digest(hashlib.sha256(token.encode()).hexdigest(), expected)

    def _create(self, machine_id: str) -> None:
        password = secrets.token_urlsafe(24)
        write_secret(self.secret_path(machine_id), password + "\n")
        digest = hashlib.sha256(password.encode()).hexdigest()
        with self._database.write() as session:
            session.add(
                Machine(
                    machine_id=machine_id,
                    site=self._site,
                    name="",
                    token_sha256=digest,
                    is_listed=False,
                    enrolled_utc=utc_now(),
                    last_seen_utc=None,
                    stop_requested_utc=None,
                )
            )
            session.flush()
            session.add(Lease(machine_id=machine_id, epoch_count=0))
        with self._lock:
            self._tokens[machine_id] = digest
            self._known[machine_id] = KnownMachine(machine_id, self._site, "", is_listed=False)

    def _is_secret_missing(self, machine_id: str) -> bool:
        is_retired = self._known[machine_id].retired_utc is not None
        return not is_retired and not self.secret_path(machine_id).exists()

    def _renew_secret(self, machine_id: str) -> None:
        password = secrets.token_urlsafe(24)
        write_secret(self.secret_path(machine_id), password + "\n")
        digest = hashlib.sha256(password.encode()).hexdigest()
        with self._database.write() as session:
            session.execute(
                update(Machine).where(Machine.machine_id == machine_id).values(token_sha256=digest)
            )
        self._tokens[machine_id] = digest

    # From the link --------------------------------------------------------------------------------

    def set_token(self, machine_id: str, is_alive: bool) -> None:
        """The liveliness token of a machine came or went."""
        with self._lock:
            known = self._known.get(machine_id)
            if known is None or known.retired_utc is not None:
                return
            known.has_token = is_alive
        if not is_alive:
            self._mark_lost(known)

    def take_state(self, state: MachineState) -> None:
        """A machine's state arrived."""
        with self._lock:
            known = self._known.get(state.machine_id)
            if known is None or known.retired_utc is not None:
                return
            now_s = time.monotonic()
            gap_s = now_s - known.received_s
            if 0.0 < gap_s < FRESH_S:
                rate_hz = 1.0 / gap_s
                old_hz = known.state_rate_hz or rate_hz
                known.state_rate_hz = old_hz + _RATE_SMOOTHING_RATIO * (rate_hz - old_hz)
            known.state, known.received_s = state, now_s
            received_ns = time.monotonic_ns()
            if known.clock is None or state.t_mono_ns < known.clock.seen_ns - _REBOOT_NS:
                known.clock = MachineClock.first(state.t_mono_ns, received_ns)
            else:
                known.clock.take(state.t_mono_ns, received_ns)
            known.last_seen_utc = utc_now()
            is_found = known.is_marked_lost and known.has_token
            if is_found:
                known.is_marked_lost = False
            is_write_due = is_found or now_s - known.written_s > _SEEN_PERIOD_S
            if is_write_due:
                known.written_s, known.is_listed = now_s, True
        if is_write_due:
            self._write_seen(known)
        if is_found:
            for listener in self.on_found:
                listener(state.machine_id)
        for state_listener in self.on_state:
            state_listener(known, state)

    def take_joints(self, joints: JointStream) -> None:
        """Joint positions for the 3D view arrived."""
        with self._lock:
            known = self._known.get(joints.machine_id)
            if known is None:
                return
            # A state of another boot resets the clock; joints only move it on.
            if known.clock is not None:
                known.clock.take(joints.t_mono_ns, time.monotonic_ns())
        for listener in self.on_joints:
            listener(joints)

    def note_round_trip(self, machine_id: str, seconds: float) -> None:
        """A command was answered after this time."""
        with self._lock:
            known = self._known.get(machine_id)
            if known is not None:
                known.round_trip_s = seconds

    def sweep(self) -> None:
        """Mark machines whose state went stale; call a few times a second."""
        for known in self.all():
            if not known.is_marked_lost and not known.is_connected:
                self._mark_lost(known)

    def _mark_lost(self, known: KnownMachine) -> None:
        with self._lock:
            if known.is_marked_lost:
                return
            known.is_marked_lost = True
            known.state_rate_hz = None
        self._write_seen(known)
        for listener in self.on_lost:
            listener(known.machine_id)

    def _write_seen(self, known: KnownMachine) -> None:
        with self._database.write() as session:
            session.execute(
                update(Machine)
                .where(Machine.machine_id == known.machine_id)
                .values(last_seen_utc=known.last_seen_utc, is_listed=known.retired_utc is None)
            )

    # Queries --------------------------------------------------------------------------------------

    def all(self) -> list[KnownMachine]:
        """Every machine, spare accounts included."""
        with self._lock:
            return list(self._known.values())

    def listed(self) -> list[KnownMachine]:
        """Machines that people see: those in service."""
        return [known for known in self.all() if known.is_listed]

    def retired(self) -> list[KnownMachine]:
        """Machines out of service, the newest of them first."""
        found = [(known.retired_utc, known) for known in self.all()]
        dated = [(moment, known) for moment, known in found if moment is not None]
        return [known for _, known in sorted(dated, key=lambda pair: pair[0], reverse=True)]

    def get(self, machine_id: str) -> KnownMachine:
        """One machine.

        Raises:
            NotFoundError: there is none of this name.
        """
        with self._lock:
            known = self._known.get(machine_id)
        if known is None:
            raise NotFoundError(
                "no_machine", f"There is no machine '{machine_id[:40]}' at site '{self._site}'."
            )
        return known

    def seen_t_mono_ns(self, machine_id: str) -> int | None:
        """Newest time of the machine's own clock that has been seen."""
        with self._lock:
            known = self._known.get(machine_id)
            return None if known is None or known.clock is None else known.clock.seen_ns

    def machine_t_mono_ns(self, machine_id: str) -> int | None:
        """Present time of the machine's own clock, as far as its messages show it."""
        with self._lock:
            known = self._known.get(machine_id)
            if known is None or known.clock is None:
                return None
            return known.clock.now_ns(time.monotonic_ns())

    def is_connected(self, machine_id: str) -> bool:
        """Whether a command can be sent now."""
        with self._lock:
            known = self._known.get(machine_id)
        return known is not None and known.is_connected
