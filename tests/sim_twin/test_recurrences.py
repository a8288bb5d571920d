"""Compiled loops give what the plain definitions give."""

import math

import numpy as np

from sim_twin.recurrences import apply_play, lag_two_sided, limit_rate


def test_compiled_loops_are_their_definitions() -> None:
    rng = np.random.default_rng(5)
    for scale in (0.01, 1.0):
        signal = np.cumsum(rng.normal(0.0, scale, 300))[::-1]
        y = signal[0] - math.copysign(min(0.2, abs(signal[0])), signal[0])
        play = [y := min(max(y, x - 0.2), x + 0.2) for x in signal]
        np.testing.assert_array_equal(apply_play(signal, 0.2), play)
        y = signal[0]
        rate = [y := y + min(max(0.5 * (u - y), -0.03), 0.03) for u in signal]
        np.testing.assert_array_equal(limit_rate(signal, 0.03, 0.5), rate)
        y, rise, stop = signal[0], 1.0 - math.exp(-0.01 / 0.1), 1.0 - math.exp(-0.01 / 0.3)
        lag = [y := y + (rise if (u - y) * y >= 0.0 else stop) * (u - y) for u in signal]
        np.testing.assert_array_equal(lag_two_sided(signal, 0.01, 0.1, 0.3), lag)
