"""One preview whose nominal throw and scattered throws are computed side by side in several processes."""

import logging
import threading
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from time import perf_counter
from typing import Any

from machine.messages import Target
from sim_twin.throws.preview import ScatteredThrows, ThrowPreview, completed, with_scatter
from sim_twin.throws.zone_check import ZoneCheck

logger = logging.getLogger(__name__)

Update = Callable[[ThrowPreview], None]


class SplitPreview:
    """Puts the parts of one preview together as they come; thread-safe."""

    def __init__(
        self, target: Target, zones: ZoneCheck, on_update: Update, cancel: Callable[[], None]
    ) -> None:
        """Begin.

        Args:
            target: of the preview.
            zones: of the preview.
            on_update: called with all that is known whenever there is more, up to the end.
            cancel: ends the parts that nobody waits for any more.
        """
        self._target, self._zones = target, zones
        self._on_update, self._cancel = on_update, cancel
        self._started_s = perf_counter()
        self._lock = threading.RLock()
        self._shown: ThrowPreview | None = None
        self._is_nominal_done = False
        self._parts: list[ScatteredThrows | None] = []
        self.result: Future[ThrowPreview] = Future()
        self.result.set_running_or_notify_cancel()

    def follow(
        self,
        nominal: "Future[ThrowPreview]",
        parts: "list[Future[ScatteredThrows]]",
    ) -> None:
        """Take the results of a nominal throw and of all parts."""
        self._parts = [None] * len(parts)
        nominal.add_done_callback(lambda done: self._take(done, self._take_nominal))
        for index, future in enumerate(parts):
            future.add_done_callback(
                lambda done, index=index: self._take(done, self._take_part, index)
            )

    def show(self, so_far: ThrowPreview) -> None:
        """The nominal throw so far, on its way."""
        with self._lock:
            if not self._is_nominal_done:
                self._shown = so_far
                self._tell()

    def fail(self, error: BaseException) -> None:
        """End the preview with an error, unless it has ended."""
        with self._lock:
            if self.result.done():
                return
            self._cancel()
            self.result.set_exception(error)

    def _take(self, done: "Future[Any]", take: Callable[..., None], *where: int) -> None:
        try:
            found = done.result()
        except Exception as error:  # also that the part was cancelled
            self.fail(error)
            return
        with self._lock:
            if not self.result.done():
                take(found, *where)

    def _take_nominal(self, shown: ThrowPreview) -> None:
        before = self._shown
        self._shown, self._is_nominal_done = shown, True
        if shown.is_final:
            self._cancel()
            self.result.set_result(shown)
            return
        # Progress comes by another channel, mostly but not always earlier.
        is_news = before is None or before.duration_s != shown.duration_s
        if not self._finish() and is_news:
            self._tell()

    def _take_part(self, part: ScatteredThrows, index: int) -> None:
        self._parts[index] = part
        if not self._finish():
            self._tell()

    def _finish(self) -> bool:
        """End the preview if nothing is missing."""
        done = [part for part in self._parts if part is not None]
        if self._shown is None or not self._is_nominal_done or len(done) < len(self._parts):
            return False
        wall_s = perf_counter() - self._started_s
        self.result.set_result(completed(self._shown, done, self._target, self._zones, wall_s))
        return True

    def _tell(self) -> None:
        if self._shown is None:
            return
        so_far = self._shown
        done = [part for part in self._parts if part is not None]
        if done:
            so_far = replace(with_scatter(so_far, done), wall_s=perf_counter() - self._started_s)
        try:
            self._on_update(so_far)
        except Exception:
            logger.exception("what is known of a preview could not be passed on")
