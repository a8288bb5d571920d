"""Least-squares fit of one joint's response to its record, and a bootstrap over blocks.

Each bootstrap draw is one Gauss-Newton step from the fit to all blocks. It is exact for a linear model and
costs the solution of an 8 x 8 system.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from diagnosis.identification.drive_record import DriveRecord
from diagnosis.identification.quantity import Quantity, unknown
from machine.conventions import CONTROL_PERIOD_S, Array, BoolArray, IntArray
from sim_twin.commissioning.response_fit import simulate_response

NAMES = ("dead_time_s", "lag_s", "damping_ratio", "gain_ratio", "natural_frequency_rad_per_s")
UNITS = ("s", "s", "1", "1", "rad/s")
LOW = np.array([0.0, 0.005, 0.1, 0.3])
HIGH = np.array([0.6, 2.0, 3.0, 2.0])
"""Bounds of dead time (s), lag (s), damping ratio and gain; above a damping of 3 the response is of
first order."""
SCALE = np.array([0.02, 0.05, 0.3, 0.1])
DRAW_COUNT = 400
WIDEST_DEAD_TIME_S = 0.1
WIDEST_RATIO = 1.0
"""An interval wider than `WIDEST_DEAD_TIME_S`, or than this share of its value, determines nothing."""


@dataclass(frozen=True, slots=True)
class Fitted:
    """Dead time, lag, damping ratio and gain of both directions."""

    x: Array
    """(2, 4)"""
    draws: Array
    """(draws, 2, 4)"""
    pinned: BoolArray
    """(2, 4) estimates at a bound of the search, which the data do not determine."""

    def as_profile(self) -> dict[str, float]:
        """The first direction in the parameters of a twin profile."""
        dead_time, lag, damping, gain = (float(v) for v in self.x[0])
        return {
            "dead_time_s": dead_time,
            "natural_frequency_rad_per_s": 2.0 * damping / lag,
            "damping_ratio": damping,
            "gain_ratio": gain,
        }


def simulate(record: DriveRecord, x: Array) -> Array:
    """Speed (T,) of the model with parameters (2, 4), one row per direction."""
    up, down = np.maximum(record.steady, 0.0), np.minimum(record.steady, 0.0)
    sides = [
        simulate_response(u[None], float(d), 2.0 * float(z) / float(lag), float(z), float(g))[0]
        for u, (d, lag, z, g) in zip((up, down), x, strict=True)
    ]
    return sides[0] + sides[1]


def fit(
    record: DriveRecord,
    moved: BoolArray,
    tied: bool,
    rng: np.random.Generator,
    start: Fitted | None = None,
) -> Fitted:
    """Fit the blocks in which the joint moves.

    Args:
        record: of one joint.
        moved: (blocks,) blocks to fit.
        tied: whether both directions share one response.
        rng: of the bootstrap.
        start: a simpler fit to start from.
    """
    keep = record.used & moved[np.maximum(record.block, 0)]
    both = 1 if tied else 2

    def residual(x: Array) -> Array:
        spread = np.tile(x, (2, 1)) if tied else x.reshape(2, 4)
        return (simulate(record, spread) - record.measured)[keep]

    low, high, scale = np.tile(LOW, both), np.tile(HIGH, both), np.tile(SCALE, both)
    if start is None:
        tries = [np.array([d, 0.1, 0.8, 1.0]) for d in np.arange(0.02, 0.26, 0.03)]
        x0 = min(tries, key=lambda x: float(np.sum(residual(x) ** 2)))
    else:
        x0 = start.x.ravel()
    solved = least_squares(
        residual,
        np.clip(x0, low + 1e-4, high - 1e-4),
        bounds=(low, high),
        x_scale=scale,
        max_nfev=30,
    )
    x = np.asarray(solved.x)
    pinned = (x < low + 0.01 * scale) | (x > high - 0.02 * (high - low))
    draws = np.clip(x + _moves(residual, x, scale, ~pinned, record.block[keep], rng), low, high)
    shape = (2, 4)
    if tied:
        return Fitted(np.tile(x, (2, 1)), np.stack([draws, draws], axis=1), np.tile(pinned, (2, 1)))
    return Fitted(x.reshape(shape), draws.reshape(-1, *shape), pinned.reshape(shape))


def _moves(
    residual: Callable[[Array], Array],
    x: Array,
    scale: Array,
    free: BoolArray,
    block: IntArray,
    rng: np.random.Generator,
) -> Array:
    """How far each draw's best parameters lie from those of all pieces, (draws, parameters)."""
    steps = np.diag(1e-3 * scale)[free]
    columns = [(residual(x + e) - residual(x - e)) / (2.0 * np.sum(e)) for e in steps]
    jacobian, left = np.stack(columns, axis=1), residual(x)
    numbers = np.unique(block)
    # Sums over each piece: a draw of pieces is then a sum of small matrices.
    parts = [(jacobian[block == number], left[block == number]) for number in numbers]
    normal = np.stack([J.T @ J for J, _ in parts])
    right = np.stack([J.T @ r for J, r in parts])
    n = numbers.size
    weight = rng.multinomial(n, np.full(n, 1.0 / n), size=DRAW_COUNT).astype(np.float64)
    A = np.einsum("dn,nij->dij", weight, normal) + 1e-9 * np.diag(1.0 / scale[free] ** 2)
    b = np.einsum("dn,ni->di", weight, right)
    moves = np.zeros((DRAW_COUNT, x.size))
    # A bootstrap of n pieces is narrower than the truth by this factor.
    moves[:, free] = -np.linalg.solve(A, b[..., None])[..., 0] * math.sqrt(n / max(n - 1, 1))
    return moves


def quantities(fitted: Fitted, direction: int, count: int) -> dict[str, Quantity]:
    """The quantities of one direction by name, with 90 % intervals."""
    x, draws, pinned = fitted.x[direction], fitted.draws[:, direction], fitted.pinned[direction]
    values = np.append(x, 2.0 * x[2] / x[1])
    all_draws = np.column_stack([draws, 2.0 * draws[:, 2] / draws[:, 1]])
    at_bound = np.append(pinned, pinned[1] or pinned[2])
    found: dict[str, Quantity] = {}
    for k, (name, unit) in enumerate(zip(NAMES, UNITS, strict=True)):
        low, high = (float(v) for v in np.quantile(all_draws[:, k], [0.05, 0.95]))
        value = float(values[k])
        low, high = min(low, value), max(high, value)
        widest = WIDEST_DEAD_TIME_S if k == 0 else WIDEST_RATIO * max(value, CONTROL_PERIOD_S)
        shown = "" if unit == "1" else f" {unit}"
        if at_bound[k]:
            why = f"the fit ends at a bound of the search ({value:.3g}{shown}): others fit as well"
            found[name] = unknown(unit, why, count=count)
        elif high - low > widest:
            why = f"anything from {low:.3g} to {high:.3g}{shown} fits"
            found[name] = unknown(unit, why, count=count)
        else:
            spread = float(np.std(all_draws[:, k])) * math.sqrt(count)
            found[name] = Quantity(
                unit=unit, value=value, ci90=(low, high), spread=spread, count=count
            )
    return found
