"""Whether a swing's frequency changes over its record, beyond what its amplitude does to it.

A sliding load, a warming spring or a clock that drifts does that; frictions of the library do not.
"""

from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import numpy as np

from diagnosis.alone.fit import correlation_length, fit, interval_factor, standard_errors
from diagnosis.alone.problem import Option, Problem
from diagnosis.alone.reading.envelope import half_swings
from diagnosis.alone.reading.free_swings import Swing

MIN_DRIFT_RATIO: Final = 0.003
"""By eye: less is within what a wrong rest angle or an amplitude of a third does to it."""
MIN_THIRD_ROWS: Final = 40
MIN_HALF_SWINGS: Final = 8
"""By eye: fewer fix no frequency beside two frictions."""
SURE_WIDTHS: Final = 3.0
"""Half widths of the 90 % intervals of both frequencies."""
_NAME: Final = "frequency_rad_per_s"


class Drift(NamedTuple):
    """Change of the frequency from the first to the last third of a swing."""

    ratio: float
    sure_ratio: float
    """What it would be by chance."""

    @property
    def is_sure(self) -> bool:
        """Whether it is more than chance and than what is worth naming."""
        return abs(self.ratio) > max(self.sure_ratio, MIN_DRIFT_RATIO)


def frequency_drift(
    swing: Swing,
    noise: float,
    problem_of: Callable[[Swing], tuple[Problem, Sequence[Option]]],
) -> Drift | None:
    """The drift of one free swing; None where its thirds are too short.

    Args:
        swing: its free part.
        noise: of one sample, rad or m.
        problem_of: the problem of a third, in which the frequency is free, and the options to fit.
    """
    rows = len(swing.time_s) // 3
    if rows < MIN_THIRD_ROWS:
        return None
    found: list[tuple[float, float]] = []
    for part in (slice(0, rows), slice(-rows, None)):
        time_s, angle = swing.time_s[part], swing.angle_rad[part]
        if len(half_swings(angle, noise)) < MIN_HALF_SWINGS:
            return None
        problem, options = problem_of(Swing(time_s - time_s[0], angle))
        own = fit(problem, tuple(options), {})
        length = correlation_length(own.residual, problem.block)
        error = standard_errors(problem, own, length) * interval_factor(problem)
        k = own.names.index(_NAME)
        found.append((float(own.values[k]), float(error[k])))
    (first, error), (last, other) = found
    return Drift(last / first - 1.0, SURE_WIDTHS * float(np.hypot(error, other)) / first)
