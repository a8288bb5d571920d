"""Says for people how the outputs of two replays differ: channel, time, old, new, and a small waveform."""

import numpy as np

from machine.conventions import CONTROL_PERIOD_S, Array
from tests.runtime.replay.recording import Channels

TOLERANCE = 1e-4
"""Allowed change of a number, in the channel's own unit: the processors' last bits differ."""
WINDOW_TICKS = 60
"""Length of a waveform around the first change."""
LEVELS = "▁▂▃▄▅▆▇█"


def differences(old: Channels, new: Channels) -> list[str]:
    """One text for each column of a channel that changed; empty = nothing did."""
    texts = [
        f"{name}: {'missing now' if name in old else 'new'}" for name in sorted(set(old) ^ set(new))
    ]
    for name in sorted(set(old) & set(new)):
        if old[name].shape != new[name].shape:
            texts.append(f"{name}: shape {old[name].shape} -> {new[name].shape}")
            continue
        before, after = _columns(old[name]), _columns(new[name])
        for column in range(before.shape[1]):
            label = name if before.shape[1] == 1 else f"{name}[{column}]"
            text = _column_difference(label, before[:, column], after[:, column])
            texts += [text] if text else []
    return texts


def _columns(values: Array) -> Array:
    return values.astype(np.float64).reshape(len(values), -1)


def _column_difference(label: str, old: Array, new: Array) -> str:
    changed = ~np.isclose(old, new, rtol=0.0, atol=TOLERANCE, equal_nan=True)
    if not changed.any():
        return ""
    first = int(np.flatnonzero(changed)[0])
    start = max(first - WINDOW_TICKS // 4, 0)
    window = slice(start, start + WINDOW_TICKS)
    low, high = _range(old[window], new[window])
    largest = float(np.nanmax(np.abs(new - old)[changed])) if _has_size(old, new, changed) else None
    size = "" if largest is None else f", largest change {largest:.4g}"
    return (
        f"{label}: {int(changed.sum())} of {len(old)} ticks changed, first at "
        f"{first * CONTROL_PERIOD_S:.2f} s: {old[first]:.6g} -> {new[first]:.6g}{size}\n"
        f"    old {waveform(old[window], low, high)}\n"
        f"    new {waveform(new[window], low, high)}\n"
        f"        {start * CONTROL_PERIOD_S:.2f} s, {low:.4g} .. {high:.4g}"
    )


def _has_size(old: Array, new: Array, changed: Array) -> bool:
    return bool(np.isfinite((new - old)[changed]).any())


def _range(old: Array, new: Array) -> tuple[float, float]:
    both = np.concatenate([old, new])
    finite = both[np.isfinite(both)]
    return (float(finite.min()), float(finite.max())) if finite.size else (0.0, 0.0)


def waveform(values: Array, low: float, high: float) -> str:
    """Values as a line of bars between `low` and `high`; ``?`` where there is no number."""
    span = high - low or 1.0
    return "".join(
        LEVELS[round((value - low) / span * (len(LEVELS) - 1))] if np.isfinite(value) else "?"
        for value in values
    )
