"""Brings versions onto the machine: asks the server what it wants, fetches it, offers it to control.

The slots follow the control process: they name a version only after it has been loaded and switched to.
A rollback at the machine itself needs no server.
"""

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from machine.conventions import Mode
from machine.errors import PolicyError
from machine.messages import EventKind
from runtime.link.ipc import Kind
from runtime.policies.download import (
    TransferError,
    WantedPolicy,
    fetch_version,
    fetch_wanted,
    has_version,
)
from runtime.policies.slots import PolicySlots
from runtime.records.log_upload import UploadTarget

logger = logging.getLogger(__name__)

LOOK_PERIOD_S: Final = 0.1
"""A rollback that is asked for at the machine is seen within this time."""
POLL_PERIOD_S: Final = 2.0
POLL_PERIOD_MAX_S: Final = 30.0
OFFER_PERIOD_S: Final = 5.0
"""An offer that the control process has not answered is repeated; it waits there while a plan is armed."""
ROLLBACK_FILE: Final = "rollback-request.json"


class PolicyOffer(BaseModel):
    """A version on the disk that the control process is to switch to."""

    model_config = ConfigDict(frozen=True)
    mode: Mode
    policy_sha256: str | None
    """Empty: the installed version. None: approvals have changed, take what a start would take."""
    deployment_count: int | None = Field(default=None, ge=1)
    """None: a rollback asked for at the machine."""
    is_rollback: bool = False
    refusal: str = ""
    """Why it is not switched to, for the server; empty = it is."""


class RollbackRequest(BaseModel):
    """What `downrange rollback` leaves for a running machine; it stays until the machine has answered."""

    model_config = ConfigDict(frozen=True)
    mode: Mode
    policy_sha256: str
    """The version to go back to; empty: the installed one."""


@dataclass(slots=True)
class _Offered:
    offer: PolicyOffer
    sent_s: float


