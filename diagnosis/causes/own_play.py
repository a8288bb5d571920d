"""Play that changes on the way, looked for beside play: with the slopes at that play, not those at none.

Slopes of play that opens from none are not those of play that is there: beside a hysteresis that wears off
on the way little was left that looked like wear.
"""

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from diagnosis.causes.evidence import Priors, total
from diagnosis.causes.linear import Linear
from diagnosis.causes.problem import Problem
from diagnosis.causes.shapes import PLAY_POWERS, group_of, unheard_groups, unheard_names
from diagnosis.causes.unheard import play_columns
from diagnosis.causes.whitening import (
    Whitened,
    beside_named,
    healthy_middle,
    information,
    slope_count,
)
from diagnosis.healthy.noise import whiten
from diagnosis.loading.prepared import PreparedThrow
from machine.conventions import Array, IntArray


def with_own_play(
    problem: Problem,
    throws: Sequence[Whitened],
    at: Sequence[Linear],
    factors: Sequence[Sequence[Array]],
    joints: Collection[str],
) -> tuple[list[Whitened], Priors]:
    """Throws whose shapes of changing play, at some joints, have the slopes of a trial.

    Of them only what the named slopes of the trial do not explain: play that is the same all along is play.
    The priors know what else they look like.

    Args:
        problem: the throws.
        throws: whitened about the trial.
        at: their residuals and slopes there.
        factors: of their blocks' covariances.
        joints: where the trial has play.
    """
    places = np.array([p for j in joints for p in unheard_groups()[group_of("play"), j]])
    middle = healthy_middle(problem.model, unheard_names())[places]
    columns = 2 + slope_count() - len(unheard_names()) + places
    own = [
        _with_columns(w, columns, _whitened_play(p, linear, factor, joints), middle)
        for w, p, linear, factor in zip(throws, problem.prepared, at, factors, strict=True)
    ]
    beside = beside_named(total(information(own)), problem.layout)[:, places]
    named = slice(2, 2 + beside.shape[0])
    looks_like = problem.beside.copy()
    looks_like[:, places] = beside
    return [
        _with_columns(w, columns, w.table[:, columns] - w.table[:, named] @ beside, middle)
        for w in own
    ], problem.layout.priors._replace(looks_like=looks_like)


def _whitened_play(
    prepared: PreparedThrow, linear: Linear, factor: Sequence[Array], joints: Collection[str]
) -> Array:
    """Columns (n, k) of changing play, joint after joint, each at the rows of its joint."""
    parts: list[Array] = []
    for joint in joints:
        part = np.zeros((linear.residual.size, len(PLAY_POWERS)))
        for block, lower in zip(prepared.blocks, factor, strict=True):
            if block.name == f"actuation.{joint}":
                part[block.rows] = whiten(lower, play_columns(prepared, linear, block))
        parts.append(part)
    return np.column_stack(parts)


def _with_columns(whitened: Whitened, columns: IntArray, values: Array, middle: Array) -> Whitened:
    """Other values (n, k) in some columns; residuals are less what healthy machines have along them."""
    table, gram = whitened.table.copy(), whitened.gram.copy()
    table[:, :2] += ((table[:, columns] - values) @ middle)[:, None]
    table[:, columns] = values
    moved = np.r_[0, 1, columns]
    gram[:, moved] = table.T @ table[:, moved]
    gram[moved] = gram[:, moved].T
    return replace(whitened, first=table, gram=gram, changes=())
