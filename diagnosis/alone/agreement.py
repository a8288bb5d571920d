"""Whether several runs of one record tell the same story, before one set of numbers is given for all.

The effects are fitted to each run by itself; when that explains much more than one fit for all, the runs
are of different bodies or conditions, and the numbers for all of them would be no one's.
"""

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
from scipy.stats import f as fisher

from diagnosis.alone.fit import correlation_length, fit
from diagnosis.alone.problem import Option, Problem

SURPRISE: Final = 1e-3
"""Probability under which equal runs would differ as much."""
MIXED_RATIO: Final = 2.0
"""Residual of the common fit over that of separate fits: beyond this the runs do not belong together."""


class Disagreement(NamedTuple):
    """Runs that differ by more than their noise."""

    ratio: float
    """Root mean square residual of the common fit over that of separate fits."""
    values: tuple[Mapping[str, float], ...]
    """Parameters of the effects, by run."""

    @property
    def is_mixed(self) -> bool:
        """Whether one set of numbers for all runs would be wrong, and not only a little off."""
        return self.ratio > MIXED_RATIO

    def in_words(self) -> str:
        """The parameter that differs most, by run."""
        names = list(self.values[0])
        spread = [
            np.ptp([v[n] for v in self.values])
            / (abs(float(np.median([v[n] for v in self.values]))) + 1e-9)
            for n in names
        ]
        worst = names[int(np.argmax(spread))]
        sizes = ", ".join(f"{v[worst]:.3g}" for v in self.values[:8])
        more = ", ..." if len(self.values) > 8 else ""
        return f"{worst} by run: {sizes}{more}; a fit for each leaves {1.0 / self.ratio:.0%} of the residual"


def disagreement(
    whole: Problem, parts: Sequence[Problem], keys: Sequence[str]
) -> Disagreement | None:
    """Compare one fit for all runs with one a run; None when they agree, or there is one run.

    Args:
        whole: all runs together.
        parts: each run by itself, with the same options.
        keys: of the options that are fitted.
    """
    if len(parts) < 2:
        return None
    common = fit(whole, _options(whole, keys), {})
    own = [fit(part, _options(part, keys), {}) for part in parts]
    squares = sum(float(np.sum(one.residual**2)) for one in own)
    together = float(np.sum(common.residual**2))
    lengths = [
        correlation_length(one.residual, part.block) for one, part in zip(own, parts, strict=True)
    ]
    # The common fit of runs that disagree leaves long waves: their length is no property of the noise.
    count = len(common.residual) / float(np.mean(lengths))
    size = sum(len(one.values) for one in own)
    more = max(size - len(common.values), 1)
    freedom = max(count - size, 1.0)
    ratio2 = (max(together - squares, 0.0) / more) / max(squares / freedom, 1e-300)
    if float(fisher.sf(ratio2, more, freedom)) > SURPRISE:
        return None
    names = {f"{o.key}.{p.name}" for o in common.options for p in o.parameters}
    return Disagreement(
        float(np.sqrt(together / max(squares, 1e-300))),
        tuple({n: v for n, v in one.as_mapping().items() if n in names} for one in own),
    )


def _options(problem: Problem, keys: Sequence[str]) -> tuple[Option, ...]:
    return tuple(option for option in problem.options if option.key in keys)
