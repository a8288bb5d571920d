"""Whether several runs of one record tell the same story, before one set of numbers is given for all.

The effects are fitted to each run by itself; when that explains much more than one fit for all, the runs
are of different bodies or conditions, and the numbers for all of them would be no one's.
"""

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
from scipy.stats import f as fisher

from diagnosis.alone.fit import Fit, Option, Problem, fit
from diagnosis.alone.selection import Selection

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
    parts: Sequence[Problem], selection: Selection, extra: Sequence[Option]
) -> Disagreement | None:
    """Compare the common fit with one a run; None when the runs agree, or there is one.

    Args:
        parts: the runs as problems of their own, with the same options.
        selection: of all runs together.
        extra: options that each run gets beside those of the best structure.
    """
    if len(parts) < 2:
        return None
    common = selection.best.fit
    taken = {option.effect for option in common.options}
    options = (*common.options, *(o for o in extra if o.effect not in taken))
    own: list[Fit] = []
    for part in parts:
        by_key = {option.key: option for option in part.options}
        own.append(fit(part, tuple(by_key[option.key] for option in options), {}))
    squares = sum(float(np.sum(one.residual**2)) for one in own)
    whole = float(np.sum(common.residual**2))
    count = len(common.residual) / selection.correlation_samples
    size = sum(len(one.values) for one in own)
    more = max(size - len(common.values), 1)
    freedom = max(count - size, 1.0)
    ratio2 = (max(whole - squares, 0.0) / more) / max(squares / freedom, 1e-300)
    if float(fisher.sf(ratio2, more, freedom)) > SURPRISE:
        return None
    names = {f"{o.key}.{p.name}" for o in options for p in o.parameters}
    return Disagreement(
        float(np.sqrt(whole / max(squares, 1e-300))),
        tuple({n: v for n, v in one.as_mapping().items() if n in names} for one in own),
    )
