"""Draws the truth of a challenge from one seed: tier, effects, sizes and machine of every set."""

from collections.abc import Callable, Mapping, Sequence
from enum import StrEnum
from typing import Final

import numpy as np
from pydantic import BaseModel, ConfigDict

from challenge.detection_limits import limit_key
from machine.errors import UsageError
from sim_twin.effects.pairs import CONFUSABLE_PAIRS
from sim_twin.effects.schema import DRIFT
from sim_twin.effects.table import EFFECTS, effects_where
from sim_twin.faults.fault import Fault
from sim_twin.faults.fault_tables import FAULTS, TABLE_FAULTS, UNLISTED_FAULTS, FaultSpec


class Tier(StrEnum):
    """Kinds of data sets; all are thrown in closed loop, with nuisance."""

    NULL = "null"
    SINGLE = "single"
    PAIR = "pair"
    UNKNOWN = "unknown"
    CROSS = "cross"
    """A single effect or a pair, simulated by another integrator in four times finer steps."""


TIER_SHARES: Final = {
    Tier.NULL: 0.20,
    Tier.SINGLE: 0.40,
    Tier.PAIR: 0.15,
    Tier.UNKNOWN: 0.125,
    Tier.CROSS: 0.125,
}
LARGEST_MULTIPLE: Final = 10.0
VISIBLE_SHARE: Final = 0.45
"""Effects whose limit exceeds this share of the bound are left out: twice the limit would not fit."""
BOUND_SHARE: Final = 0.9
"""Sizes stay this far inside their bounds."""
DRIFT_SLOTS: Final = 4
"""Drifting effects for each round of all the others."""
UNIT_SEEDS: Final = 4
"""Machines of a challenge: the nominal one and three with other drives."""


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class TrueEffect(_Part):
    """An effect that a data set hides."""

    effect: str
    joint: str | None = None
    parameters: Mapping[str, float]
    stage: str
    multiple_ratio: float
    """Size over its detection limit."""

    def in_plant(self) -> Fault:
        """The effect as the virtual machine takes it."""
        return Fault(self.effect, self.joint, self.parameters)


class SetTruth(_Part):
    """What one data set is."""

    set_id: str
    tier: Tier
    unit_seed: int
    seed: int
    """Of nuisance, starts, targets and noise."""
    effects: tuple[TrueEffect, ...]
    landed_count: int = 0


def draw_truths(
    seed: int, count: int, limits: Mapping[str, float], tiers: Sequence[Tier] = tuple(Tier)
) -> list[SetTruth]:
    """Draw the sets of a challenge, in random order.

    Raises:
        UsageError: no sets or no tiers.
        KeyError: an effect has no detection limit; healthy sets need none.
    """
    if count < 1 or not tiers:
        raise UsageError(f"--sets {count}: a challenge has at least 1 set of at least 1 tier")
    rng = np.random.default_rng([seed, 0xC4A1])
    units = [0, *(int(u) for u in rng.integers(1, 10_000, UNIT_SEEDS - 1))]
    kinds = _shares(count, tiers)
    singles = _Deck(lambda: [*_slots(TABLE_FAULTS, limits), *[(DRIFT, None)] * DRIFT_SLOTS], rng)
    unknowns = _Deck(lambda: _slots(UNLISTED_FAULTS, limits), rng)
    drawn: list[tuple[Tier, tuple[TrueEffect, ...]]] = []
    for index, tier in enumerate(kinds):
        strong = index % 2 == 1
        if tier is Tier.NULL:
            effects: tuple[TrueEffect, ...] = ()
        elif tier is Tier.UNKNOWN:
            effects = (_unknown(*unknowns.next(), limits, rng),)
        elif tier is Tier.PAIR or (tier is Tier.CROSS and index % 3 == 0):
            effects = _pair(confounded=strong, limits=limits, rng=rng)
        else:
            effects = (_single(*singles.next(), limits, rng, strong=strong),)
        drawn.append((tier, effects))
    order = rng.permutation(count)
    return [
        SetTruth(
            set_id=f"set-{number + 1:04d}",
            tier=drawn[place][0],
            unit_seed=units[number % len(units)],
            seed=int(rng.integers(2**31)),
            effects=drawn[place][1],
        )
        for number, place in enumerate(order)
    ]


