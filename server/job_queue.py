"""Jobs that take minutes: queued, run one at a time by a thread, cancelled."""

import logging
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final, Generic, TypeVar

from server.errors import TooManyRequestsError

logger = logging.getLogger(__name__)

WAITING_COUNT: Final = 8
"""Jobs that may wait."""
CLOSE_S: Final = 10.0
"""A job that is cancelled by the end of the server ends within this time."""


@dataclass(slots=True, kw_only=True)
class Job:
    """A job that waits or is under way."""

    job_id: str
    cancelled: threading.Event = field(default_factory=threading.Event)
    progress_ratio: float = 0.0
    step: str = "waiting"

    def report(self, share: float, text: str) -> None:
        """Note how far it is."""
        self.progress_ratio, self.step = min(max(share, 0.0), 1.0), text[:120]


AJob = TypeVar("AJob", bound=Job)


class JobQueue(Generic[AJob]):
    """Jobs of one kind."""

    def __init__(
        self,
        name: str,
        full_code: str,
        run: Callable[[AJob], None],
        on_end: Callable[[AJob], object] = lambda _: None,
    ) -> None:
        """An empty queue.

        Args:
            name: of the jobs, for people.
            full_code: of the error when too many are waiting.
            run: blocks until a job has ended.
            on_end: called when a job is open no more.
        """
        self._name, self._full_code = name, full_code
        self._run, self._on_end = run, on_end
        self._change = threading.Condition()
        self._waiting: deque[str] = deque()
        self._open: dict[str, AJob] = {}
        self._is_closed = False
        self._thread = threading.Thread(target=self._work, name=name, daemon=True)

    def start(self) -> None:
        """Begin to work."""
        self._thread.start()

    def close(self) -> bool:
        """Wait for the end of the present job; whether the queue had been started."""
        with self._change:
            self._is_closed = True
            self._change.notify_all()
        was_started = self._thread.is_alive()
        if was_started:
            self._thread.join(timeout=CLOSE_S)
        return was_started

    def add(self, make: Callable[[], AJob], *, is_bounded: bool = True) -> AJob:
        """Queue the job that `make` gives. Nothing else is queued while it is made.

        Raises:
            TooManyRequestsError: too many are waiting.
        """
        with self._change:
            if is_bounded and len(self._waiting) >= WAITING_COUNT:
                raise TooManyRequestsError(
                    self._full_code,
                    f"{WAITING_COUNT} {self._name} are waiting. Cancel one or wait.",
                )
            job = make()
            self._open[job.job_id] = job
            self._waiting.append(job.job_id)
            self._change.notify_all()
        return job

    def open_jobs(self) -> list[AJob]:
        """Jobs that wait or are under way."""
        with self._change:
            return list(self._open.values())

    def find(self, job_id: str) -> AJob | None:
        """A job that waits or is under way."""
        with self._change:
            return self._open.get(job_id)

    def cancel(self, job: AJob) -> bool | None:
        """Cancel a job; whether it was still waiting, and is open no more; None if it had ended before."""
        with self._change:
            if job.cancelled.is_set() or job.job_id not in self._open:
                return None
            job.cancelled.set()
            is_waiting = job.job_id in self._waiting
            if is_waiting:
                self._waiting.remove(job.job_id)
                del self._open[job.job_id]
        return is_waiting

    def must_end(self, job: AJob) -> bool:
        """Whether a job is cancelled or the server ends."""
        return job.cancelled.is_set() or self._is_closed

    def _work(self) -> None:
        while True:
            with self._change:
                self._change.wait_for(lambda: self._is_closed or self._waiting)
                if self._is_closed:
                    return
                job = self._open[self._waiting.popleft()]
            try:
                self._run(job)
            except Exception:
                logger.exception("%s: %s could not be kept", self._name, job.job_id)
            finally:
                with self._change:
                    self._open.pop(job.job_id, None)
            if not self._is_closed:
                self._on_end(job)
