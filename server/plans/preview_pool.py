"""Previews in warm processes beside the server: first numbers at once, the ellipse as it grows.

The nominal throw and the parts of the scattered throws of one preview run side by side.

Processes are spawned, never forked: the server holds Zenoh's threads. When a process
dies its previews fail; the next preview starts new processes.
"""

import itertools
import logging
import multiprocessing
import threading
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from pathlib import Path
from typing import Any

from machine.spec import load_spec
from server.plans.preview_worker import PreviewJob, run_nominal, run_scattered, start_worker
from server.plans.split_preview import SplitPreview, Update
from sim_twin.throws.preview import ScatteredThrows, ThrowPreview, scatter_parts
from sim_twin.throws.zone_check import ZoneCheck

logger = logging.getLogger(__name__)

SLOT_COUNT = 256


class PreviewPool:
    """Worker processes and the thread that listens to them."""

    def __init__(self, worker_count: int, warm_up: tuple[Path, ...]) -> None:
        self._context = multiprocessing.get_context("spawn")
        self._worker_count = worker_count
        self._warm_up = warm_up
        self._updates: Any = self._context.SimpleQueue()
        self._cancelled: Any = self._context.Array("b", SLOT_COUNT, lock=False)
        self._slots = itertools.count(1)
        self._lock = threading.Lock()
        self._splits: dict[str, SplitPreview] = {}
        self._slot_of: dict[str, int] = {}
        self._radius_m = load_spec().ball.radius_m
        self._pool: ProcessPoolExecutor | None = None
        self._thread = threading.Thread(target=self._listen, name="previews", daemon=True)

    def start(self) -> None:
        """Start the processes; they warm up on their own."""
        self._pool = self._new_pool()
        # An executor starts processes only as jobs come in: ask for all of them now.
        for _ in range(self._worker_count):
            self._pool.submit(int)
        self._thread.start()

    def close(self) -> None:
        """End the processes, whatever they are working on."""
        with self._lock:
            pool, self._pool = self._pool, None
            for slot in range(SLOT_COUNT):
                self._cancelled[slot] = 1
        if pool is not None:
            processes = list((getattr(pool, "_processes", None) or {}).values())
            pool.shutdown(wait=False, cancel_futures=True)
            for process in processes:
                process.join(timeout=2.0)
                if process.is_alive():
                    process.terminate()
                    process.join(timeout=2.0)
        if self._thread.is_alive():
            self._updates.put(None)
            self._thread.join(timeout=2.0)
        self._updates.close()

    @property
    def is_running(self) -> bool:
        """Whether previews can be asked for."""
        return self._pool is not None

    def submit(self, job: PreviewJob, on_update: Update) -> "Future[ThrowPreview]":
        """Start a preview; `on_update` is called from a thread of ours with what is known so far.

        The nominal throw is first in the queue of the processes, its scattered throws come after it.
        """
        with self._lock:
            if self._pool is None:
                raise RuntimeError("previews are closed")
            slot = next(self._slots) % (SLOT_COUNT - 1) + 1
            self._cancelled[slot] = 0
            placed = replace(job, slot=slot)
            zones = ZoneCheck(job.zones, self._radius_m)
            split = SplitPreview(job.target, zones, on_update, lambda: self._raise_flag(slot))
            self._slot_of[job.job_id] = slot
            self._splits[job.job_id] = split
            try:
                futures = self._start_parts(self._pool, placed)
            except BrokenProcessPool:
                logger.exception("a preview process died; new ones are started")
                self._pool.shutdown(wait=False)
                self._pool = self._new_pool()
                futures = self._start_parts(self._pool, placed)
        split.result.add_done_callback(lambda _: self._forget(job.job_id))
        split.follow(*futures)
        return split.result

    def _start_parts(
        self, pool: ProcessPoolExecutor, job: PreviewJob
    ) -> "tuple[Future[ThrowPreview], list[Future[ScatteredThrows]]]":
        parts = scatter_parts(job.rollout_count, self._worker_count)
        nominal = pool.submit(run_nominal, job)
        if job.rollout_count == 0:
            return nominal, []
        return nominal, [pool.submit(run_scattered, job, part) for part in parts]

    def _raise_flag(self, slot: int) -> None:
        self._cancelled[slot] = 1

    def cancel(self, job_id: str) -> None:
        """End a preview that nobody waits for any more, at its next step."""
        with self._lock:
            slot = self._slot_of.get(job_id)
            if slot is not None:
                self._raise_flag(slot)

    def _new_pool(self) -> ProcessPoolExecutor:
        return ProcessPoolExecutor(
            self._worker_count,
            mp_context=self._context,
            initializer=start_worker,
            initargs=(self._updates, self._cancelled, self._warm_up),
        )

    def _forget(self, job_id: str) -> None:
        with self._lock:
            self._slot_of.pop(job_id, None)
            self._splits.pop(job_id, None)

    def _listen(self) -> None:
        while (update := self._updates.get()) is not None:
            job_id, so_far = update
            with self._lock:
                split = self._splits.get(job_id)
            if split is not None:
                split.show(so_far)