class PolicyPuller:
    """Two threads of the link process: a rollback at the machine does not wait for a transfer."""

    def __init__(
        self,
        folder: Path,
        target: UploadTarget | None,
        send: Callable[[Kind, dict[str, Any]], bool],
        site_key: str | None = None,
    ) -> None:
        """Begin.

        Args:
            folder: of the machine's slots.
            target: the server; None = rollbacks at the machine only.
            send: sends a packet to the control process; whether it went.
            site_key: which key may bind the machine to its site (`PolicySlots.keep_trust`).
        """
        self._slots = PolicySlots(folder)
        self._target = target
        self._request_file = folder / ROLLBACK_FILE
        self._send = send
        self._site_key = site_key
        self._offered: dict[Mode, _Offered] = {}
        self._lock = threading.Lock()
        self._wait_s = POLL_PERIOD_S
        self._polled_s = -1e9
        self._said = ""
        self._recheck: set[Mode] = set()
        self._is_closing = threading.Event()
        self._threads = (
            threading.Thread(target=self._repeat, args=(self._poll_if_due,), name="policies"),
            threading.Thread(target=self._repeat, args=(self._look_for_rollback,), name="rollback"),
        )

    def start(self) -> None:
        """Begin to look."""
        for thread in self._threads:
            thread.daemon = True
            thread.start()

    def close(self, timeout_s: float = 2.0) -> None:
        """Stop; a transfer goes on at the next start where it was."""
        self._is_closing.set()
        for thread in self._threads:
            if thread.is_alive():
                thread.join(timeout_s)

    def rolled_back_from(self) -> dict[str, str]:
        """For the server, which may not know of it: a machine that is off can be rolled back too."""
        return self._slots.rolled_back_from()

    def take_event(self, kind: EventKind, data: dict[str, Any]) -> None:
        """What the control process did with an offer; on any thread, once the event is stored."""
        if kind not in (EventKind.POLICY_SWITCHED, EventKind.POLICY_REFUSED):
            return
        mode, count = Mode(data["mode"]), data.get("deployment_count")
        try:
            if kind is EventKind.POLICY_SWITCHED:
                if data["slot"] is not None:
                    is_rollback = bool(data["is_rollback"])
                    self._slots.switch(mode, str(data["slot"]), count, is_rollback=is_rollback)
                logger.info("%s throws with policy %s", mode.value, data["policy_sha256"][:12])
            elif count is not None:
                self._slots.note(mode, int(count))
            elif not data["is_removed"]:
                self._request_file.unlink(missing_ok=True)
        except OSError as error:
            # The version is in use until the next start, which begins with what the slots say.
            logger.error("the slots cannot be written: %s", error)
        with self._lock:
            self._offered.pop(mode, None)

    def _repeat(self, look: Callable[[], None]) -> None:
        while not self._is_closing.wait(LOOK_PERIOD_S):
            try:
                look()
            except OSError as error:
                logger.error("policies: %s", error)

    def _poll_if_due(self) -> None:
        if time.monotonic() - self._polled_s >= self._wait_s:
            self.poll()

    def _look_for_rollback(self) -> None:
        if not self._request_file.exists():
            return
        try:
            request = RollbackRequest.model_validate_json(self._request_file.read_bytes())
        except ValidationError as error:
            logger.warning("a rollback cannot be done: %s", error)
            self._request_file.unlink(missing_ok=True)
            return
        if self._slots.of(request.mode).current == request.policy_sha256:
            self._request_file.unlink(missing_ok=True)
            return
        offer = PolicyOffer(
            mode=request.mode, policy_sha256=request.policy_sha256, is_rollback=True
        )
        with self._lock:
            waiting = self._offered.get(offer.mode)
        if (
            waiting is None
            or waiting.offer != offer
            or time.monotonic() - waiting.sent_s >= OFFER_PERIOD_S
        ):
            self._offer(offer)

    def poll(self) -> None:
        """Ask the server once, and do what it wants."""
        self._polled_s = time.monotonic()
        if self._target is None:
            return
        try:
            # Before the answer: one on a slow link must not make a deployment look newer than a rollback.
            sent_s = time.time()
            found = fetch_wanted(self._target, self._slots.trust())
            if found.trust is not None and self._slots.keep_trust(found.trust, self._site_key):
                trust = found.trust
                logger.info(
                    "policies must be approved by site %s, key %s", trust.site, trust.signed_by
                )
                self._recheck = set(Mode)
            self._check_again()
            is_fetched = [
                self._follow(self._target, wanted, sent_s - wanted.age_s)
                for wanted in found.policies
            ]
            self._wait_s, self._said = 0.0 if any(is_fetched) else POLL_PERIOD_S, ""
        except (TransferError, PolicyError) as error:
            self._wait_s = min(max(self._wait_s * 2.0, POLL_PERIOD_S), POLL_PERIOD_MAX_S)
            if str(error) != self._said:
                self._said = str(error)
                logger.info("%s", error)

    def _check_again(self) -> None:
        for mode in list(self._recheck):
            offer = PolicyOffer(mode=mode, policy_sha256=None)
            if self._send(Kind.POLICY, offer.model_dump(mode="json")):
                self._recheck.discard(mode)

    def _follow(self, target: UploadTarget, wanted: WantedPolicy, asked_s: float) -> bool:
        """Fetch a version, or offer one that is here; whether it was fetched.

        Args:
            target: the server.
            wanted: by the server.
            asked_s: Unix time at which it was asked for.
        """
        is_known = wanted.deployment_count <= self._slots.of(wanted.mode).deployment_count
        # A rollback at the machine comes first: it decides about what was asked for before.
        if is_known or self._request_file.exists():
            return False
        with self._lock:
            waiting = self._offered.get(wanted.mode)
        is_waiting = (
            waiting is not None
            and (waiting.offer.deployment_count or wanted.deployment_count)
            >= wanted.deployment_count
            and time.monotonic() - waiting.sent_s < OFFER_PERIOD_S
        )
        if is_waiting:
            return False
        refusal = self._rollback_refusal(wanted, asked_s)
        if not refusal and not has_version(wanted, self._slots):
            fetch_version(target, wanted, self._slots)
            # It may have been taken back during the transfer: offered only if it is still wanted then.
            return True
        self._offer(
            PolicyOffer(
                mode=wanted.mode,
                policy_sha256=wanted.policy_sha256,
                deployment_count=wanted.deployment_count,
                is_rollback=wanted.is_rollback,
                refusal=refusal,
            )
        )
        self._slots.remove_unused(frozenset({wanted.policy_sha256}))
        return False

    def _rollback_refusal(self, wanted: WantedPolicy, asked_s: float) -> str:
        """Why a deployment that was asked for before a rollback at the machine is not carried out."""
        slots = self._slots.of(wanted.mode)
        rolled_back_s = slots.rolled_back_s
        if (
            rolled_back_s is None
            or asked_s > rolled_back_s
            or slots.current == wanted.policy_sha256
        ):
            return ""
        at = datetime.fromtimestamp(rolled_back_s, UTC)
        return (
            f"{wanted.mode.value} was rolled back at the machine at {at:%Y-%m-%d %H:%M:%S} UTC, after this "
            "was asked for; deploy again if it is still meant"
        )

    def _offer(self, offer: PolicyOffer) -> bool:
        # Noted before it is sent: the answer may come on another thread at once.
        with self._lock:
            self._offered[offer.mode] = _Offered(offer, time.monotonic())
        return self._send(Kind.POLICY, offer.model_dump(mode="json"))
