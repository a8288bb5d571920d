"""Loads an offered policy beside the control loop, and hands it over while no plan is armed.

Loading takes far longer than a tick. It runs on a thread of its own, without the loop's priority, and only
begins while the machine rests.
"""

import contextlib
import os
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from machine.conventions import Mode
from machine.errors import PolicyError
from machine.messages import ThrowState
from runtime.control.policy import PolicyRunner
from runtime.policies.puller import PolicyOffer

SWITCHING: Final = frozenset({ThrowState.DISARMED, ThrowState.STOPPED, ThrowState.FAULT})
"""States without an armed plan."""


@dataclass(frozen=True, slots=True)
class LoadedPolicy:
    """What became of an offer."""

    offer: PolicyOffer
    runner: PolicyRunner | None
    refusal: str = ""
    """Why it cannot be used."""


class PolicySwitch:
    """At most one offer a mode: a newer one replaces it."""

    def __init__(self, load: Callable[[Mode, str | None], PolicyRunner]) -> None:
        self._load = load
        self._waiting: dict[Mode, PolicyOffer] = {}
        self._loading: PolicyOffer | None = None
        self._thread: threading.Thread | None = None
        self._loaded: LoadedPolicy | None = None

    def take(self, offer: PolicyOffer) -> None:
        """Take an offer; the same again changes nothing."""
        if offer != self._loading:
            self._waiting[offer.mode] = offer

    def next(self, state: ThrowState) -> LoadedPolicy | None:
        """What can be switched to now; call it once a tick.

        Args:
            state: of the machine.
        """
        if state not in SWITCHING:
            return None
        if self._thread is None:
            self._begin()
            return None
        if self._thread.is_alive():
            return None
        loaded, self._loaded, self._loading, self._thread = self._loaded, None, None, None
        is_old = loaded is not None and loaded.offer.mode in self._waiting
        return None if is_old else loaded

    def _begin(self) -> None:
        if not self._waiting:
            return
        offer = self._loading = self._waiting.pop(next(iter(self._waiting)))
        self._thread = threading.Thread(
            target=self._run, args=(offer,), name="load-policy", daemon=True
        )
        self._thread.start()

    def _run(self, offer: PolicyOffer) -> None:
        if offer.refusal:
            self._loaded = LoadedPolicy(offer, None, offer.refusal)
            return
        # Where the loop has no priority, there is none to give up.
        with contextlib.suppress(OSError, AttributeError):
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        try:
            self._loaded = LoadedPolicy(offer, self._load(offer.mode, offer.policy_sha256))
        except (PolicyError, OSError) as error:
            self._loaded = LoadedPolicy(offer, None, str(error))