def hidden_drifts() -> list[tuple[str, str]]:
    """Effects and parameters that may drift within a set; ``warm_up_drift`` names one of them."""
    drifting = effects_where(lambda effect: effect.hides_drift)
    return [(effect, parameter) for effect in drifting for parameter in TABLE_FAULTS[effect].bounds]


def weaker(truth: SetTruth, ratio: float) -> SetTruth:
    """The same set with every effect at this share of its size."""

    def shrunk(effect: TrueEffect) -> TrueEffect:
        strength = FAULTS[effect.effect].strength if effect.effect != DRIFT else None
        sizes = {
            name: value * ratio if strength in (None, name) else value
            for name, value in effect.parameters.items()
        }
        update = {"parameters": sizes, "multiple_ratio": effect.multiple_ratio * ratio}
        return effect.model_copy(update=update)

    return truth.model_copy(update={"effects": tuple(shrunk(e) for e in truth.effects)})


class _Deck:
    """Deals all effects and joints in random order, so that a challenge leaves none out.

    Slots are asked for with the first deal: healthy sets need no detection limits, which a new effect
    does not have yet.
    """

    def __init__(
        self, slots: Callable[[], list[tuple[str, str | None]]], rng: np.random.Generator
    ) -> None:
        self._slots, self._rng = slots, rng
        self._left: list[tuple[str, str | None]] = []

    def next(self) -> tuple[str, str | None]:
        if not self._left:
            slots = self._slots()
            self._left = [slots[i] for i in self._rng.permutation(len(slots))]
        return self._left.pop()


def _slots(
    effects: Mapping[str, FaultSpec], limits: Mapping[str, float]
) -> list[tuple[str, str | None]]:
    """Effects and joints whose detection limit lies well within their bounds."""
    return [
        (name, joint)
        for name, hidden in effects.items()
        for joint in (hidden.joints or (None,))
        if _visible(hidden, joint, limits)
    ]


def _visible(hidden: FaultSpec, joint: str | None, limits: Mapping[str, float]) -> tuple[str, ...]:
    """Parameters that grow with the effect and whose limit lies within their bounds."""
    return tuple(
        name
        for name, bounds in hidden.bounds.items()
        if hidden.strength in (None, name)
        and limits[limit_key(hidden.name, joint, name)] <= VISIBLE_SHARE * max(bounds)
    )


def _shares(count: int, tiers: Sequence[Tier]) -> list[Tier]:
    """Tiers of `count` sets in their shares, by largest remainder."""
    total = sum(TIER_SHARES[tier] for tier in tiers)
    wanted = {tier: count * TIER_SHARES[tier] / total for tier in tiers}
    whole = {tier: int(share) for tier, share in wanted.items()}
    by_rest = sorted(tiers, key=lambda tier: whole[tier] - wanted[tier])
    for tier in by_rest[: count - sum(whole.values())]:
        whole[tier] += 1
    return [tier for tier in tiers for _ in range(whole[tier])]


def _multiple(rng: np.random.Generator, *, strong: bool) -> float:
    """Half of the sizes lie at or above twice the detection limit."""
    low, high = (2.0, LARGEST_MULTIPLE) if strong else (1.0, 2.0)
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _single(
    effect: str,
    joint: str | None,
    limits: Mapping[str, float],
    rng: np.random.Generator,
    *,
    strong: bool,
) -> TrueEffect:
    if effect == DRIFT:
        return _drift(limits, rng, strong=strong)
    hidden = TABLE_FAULTS[effect]
    names = _chosen(effect, _visible(hidden, joint, limits), rng)
    multiple = _multiple(rng, strong=strong)
    weights = _weights(effect, names, rng)
    sizes: dict[str, float] = {}
    for name, weight in zip(names, weights, strict=True):
        unit = limits[limit_key(effect, joint, name)] * weight
        low, high = hidden.bounds[name]
        sign = _sign(unit * multiple, low, high, rng)
        bound = BOUND_SHARE * (high if sign > 0.0 else -low)
        multiple = min(multiple, bound / unit) if unit > 0.0 else multiple
        sizes[name] = sign * unit
    return TrueEffect(
        effect=effect,
        joint=joint,
        parameters={name: size * multiple for name, size in sizes.items()},
        stage=hidden.stage,
        multiple_ratio=multiple,
    )


def _chosen(effect: str, names: tuple[str, ...], rng: np.random.Generator) -> tuple[str, ...]:
    """Both directions of a valve or one of them; all components of a vector."""
    if not EFFECTS[effect].shapes_speed or len(names) < 2:
        return names
    return (names, names, names[:1], names[1:])[int(rng.integers(4))]


