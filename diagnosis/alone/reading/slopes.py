"""How noisy a measured position is, and the shortest slope window that makes speeds of it."""

import math
from typing import Final

import numpy as np
from scipy.signal import savgol_coeffs

from machine.conventions import Array

NOISE_RATIO: Final = 0.03
"""Of the top speed: what the window that turns positions into speeds leaves of the sensor's noise."""
LONGEST_WINDOW_S: Final = 0.4


def sample_noise(values: Array) -> float:
    """Noise of one sample: third differences cancel smooth motion; their sd is sqrt(20) times it."""
    third = np.diff(values, n=3)
    noise = 1.4826 * float(np.median(np.abs(third - np.median(third)))) / math.sqrt(20.0)
    steps = np.abs(np.diff(values))
    moved = steps[steps > 0.0]
    if moved.size == 0 or moved.size > 0.8 * steps.size:
        return noise
    # A coarse encoder stands still most of the time: its noise is that of rounding.
    return max(noise, float(np.min(moved)) / math.sqrt(12.0))


def speed_window(
    output: Array, noise: float, step_s: float, period_s: float
) -> tuple[Array, float]:
    """The shortest slope window that brings a speed's noise below 3 % of the top speed.

    The slope of a straight line through n samples over w seconds has variance 12 s^2 / (n w^2).
    """
    coarse = max(3, round(0.3 / step_s) | 1)
    rough = np.convolve(output, savgol_coeffs(coarse, 1, deriv=1, delta=step_s), "valid")
    top = float(np.quantile(np.abs(rough), 0.98)) or 1e-9
    seconds = max(3.0 * period_s, 0.04)
    for seconds in np.geomspace(
        max(3.0 * period_s, 0.04), max(LONGEST_WINDOW_S, 4.0 * period_s), 12
    ):
        left = noise * math.sqrt(12.0 * period_s / seconds) / seconds
        if left < NOISE_RATIO * top:
            break
    size = max(3, round(seconds / step_s) | 1)
    left = noise * math.sqrt(12.0 * period_s / seconds) / seconds
    return savgol_coeffs(size, 1, deriv=1, delta=step_s), float(left)
