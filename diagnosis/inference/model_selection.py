"""Search over sets of effects by their evidence along slopes."""

from collections.abc import Sequence

from diagnosis.inference.evidence import (
    Priors,
    Screen,
    SetEvidence,
    weigh,
)

NORMAL_90 = 1.6449
"""Standard deviations to either side that hold 90 % of a normal distribution."""


def search(
    base: Screen,
    priors: Priors,
    groups: Sequence[int],
    *,
    width: int = 12,
    candidates: int = 40,
) -> list[SetEvidence]:
    """The best hypotheses of these groups, best first; "no effect" is always among them.

    All singles, and all pairs that contain one of the best `width` singles.
    """
    singles = sorted((weigh(base, priors, (g,)) for g in groups), key=_best_first)
    leaders = [single.members[0] for single in singles[:width]]
    found = {evidence.members: evidence for evidence in singles}
    pairs = {tuple(sorted((a, b))) for a in leaders for b in groups if a != b}
    found |= {members: weigh(base, priors, members) for members in sorted(pairs)}
    ranked = sorted(found.values(), key=_best_first)[:candidates]
    return sorted([*ranked, weigh(base, priors, ())], key=_best_first)


def _best_first(evidence: SetEvidence) -> float:
    return -evidence.log_odds