def _weights(effect: str, names: tuple[str, ...], rng: np.random.Generator) -> list[float]:
    """Share of each parameter's limit: the components of a vector have a random direction."""
    if len(names) == 1 or (effect in EFFECTS and EFFECTS[effect].shapes_speed):
        return [1.0] * len(names)
    direction = np.abs(rng.standard_normal(len(names)))
    return [float(v) for v in direction / np.linalg.norm(direction)]


def _sign(size: float, low: float, high: float, rng: np.random.Generator) -> float:
    """A sign that leaves room for the size."""
    fits = [sign for sign, end in ((1.0, high), (-1.0, -low)) if BOUND_SHARE * end >= size]
    if fits:
        return fits[int(rng.integers(len(fits)))]
    return 1.0 if high >= -low else -1.0


def _drift(limits: Mapping[str, float], rng: np.random.Generator, *, strong: bool) -> TrueEffect:
    shown = [
        (effect, parameter, joint)
        for effect, parameter in hidden_drifts()
        for joint in (TABLE_FAULTS[effect].joints or (None,))
        if parameter in _visible(TABLE_FAULTS[effect], joint, limits)
        and limits[limit_key(DRIFT, joint, f"{effect}.{parameter}")]
        <= VISIBLE_SHARE * max(TABLE_FAULTS[effect].bounds[parameter])
    ]
    effect, parameter, joint = shown[int(rng.integers(len(shown)))]
    hidden = TABLE_FAULTS[effect]
    unit = limits[limit_key(DRIFT, joint, f"{effect}.{parameter}")]
    low, high = hidden.bounds[parameter]
    sign = _sign(unit * _multiple(rng, strong=strong), low, high, rng)
    bound = BOUND_SHARE * (high if sign > 0.0 else -low)
    multiple = min(_multiple(rng, strong=strong), bound / unit)
    return TrueEffect(
        effect=DRIFT,
        joint=joint,
        parameters={f"{effect}.{parameter}": sign * unit * multiple},
        stage=hidden.stage,
        multiple_ratio=multiple,
    )


def _pair(
    *, confounded: bool, limits: Mapping[str, float], rng: np.random.Generator
) -> tuple[TrueEffect, ...]:
    if confounded:
        choices = _confounded_slots(limits)
        slots = choices[int(rng.integers(len(choices)))]
    else:
        deck = _slots(TABLE_FAULTS, limits)
        slots = [deck[i] for i in rng.choice(len(deck), 2, replace=False)]
        while slots[0][0] == slots[1][0]:
            slots = [deck[i] for i in rng.choice(len(deck), 2, replace=False)]
    return tuple(_single(effect, joint, limits, rng, strong=True) for effect, joint in slots)


def _confounded_slots(limits: Mapping[str, float]) -> list[list[tuple[str, str | None]]]:
    """Every confounded pair once a joint on which both effects can be seen."""
    slots = _slots(TABLE_FAULTS, limits)
    return [
        [one, other]
        for pair in CONFUSABLE_PAIRS
        if pair.is_hidden
        for one in slots
        for other in slots
        if (one[0], other[0]) == (pair.first, pair.second)
        and (one[1] == other[1] or None in (one[1], other[1]))
    ]


def _unknown(
    effect: str, joint: str | None, limits: Mapping[str, float], rng: np.random.Generator
) -> TrueEffect:
    hidden = UNLISTED_FAULTS[effect]
    grows = tuple(hidden.bounds) if hidden.strength is None else (hidden.strength,)
    multiple = _multiple(rng, strong=True)
    weights = dict(zip(grows, _weights(effect, grows, rng), strict=True))
    sizes: dict[str, float] = {}
    for name, (low, high) in hidden.bounds.items():
        if name not in grows:
            sizes[name] = float(rng.uniform(low, high))
            continue
        unit = limits[limit_key(effect, joint, name)] * weights[name]
        sign = _sign(unit * multiple, low, high, rng)
        multiple = min(multiple, BOUND_SHARE * max(high, -low) / unit)
        sizes[name] = sign * unit
    return TrueEffect(
        effect=effect,
        joint=joint,
        parameters={n: v * multiple if n in grows else v for n, v in sizes.items()},
        stage=hidden.stage,
        multiple_ratio=multiple,
    )
