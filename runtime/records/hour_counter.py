"""Hours of operation, counted on board and kept over restarts, as ISO/TS 15143-3 reports them."""

import json
import logging
import os
from pathlib import Path
from typing import Final

from machine.messages import MachineState, ThrowState

logger = logging.getLogger(__name__)

WRITE_PERIOD_S: Final = 60.0
"""As much is lost at a power cut."""
MAX_STEP_S: Final = 1.0
"""A longer pause between two states, and a clock that steps back, count as nothing."""
MOVING: Final = frozenset(
    {ThrowState.ALIGNING, ThrowState.THROWING, ThrowState.COMMITTED, ThrowState.SETTLING}
)


class HourCounter:
    """Counts while states of the control process come in; of one thread."""

    def __init__(self, path: Path) -> None:
        """Args: path: of the file with the counts; one that cannot be read is begun anew."""
        self._path = path
        self._operating_s = self._idle_s = 0.0
        self._written_s = 0.0
        self._seen_ns: int | None = None
        try:
            kept = json.loads(path.read_text(encoding="utf-8"))
            self._operating_s, self._idle_s = float(kept["operating_s"]), float(kept["idle_s"])
            self._written_s = self._operating_s
        except FileNotFoundError:
            pass
        except (OSError, ValueError, KeyError, TypeError) as error:
            logger.warning("the hours in %s cannot be read and begin anew: %r", path, error)

    def take(self, state: MachineState) -> dict[str, float]:
        """Count up to a state of the control process; returns the fields of the state message."""
        seen_ns, self._seen_ns = self._seen_ns, state.t_mono_ns
        step_s = 0.0 if seen_ns is None else (state.t_mono_ns - seen_ns) * 1e-9
        if 0.0 < step_s <= MAX_STEP_S:
            self._operating_s += step_s
            if state.state not in MOVING:
                self._idle_s += step_s
        counts = {"operating_s": round(self._operating_s, 1), "idle_s": round(self._idle_s, 1)}
        if self._operating_s - self._written_s >= WRITE_PERIOD_S:
            self._write(counts)
        return counts

    def _write(self, counts: dict[str, float]) -> None:
        # Also after a failure: a full disk is not asked with every state.
        self._written_s = self._operating_s
        beside = self._path.with_suffix(".new")
        try:
            beside.write_text(json.dumps(counts), encoding="utf-8")
            os.replace(beside, self._path)
        except OSError as error:
            logger.warning("the hours cannot be kept in %s: %s", self._path, error)
