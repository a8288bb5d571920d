"""How far the gap shrinks on pieces of a record that chose nothing, and how a record is cut into pieces."""

import math
from typing import Final

import numpy as np

from diagnosis.alone.fit import Fit, fit
from diagnosis.alone.problem import Problem
from diagnosis.alone.selection import Selection
from diagnosis.verdict import Shrink
from machine.conventions import Array, BoolArray, IntArray

BOOTSTRAP_COUNT: Final = 2000


def held_out_shrink(problem: Problem, selection: Selection, noise: float) -> Shrink:
    """Refit ideal and chosen stage without the held-out samples, and compare both on those.

    `before_m` and `after_m` are root mean squares in the unit of the residual.
    """
    held = problem.held
    use = np.where(held, 0.0, 1.0)
    before2 = _squares(problem, selection.base.fit, use)
    after2 = _squares(problem, selection.best.fit, use)
    trained = ~held
    predicted = _removable_share(
        float(np.mean(before2[trained])), float(np.mean(after2[trained])), noise
    )
    before, after = float(np.mean(before2[held])), float(np.mean(after2[held]))
    rng = np.random.default_rng(0)
    pieces = [np.flatnonzero(held & (problem.block == b)) for b in np.unique(problem.block[held])]
    draws: list[float] = []
    for _ in range(BOOTSTRAP_COUNT if len(pieces) > 1 else 0):
        chosen_pieces = rng.integers(0, len(pieces), len(pieces))
        index = np.concatenate([pieces[k] for k in chosen_pieces])
        draws.append(
            _removable_share(float(np.mean(before2[index])), float(np.mean(after2[index])), noise)
        )
    realised = _removable_share(before, after, noise)
    low, high = np.quantile(draws, [0.05, 0.95]) if draws else (math.nan, math.nan)
    ci90 = (float(low), float(high)) if draws else (realised, realised)
    removable = max(1.0 - noise**2 / before, 0.0) if before > 0.0 else 0.0
    return Shrink(
        predicted_ratio=predicted,
        before_m=math.sqrt(before),
        after_m=math.sqrt(after),
        ratio=realised,
        ci90=ci90,
        held_out_throws=len(pieces),
        removable_ratio=math.sqrt(removable),
    )


def _squares(problem: Problem, whole: Fit, use: Array) -> Array:
    """Squared residuals with effects from the samples in use alone; local nuisance from all samples."""
    trained = fit(problem, whole.options, whole.as_mapping(), use=use)
    if not problem.local:
        return trained.residual**2
    values = trained.as_mapping()
    shared = {name: value for name, value in values.items() if name not in problem.local}
    return fit(problem, whole.options, values, frozen=shared).residual ** 2


def every_third(block: IntArray) -> BoolArray:
    """(samples,) every third block: held out."""
    return np.isin(block, np.unique(block)[1::3])


def _removable_share(before: float, after: float, noise: float) -> float:
    """How much of the gap above the noise is gone, from mean squares; 1 = all of it."""
    start = math.sqrt(before)
    left = math.sqrt(max(after - noise**2, 0.0))
    above = math.sqrt(max(before - noise**2, 0.0))
    return 1.0 - left / above if above > 1e-9 * max(start, 1e-12) else 0.0


def spread_blocks(time_s: Array, seconds: float, run: IntArray) -> IntArray:
    """Number the contiguous pieces of `seconds` within each run, (samples,)."""
    piece = np.floor((time_s - time_s[0]) / seconds)
    label = run * (np.max(piece) + 1.0) + piece
    return np.asarray(np.unique(label, return_inverse=True)[1], dtype=np.int64)
