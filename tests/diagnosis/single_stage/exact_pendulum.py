"""A pendulum with exact dry friction: one half period after the other, by an adaptive solver."""

import numpy as np
from scipy.integrate import solve_ivp

from diagnosis.tables.free_swings import SwingRecord

STOPPED = (2.5, 0.142, 0.061, 0.5)
"""rad/s, 1/s, rad/s^2, rad: at rest after 14 s, 9 mrad from the middle."""


def exact_angles(
    omega: float, viscous: float, coulomb: float, start: float, t: np.ndarray
) -> np.ndarray:
    """Angles of a pendulum released at rest, one half swing after the other."""
    angle = np.full(len(t), np.nan)
    x, begin = start, 0.0
    while begin < t[-1]:
        if abs(omega**2 * np.sin(x)) <= coulomb:
            angle[t >= begin] = x
            return angle
        side = -np.sign(x)

        def slowed(s: float, y: np.ndarray, begin: float = begin, side: float = side) -> float:
            return float(y[1] * side) if s > begin + 1e-6 else 1.0

        def law(_: float, y: np.ndarray, side: float = side) -> list[float]:
            return [y[1], -(omega**2) * np.sin(y[0]) - viscous * y[1] - coulomb * side]

        slowed.terminal, slowed.direction = True, -1.0
        half = solve_ivp(
            law, (begin, t[-1]), [x, 0.0], events=slowed, rtol=1e-9, atol=1e-11, dense_output=True
        )
        during = (t >= begin) & (t <= half.t[-1])
        angle[during] = half.sol(t[during])[0]
        x, begin = float(half.y[0, -1]), float(half.t[-1])
    return angle


def stopped_swing(noise: float, rate_hz: float = 20.0) -> SwingRecord:
    """A swing that dry friction stops long before its record ends."""
    t = np.arange(0.0, 30.0, 1.0 / rate_hz)
    return SwingRecord(
        t, exact_angles(*STOPPED, t) + np.random.default_rng(3).normal(0.0, noise, len(t))
    )
