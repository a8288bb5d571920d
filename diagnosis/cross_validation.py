"""Reduction of the gap on held-out throws: predicted first, then measured.

The throws are divided into three parts. For each part the effects are estimated on the other two and the
reduction is predicted there. The twin profile with those effects is written to disk and read back, and the
held-out part is simulated from its valve commands to its impact.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

from diagnosis.correction import with_effects
from diagnosis.hypotheses.candidate import fitted_effects, weighed
from diagnosis.hypotheses.gap_problem import GapProblem
from diagnosis.hypotheses.marginal_likelihood import MarginalLikelihood
from diagnosis.hypotheses.ranking import Hypothesis
from diagnosis.linearisation.information import members_index
from diagnosis.linearisation.open_loop import impacts
from diagnosis.linearisation.parameters import ReplayKind, library
from diagnosis.linearisation.residual_power import INSENSITIVE_BLOCKS
from diagnosis.linearisation.sensitivities import LinearThrow, relinearise
from diagnosis.linearisation.unmodelled_effects import unmodelled_names
from diagnosis.tuning import CLEAR_RATIO
from diagnosis.verdict import Shrink
from machine.conventions import Array, IntArray
from sim_twin.effects.effect import Effect, acting_effect
from sim_twin.effects.table import EFFECTS
from sim_twin.twin.profile import TwinProfile, load_profile, save_profile

PART_COUNT = 3
"""Folds of the cross-validation."""
BOOTSTRAP_COUNT = 400
"""Bootstrap draws of the interval."""
LEAST_GAP_RATIO = 0.02
"""The removable gap counts as at least this share of the gap: a share of nothing has no size."""


class Gaps(NamedTuple):
    """Gaps of N throws under one profile."""

    impact_m: Array
    """(N, 2) measured minus twin."""
    power: Array
    """(N,) residual power per row, whitened, of the channels that the effects move; NaN if they move none."""
    floor: Array
    """(N,) the same power of healthy machines."""


class Held(NamedTuple):
    """Gaps before and after adding the effects: held-out throws, and the throws that gave the estimates."""

    before: Gaps
    after: Gaps
    trained_before: Gaps
    trained_after: Gaps


def moved_blocks(problem: GapProblem, hypothesis: Hypothesis) -> list[set[str]]:
    """Channels of every throw that the effects move at their fitted sizes."""
    under = _under(problem, hypothesis, problem.profile, hypothesis.effects)
    return [
        {
            block.name
            for block in p.blocks
            if np.nan_to_num(linear.change[block.rows]).any()
            and not block.name.startswith(INSENSITIVE_BLOCKS)
        }
        for p, linear in zip(problem.prepared, under, strict=True)
    ]


def _under(
    problem: GapProblem, hypothesis: Hypothesis, profile: TwinProfile, effects: tuple[Effect, ...]
) -> Sequence[LinearThrow]:
    """The throws under a profile and further effects, in the views that a hypothesis moves; no slopes."""
    columns = members_index(problem.layout.priors, hypothesis.members)
    columns = columns % problem.layout.parameter_count
    views = {view for i in columns for view in library()[int(i)].views}
    return next(
        relinearise(
            problem.prepared,
            profile,
            problem.calibration,
            problem.healthy,
            problem.linear,
            [(effects, ())],
            tuple(view for view in ReplayKind if view in views),
        )
    )


def gaps(
    likelihood: MarginalLikelihood,
    hypothesis: Hypothesis,
    moved: Sequence[set[str]],
    profile: TwinProfile,
) -> Gaps:
    """Gaps of all throws under a profile: of the impact, and of the channels that a hypothesis moves."""
    problem = likelihood.problem
    measured = np.stack([p.throw.impact_m[:2] for p in problem.prepared])
    under = _under(problem, hypothesis, profile, ())
    # Other scatter of the machine is not this effect's gap; unmodelled effects would absorb it.
    others = hypothesis.candidate.healthy_mean.copy()
    others[-len(unmodelled_names()) :] = 0.0
    left = likelihood.left_over([linear.change for linear in under], others)
    power = [
        _power(
            {b.name: _square(rest[b.rows]) for b in p.blocks if b.name in names},
            problem.model.unknown_level,
        )
        for p, rest, names in zip(problem.prepared, left, moved, strict=True)
    ]
    squares, floors = np.array(power).T
    found = impacts(problem.prepared, problem.healthy, profile, problem.calibration)
    return Gaps(measured - found, squares, floors)


def _square(rest: Array) -> tuple[float, int]:
    return float(rest @ rest), rest.size


def _power(
    left: Mapping[str, tuple[float, int]],
    healthy: Mapping[str, tuple[float, float]],
) -> tuple[float, float]:
    """Residual power per row of some blocks, and that of a healthy machine; NaN without blocks."""
    count = sum(rows for _, rows in left.values())
    if count == 0:
        return float("nan"), float("nan")
    square = sum(power for power, _ in left.values())
    floor = sum(rows * np.exp(healthy.get(n, (0.0, 0.0))[0]) for n, (_, rows) in left.items())
    return square / count, float(floor / count)


def held_out(likelihood: MarginalLikelihood, hypothesis: Hypothesis, folder: Path) -> Held:
    """Hold out every third of the throws once."""
    problem = likelihood.problem
    count = len(problem.prepared)
    everyone = np.arange(count)
    moved = moved_blocks(problem, hypothesis)
    before = gaps(likelihood, hypothesis, moved, problem.profile)
    after = Gaps(np.full((count, 2), np.nan), *np.full((2, count), np.nan))
    trained: list[Gaps] = []
    rows: list[IntArray] = []
    for part in range(min(PART_COUNT, count)):
        # Consecutive throws go to different parts, which mixes modes and targets.
        left_out = everyone[everyone % PART_COUNT == part]
        used = np.setdiff1d(everyone, left_out)
        sizes = _sizes(likelihood, hypothesis, used)
        effects = fitted_effects(problem.layout, hypothesis.members, sizes)
        path = folder / f"part-{part}.profile.json"
        save_profile(with_effects(problem.profile, effects), path)
        found = gaps(likelihood, hypothesis, moved, load_profile(path))
        after.impact_m[left_out] = found.impact_m[left_out]
        after.power[left_out] = found.power[left_out]
        after.floor[left_out] = found.floor[left_out]
        trained.append(_rows(found, used))
        rows.append(used)
    return Held(
        before,
        after,
        _rows(before, np.concatenate(rows)),
        Gaps(*map(np.concatenate, zip(*trained, strict=True))),
    )


def _rows(found: Gaps, rows: IntArray) -> Gaps:
    return Gaps(*(values[rows] for values in found))


def _sizes(likelihood: MarginalLikelihood, hypothesis: Hypothesis, used: IntArray) -> Array:
    """Sizes (k,) of a set by some of the throws."""
    one = hypothesis.candidate
    there = weighed(
        likelihood,
        one.members,
        one.sizes,
        [one.products[int(i)] for i in used],
        [one.change[int(i)] for i in used],
    )
    return there.sizes + there.step


def _rms(gap: Array) -> float:
    good = np.isfinite(gap).all(axis=-1)
    return float(np.sqrt((gap[good] ** 2).sum(axis=-1).mean())) if good.any() else float("nan")


class Ends(NamedTuple):
    """Root mean squares of a gap: before, after, and the part that cannot be removed; one unit."""

    before: float
    after: float
    floor: float


def _ends(before: Gaps, after: Gaps, floor_m: float, *, by_impact: bool) -> Ends | None:
    """For the impact or for the channels; None where the effects move no channel."""
    if by_impact:
        return Ends(_rms(before.impact_m), _rms(after.impact_m), floor_m)
    known = np.isfinite(before.power) & np.isfinite(after.power)
    if not known.any():
        return None
    powers = (before.power, after.power, before.floor)
    return Ends(*(float(np.sqrt(power[known].mean())) for power in powers))


def _closed(ends: Ends | None, least_seen: float) -> float:
    """Share of the removable gap that is closed.

    What healthy machines of the type show cannot be removed. Where less is left on the throws that gave the
    estimates (`least_seen`), that is the limit: a set can be quieter than its type.
    """
    if ends is None:
        return 0.0
    floor = min(ends.floor, least_seen, ends.before)
    # A gap below the floor is chance and counts as the floor; a tiny removable gap is bounded from below.
    removable = max(ends.before - floor, LEAST_GAP_RATIO * ends.before, 1e-12)
    return float(np.clip((ends.before - max(ends.after, floor)) / removable, -1.0, 1.0))


def _acts_on_pose(hypothesis: Hypothesis) -> bool:
    """Whether an effect is one of pose or sensors."""
    return any(EFFECTS[acting_effect(e)].stage == "aim" for e in hypothesis.effects)


def shrink(
    likelihood: MarginalLikelihood, hypothesis: Hypothesis, floor_m: float
) -> tuple[Shrink, str] | None:
    """The measured reduction with a paired bootstrap over throws, and its measure; None without impacts.

    The measure is the impact where the gap and its change exceed the scatter of healthy machines. Otherwise
    it is the channels that the effects move: sensor effects move no impact in a replay.

    Args:
        likelihood: of the set.
        hypothesis: the effects.
        floor_m: gap of a healthy machine, root mean square.
    """
    with TemporaryDirectory(prefix="downrange-shrink-") as name:
        held = held_out(likelihood, hypothesis, Path(name))
    good = np.flatnonzero(np.isfinite(held.before.impact_m + held.after.impact_m).all(axis=1))
    if good.size < PART_COUNT:
        return None
    before, after = _rows(held.before, good), _rows(held.after, good)
    gap_m = _rms(before.impact_m)
    moved_m = _rms(before.impact_m - after.impact_m)
    by_impact = gap_m > CLEAR_RATIO * floor_m and moved_m > floor_m
    trained = _ends(held.trained_before, held.trained_after, floor_m, by_impact=by_impact)
    least_seen = trained.after if trained is not None else np.inf
    rng = np.random.default_rng(0)
    drawn = [
        _closed(
            _ends(_rows(before, rows), _rows(after, rows), floor_m, by_impact=by_impact), least_seen
        )
        for rows in rng.integers(0, good.size, (BOOTSTRAP_COUNT, good.size))
    ]
    low, high = np.quantile(drawn, (0.05, 0.95))
    floor = min(floor_m, _rms(held.trained_after.impact_m), gap_m)
    found = Shrink(
        predicted_ratio=_closed(trained, least_seen),
        before_m=gap_m,
        after_m=_rms(after.impact_m),
        ratio=_closed(_ends(before, after, floor_m, by_impact=by_impact), least_seen),
        ci90=(float(low), float(high)),
        held_out_throws=int(good.size),
        removable_ratio=1.0 - floor / gap_m,
        moved_m=None if _acts_on_pose(hypothesis) else moved_m,
    )
    return found, "impact" if by_impact else "channels"
