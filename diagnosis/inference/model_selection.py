"""Search over sets of effects by evidence, and their probabilities averaged over bootstraps of throws.

Averaging over bootstraps ("BayesBag", Huggins and Miller 2019, arXiv:1912.07104) accounts for a discrepancy
of the twin that is not the noise which the evidence assumes.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
from scipy.special import expit, logsumexp, softmax

from diagnosis.inference.evidence import (
    Information,
    Priors,
    Screen,
    Set,
    SetEvidence,
    members_index,
    screen,
    set_log_prior,
    weigh,
)
from diagnosis.tuning import COUNT_TEMPERATURE_RATIO, FORM_TEMPERATURE_RATIO
from machine.conventions import Array, IntArray

NORMAL_90 = 1.6449
"""Standard deviations to either side that hold 90 % of a normal distribution."""


def search(
    base: Screen,
    priors: Priors,
    groups: Sequence[int],
    *,
    width: int = 12,
    largest: int = 3,
    candidates: int = 40,
) -> list[SetEvidence]:
    """The best hypotheses of these groups, best first; "no effect" is always among them.

    All singles; all pairs that contain one of the best `width` singles; triples that extend the best pairs.
    """
    singles = sorted((weigh(base, priors, (g,)) for g in groups), key=_best_first)
    leaders = [single.members[0] for single in singles[:width]]
    found = {evidence.members: evidence for evidence in singles}
    if largest >= 2:
        pairs = {tuple(sorted((a, b))) for a in leaders for b in groups if a != b}
        found |= {members: weigh(base, priors, members) for members in sorted(pairs)}
    if largest >= 3:
        best_pairs = sorted((e for e in found.values() if len(e.members) == 2), key=_best_first)
        triples = {tuple(sorted({*pair.members, g})) for pair in best_pairs[:8] for g in leaders}
        found |= {
            members: weigh(base, priors, members)
            for members in sorted(triples)
            if len(members) == 3
        }
    ranked = sorted(found.values(), key=_best_first)[:candidates]
    return sorted([*ranked, weigh(base, priors, ())], key=_best_first)


def _best_first(evidence: SetEvidence) -> float:
    return -evidence.log_odds


def bootstrap_weights(throw_count: int, draws: int, seed: int = 0) -> Array:
    """Weights of the throws in each bootstrap (draws, throws); the first row is the data itself.

    The Bayesian bootstrap (Rubin, Ann. Statist. 9, 1981): no throw is left out of a draw, so that an effect
    that few throws show is kept.
    """
    weights = throw_count * np.random.default_rng(seed).dirichlet(np.ones(throw_count), draws)
    weights[0] = 1.0
    return weights


def bagged_probability(log_odds: Array, effect_count: IntArray) -> Array:
    """Probabilities (hypotheses,) averaged over bootstraps.

    Three choices in sequence: whether there is an effect, at the log odds as they are; how many effects, at
    log odds divided by `COUNT_TEMPERATURE_RATIO`; and which, divided by `FORM_TEMPERATURE_RATIO`. The
    library's effects approximate the machine's, and the throws show that error more clearly than which
    effect it is.

    Args:
        log_odds: (draws, hypotheses) against any common reference, prior odds included.
        effect_count: (hypotheses,) number of effects; one of them is 0, "no effect".
    """
    found = np.zeros_like(log_odds)
    counts = np.unique(effect_count[effect_count > 0])
    none = int(np.flatnonzero(effect_count == 0)[0])
    if counts.size == 0:
        return np.ones(1)
    alike = [np.flatnonzero(effect_count == count) for count in counts]
    of_count = np.column_stack([_log_sum(log_odds[:, index]) for index in alike])
    any_effect = expit(_log_sum(of_count) - log_odds[:, none])
    found[:, none] = 1.0 - any_effect
    shares = any_effect[:, None] * softmax(of_count / COUNT_TEMPERATURE_RATIO, axis=1)
    for index, share in zip(alike, shares.T, strict=True):
        which = softmax(log_odds[:, index] / FORM_TEMPERATURE_RATIO, axis=1)
        found[:, index] = share[:, None] * which
    return found.mean(axis=0)


def _log_sum(log_odds: Array) -> Array:
    """Log of the sum of exponentials over the second axis."""
    return np.asarray(logsumexp(log_odds, axis=1), dtype=np.float64)


def expected_log_odds(
    information: Information, priors: Priors, truth: SetEvidence, rival: Set
) -> float:
    """Expected log odds of `truth` over `rival` in these throws if `truth` were true.

    Noise-free data of the hypothesis at its fitted size stand for the average: b = A theta. Small values
    mean that the throws cannot separate the two.
    """
    index = members_index(priors, truth.members)
    base = screen(information, priors)
    ideal = replace(base, gradient=base.precision[:, index] @ truth.mean)
    own, other = weigh(ideal, priors, truth.members), weigh(ideal, priors, rival)
    prior = set_log_prior(priors, truth.members) - set_log_prior(priors, rival)
    return float(own.log_odds - other.log_odds - prior)


def subsets(members: Set) -> list[Set]:
    """All proper subsets, including the empty one."""
    return [s for size in range(len(members)) for s in combinations(members, size)]
