"""Exploration of hypotheses: refined where each fits best, and weighed on bootstraps of the throws.

A first linearisation at "no effect" finds candidates. An effect of finite size is nonlinear, so each
candidate is simulated at its own estimate and compared by the evidence there.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from diagnosis.hypotheses.candidates import evaluate, fitted_effects, no_effect, set_in_candidate
from diagnosis.hypotheses.comparison import (
    CandidateSet,
    EvaluatedSet,
    comparable_evidence,
    comparable_on_all,
)
from diagnosis.hypotheses.gap_problem import GapProblem
from diagnosis.hypotheses.generation import (
    extended_sets,
    missing_lookalikes,
    missing_subsets,
    pair_starts,
    refined_singles,
    with_unmodelled_effects,
)
from diagnosis.hypotheses.refinement import (
    fine_line_search,
    large_enough,
    refine,
    refine_until_close,
    relinearise_if_better,
    relinearise_near_best,
)
from diagnosis.inference.evidence import Information, Set, SetEvidence, total
from diagnosis.inference.model_selection import bootstrap_weights, subsets
from diagnosis.tuning import FORM_EVIDENCE_RATIO, GROWTH, PAIRED_COUNT, SUBSET_COUNT, WEIGHED_COUNT
from machine.conventions import Array
from sim_twin.effects.effect import Effect

BOOTSTRAP_COUNT = 30
"""Bootstraps of the throws."""


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """A set of effects at its best size."""

    members: Set
    effects: tuple[Effect, ...]
    evidence: SetEvidence
    log_evidence: Array
    """(draws,) on each bootstrap of the throws; the first is the data themselves."""
    mean: Array
    """Posterior mean of the whole vector, scatter of the other parameters included."""
    levels: Mapping[str, float]
    """By block: log residual power per row over all throws."""
    information: Sequence[Information]
    """Of the whole vector for each throw, linearised at the hypothesis."""


def explore(problem: GapProblem, tick: Callable[[float], None]) -> list[Hypothesis]:
    """Extend hypotheses effect by effect, each from a linearisation at the smaller one's best size.

    The nonlinearity of an effect looks like a second effect when linearised at "no effect". So pairs are
    sought from refined singles, and triples from refined pairs.
    """
    none = no_effect(problem)
    found = [none, *large_enough(problem, refined_singles(problem, none))]
    tick(0.4)
    for size, (behind, kept) in enumerate(GROWTH, start=2):
        fair = comparable_on_all(found)
        best = [t for t in _ranked(found) if len(t.members) == size - 1]
        partners = pair_starts(problem, best[:PAIRED_COUNT]) if size == 2 else []
        extended = extended_sets(problem, best[:behind], kept, max(fair)).items()
        settled = refine(problem, [*extended, *partners], 2 if size == 2 else 1)
        found += large_enough(problem, settled)
        tick(0.4 + 0.2 * (size - 1))
    last = _best_with_subsets(problem, found)
    tick(0.9)
    weights = bootstrap_weights(len(problem.prepared), BOOTSTRAP_COUNT)
    candidates = relinearise_near_best(problem, [none, *large_enough(problem, last)])
    candidates += subsets_of_leader(problem, candidates)
    # At the machine's scatter an effect may be too small.
    candidates = large_enough(problem, candidates)
    evaluated = [
        *((i, t.members) for i, t in enumerate(candidates)),
        *with_unmodelled_effects(problem, candidates),
    ]
    logs = np.array(
        [
            comparable_evidence(
                candidates, evaluated, [total(t.information, w) for t in candidates], is_last=True
            )
            for w in weights
        ]
    )
    logs -= model_error_of_subsets(candidates, evaluated, logs)
    return [_weighed(problem, candidates[i], m, logs[:, k]) for k, (i, m) in enumerate(evaluated)]


def _best_with_subsets(problem: GapProblem, found: Sequence[CandidateSet]) -> list[CandidateSet]:
    """The best sets, and the lookalikes and subsets of those that lead, each refined.

    The first candidate is that of no effect. Subsets are refined as far as the set, so that their
    comparison is fair.
    """
    chosen = [t for t in _ranked(found)[:WEIGHED_COUNT] if t.members]
    best = fine_line_search(problem, refine_until_close(problem, chosen))
    leading = _ranked([found[0], *best])[:SUBSET_COUNT]
    lookalikes = refine_until_close(
        problem, evaluate(problem, missing_lookalikes(problem, found, leading))
    )
    tried = [*found, *evaluate(problem, missing_subsets([*found, *lookalikes], leading))]
    wanted = {p for t in leading for p in subsets(t.members) if p}
    wanted -= {t.members for t in best}
    parts = [t for t in tried if t.members in wanted]
    return [*best, *lookalikes, *fine_line_search(problem, refine_until_close(problem, parts))]


def subsets_of_leader(
    problem: GapProblem, candidates: Sequence[CandidateSet]
) -> list[CandidateSet]:
    """Subsets of the leading set that were not evaluated, linearised at their machine's scatter."""
    points = missing_subsets(candidates, _ranked(candidates)[:1])
    return relinearise_if_better(problem, refine_until_close(problem, evaluate(problem, points)))


def _ranked(candidates: Sequence[CandidateSet]) -> list[CandidateSet]:
    """Best first."""
    return [candidates[i] for i in np.argsort(comparable_on_all(candidates))[::-1]]


def model_error_of_subsets(
    candidates: Sequence[CandidateSet], evaluated: Sequence[EvaluatedSet], logs: Array
) -> Array:
    """Log evidence (draws, sets) of an unmodelled effect that may be the other effects' model error.

    It is a share of what those effects explain.
    """
    parts = {members: k for k, (_, members) in enumerate(evaluated)}
    form = np.zeros_like(logs)
    for k, (i, members) in enumerate(evaluated):
        part = candidates[i].members
        if part and part != members:
            explained_evidence = logs[:, parts[part]] - logs[:, parts[()]]
            form[:, k] = FORM_EVIDENCE_RATIO * np.maximum(explained_evidence, 0.0)
    return form


def _weighed(problem: GapProblem, candidate: CandidateSet, members: Set, logs: Array) -> Hypothesis:
    """A set in a candidate's linearisation, with its log evidence (draws,) on bootstraps of the throws."""
    evidence, mean = set_in_candidate(candidate, members)
    return Hypothesis(
        members=members,
        effects=fitted_effects(problem.layout, members, evidence.mean),
        evidence=evidence,
        log_evidence=logs,
        mean=mean,
        levels=candidate.levels,
        information=candidate.information,
    )
