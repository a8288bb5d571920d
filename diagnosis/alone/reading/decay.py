"""Frictions of a free swing read off the decay of its amplitude: where a fit of the angles may start.

A fit does not find its way over the moment at which dry friction stops the body: the angle at which it rests
jumps there by up to twice f / w^2. Amplitudes know no such jump.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from scipy.optimize import nnls

from diagnosis.alone.reading.envelope import half_swings
from diagnosis.alone.reading.free_swings import Swing
from machine.conventions import Array

MIN_WINDOWS_COUNT: Final = 4
"""Fewer whole periods with an amplitude tell no frictions apart."""
VISCOUS: Final = "passive_viscous_friction.extra_viscous_per_s"
COULOMB: Final = "passive_coulomb_friction.extra_coulomb_rad_per_s2"
AIR: Final = "air_drag.quadratic_per_rad"


def frictions_of_decay(
    swings: Sequence[Swing], noise: float, frequency: float, names: Sequence[str]
) -> Mapping[str, float]:
    """The frictions among `names`, by parameter, from how the amplitudes of all swings fall; may be empty.

    Averaged over a period of small swings, A' = -c A / 2 - 2 f / (pi w) - 4 q w A^2 / (3 pi) (Krylov and
    Bogoliubov); integrated over time it is linear in c, f and q, none of which is negative.

    Args:
        swings: free, about their rest angle.
        noise: of one sample, rad (or m on a spring).
        frequency: w, rad/s.
        names: of the parameters of a structure.
    """
    asked = [name for name in (VISCOUS, COULOMB, AIR) if name in names]
    if not asked:
        return {}
    falls: list[Array] = []
    lost: list[Array] = []
    for swing in swings:
        time_s, size = amplitudes(swing, noise)
        if len(size) < MIN_WINDOWS_COUNT:
            continue
        columns = {
            VISCOUS: 0.5 * _since_first(time_s, size),
            COULOMB: 2.0 / (math.pi * frequency) * (time_s - time_s[0]),
            AIR: 4.0 * frequency / (3.0 * math.pi) * _since_first(time_s, size**2),
        }
        lost.append(np.stack([columns[name] for name in asked], axis=1))
        falls.append(size)
    if not falls:
        return {}
    # One more unknown a swing: its first amplitude.
    first = [np.zeros((len(size), len(falls))) for size in falls]
    for k, column in enumerate(first):
        column[:, k] = 1.0
    matrix = np.concatenate([np.hstack([f, -one]) for f, one in zip(first, lost, strict=True)])
    found, _ = nnls(matrix, np.concatenate(falls))
    return dict(zip(asked, found[len(falls) :].tolist(), strict=True))


def amplitudes(swing: Swing, noise: float) -> tuple[Array, Array]:
    """Middle of each whole period, s, and sqrt(2) times the scatter of the angle in it above the noise."""
    crossed = half_swings(swing.angle_rad, noise)
    pairs = list(zip(crossed[:-2], crossed[2:], strict=True))
    square = np.array([np.var(swing.angle_rad[i:j]) for i, j in pairs]) - noise**2
    time_s = np.array([0.5 * (swing.time_s[i] + swing.time_s[j]) for i, j in pairs])
    return time_s, np.sqrt(2.0 * np.maximum(square, 0.0))


def _since_first(time_s: Array, values: Array) -> Array:
    """Integral from the first time on, trapezoidal; (times,)."""
    steps = 0.5 * np.diff(time_s) * (values[1:] + values[:-1])
    return np.concatenate([[0.0], np.cumsum(steps)])
