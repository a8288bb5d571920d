"""What a person reads first."""

from collections.abc import Sequence

from diagnosis.causes.ranking import Ranked
from diagnosis.places import signature_of
from diagnosis.report.report_words import channel_words, percent, probability, size_words
from diagnosis.verdict import (
    Ambiguity,
    Cause,
    Gap,
    Shrink,
    VerdictKind,
)


def sentence_of(
    verdict: VerdictKind,
    causes: Sequence[Cause],
    gap: Gap,
    found: tuple[Shrink, str] | None,
    ranked: Ranked,
    ambiguity: Ambiguity | None,
) -> str:
    """What a person reads first: the miss, what causes it, and how much of it the cause closes.

    Args:
        verdict: what is claimed.
        causes: with their probabilities, best first.
        gap: between twin and machine.
        found: how far it shrinks, and by which measure; None if nothing was tried.
        ranked: the hypotheses behind the causes.
        ambiguity: what these throws cannot tell apart.
    """
    size = "" if gap.impact_rms_m is None else f"The twin misses by {gap.impact_rms_m:.2f} m. "
    top, sure = causes[0], probability(causes[0].probability)
    if verdict is VerdictKind.NONE:
        if ranked.best.members:
            return f"{size}No effect that can be claimed; {top.name} ({sure}) comes nearest."
        return f"{size}No effect: a healthy machine scatters as much ({sure} sure)."
    if verdict is VerdictKind.UNKNOWN:
        signature = signature_of(ranked)
        joint = "" if signature["joint"] is None else f" of the {signature['joint']}"
        if signature["looks_like"] is not None:
            return f"{size}Something unknown in {signature['stage']}{joint}: {signature['looks_like']}."
        leaves = "the best known cause leaves" if ranked.best.members else "no known cause explains"
        return (
            f"{size}Something unknown in {signature['stage']}{joint}: {leaves} "
            f"{channel_words(signature['channel'])} {signature['leftover_sd']:.0f} standard deviations "
            "above a healthy machine."
        )
    closes = ""
    if found is not None:
        shrink, measure = found
        metres = (
            f" ({shrink.before_m:.2f} m to {shrink.after_m:.2f} m)" if measure == "impact" else ""
        )
        what = "miss" if measure == "impact" else "gap in its channels"
        share = percent(shrink.ratio)
        closes = f" Adding it closes {share} of the removable {what} on held-out throws{metres}."
    if ambiguity is not None:
        return f"{size}Either {ambiguity.members[0]} or {ambiguity.members[1]}.{closes}"
    sizes = ", ".join(
        f"{name} {value}" for effect in top.effects for name, value, _ in size_words(effect)
    )
    return f"{size}Cause: {top.name} ({sure} sure): {sizes}.{closes}"
