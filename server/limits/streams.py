"""Places for long-lived streams (events, holds, 3D views): limits per person, per address and in total.

A caller above a limit is refused with the numbers; open streams stay open. STOP needs no stream.
"""

import logging
import math
import threading
import time
from collections import Counter
from dataclasses import dataclass
from enum import StrEnum
from types import TracebackType
from typing import Self

from starlette.requests import HTTPConnection

from server.errors import TooManyRequestsError
from server.metrics import ServiceMetrics

logger = logging.getLogger(__name__)

WARNING_PERIOD_S = 10.0
"""Shortest time between two log lines; the metric counts every refusal."""


class StreamKind(StrEnum):
    """Each kind is limited separately: many open pages do not prevent a hold."""

    EVENTS = "event streams"
    HOLD = "hold signals"
    VIEW = "3D views"


@dataclass(frozen=True, slots=True)
class StreamLimits:
    """Of each kind. A console takes one of the first and one 3D view, and a hold while the button is held."""

    per_person_count: int = 32
    per_address_count: int = 128
    """A proxy or a router in front may make one address of a whole office."""
    total_count: int = 512


class Place:
    """A taken place. Giving it back twice has no further effect."""

    def __init__(self, limiter: "StreamLimiter", keys: tuple[tuple[StreamKind, str], ...]) -> None:
        self._limiter = limiter
        self._keys = keys
        self._is_taken = True

    def give_back(self) -> None:
        """Free the place."""
        if self._is_taken:
            self._is_taken = False
            self._limiter.free(self._keys)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.give_back()


class StreamLimiter:
    """Hands out places; from any thread."""

    def __init__(self, metrics: ServiceMetrics, limits: StreamLimits | None = None) -> None:
        self.limits = limits or StreamLimits()
        self._metrics = metrics
        self._warned_s = -math.inf
        self._lock = threading.Lock()
        self._taken: Counter[tuple[StreamKind, str]] = Counter()

    def count(self, kind: StreamKind) -> int:
        """Streams of a kind that are open now."""
        with self._lock:
            return self._taken[kind, ""]

    def take(self, kind: StreamKind, username: str, connection: HTTPConnection) -> Place:
        """A place for one more stream; to be given back at its end.

        Raises:
            TooManyRequestsError: this person, this address or all together have too many.
        """
        address = connection.client.host if connection.client else "unknown"
        limits = (
            (f"person {username}", f"{username} has", self.limits.per_person_count),
            (f"address {address}", f"{address} has", self.limits.per_address_count),
            ("", "this server has", self.limits.total_count),
        )
        with self._lock:
            for key, who, allowed_count in limits:
                if self._taken[kind, key] >= allowed_count:
                    self._refuse(kind, who, allowed_count)
            keys = tuple((kind, key) for key, _, _ in limits)
            self._taken.update(keys)
        return Place(self, keys)

    def free(self, keys: tuple[tuple[StreamKind, str], ...]) -> None:
        """Called by a place."""
        with self._lock:
            self._taken.subtract(keys)
            for key in keys:
                if self._taken[key] <= 0:
                    del self._taken[key]

    def _refuse(self, kind: StreamKind, who: str, allowed_count: int) -> None:
        self._metrics.streams_refused_count.labels(kind=kind.name.lower()).inc()
        now_s = time.monotonic()
        if now_s - self._warned_s >= WARNING_PERIOD_S:
            self._warned_s = now_s
            logger.warning("refused: %s %d %s open already", who, allowed_count, kind)
        raise TooManyRequestsError(
            "too_many_streams",
            f"Refused: {who} {allowed_count} {kind} open, no more are allowed. Close pages of the "
            "console that are not needed.",
            {"kind": kind.name.lower(), "allowed_count": allowed_count},
        )
