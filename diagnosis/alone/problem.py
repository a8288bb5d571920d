"""What the three stage tools fit: parameters, options of a structure, and the data of one stage."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple, Protocol

from machine.conventions import Array, BoolArray, IntArray


class FreeParameter(NamedTuple):
    """A number that is fitted, with its bounds; `low` is the smallest magnitude worth naming."""

    name: str
    unit: str
    low: float
    high: float
    starts: tuple[float, ...]
    is_void_at_high: bool = False
    """Whether the effect is not really there when the fit ends at `high`."""
    prior_sd: float = math.inf
    """What is known of it beforehand, as a standard deviation about its first start."""
    is_threshold: bool = False
    """Whether the response stays as it is over ranges of it: no slope leads to the best one."""


class Option(NamedTuple):
    """One way to add an effect; options of the same effect exclude each other."""

    key: str
    """Names this option among all."""
    effect: str
    parameters: tuple[FreeParameter, ...]
    least: float = 0.0
    """An effect none of whose parameters is as large is not worth naming."""


class Problem(Protocol):
    """The data of one stage and its simulated response."""

    @property
    def nuisance(self) -> tuple[FreeParameter, ...]:
        """What is fitted in every structure: scale, offset, initial conditions."""
        ...

    @property
    def options(self) -> tuple[Option, ...]:
        """What may be added."""
        ...

    @property
    def rich(self) -> tuple[str, ...]:
        """Keys of options that together explain much; the search also comes down from there. May be empty."""
        ...

    @property
    def block(self) -> IntArray:
        """(samples,) contiguous piece of the record that each residual belongs to; held out together."""
        ...

    @property
    def held(self) -> BoolArray:
        """(samples,) what is kept from the fit whose shrink is scored."""
        ...

    @property
    def noise(self) -> float:
        """Standard deviation of one sample's measurement noise, unit of the residual."""
        ...

    @property
    def timing_s(self) -> float:
        """How far the input's time stamps may be wrong together, s; widens the intervals of delays."""
        ...

    @property
    def accuracy_ratio(self) -> float:
        """How near a parameter comes to its true value when there is no noise, of that value."""
        ...

    @property
    def local(self) -> frozenset[str]:
        """Nuisance of one run of the record alone, such as where a flight began; known for held-out runs."""
        ...

    @property
    def horizons(self) -> tuple[Array, ...]:
        """(samples,) weights of what a search from nothing begins with, the shortest first; may be empty.

        Where motion runs away from a guess that is a little off, a record is fitted from its beginning on.
        """
        ...

    def guess(self, names: Sequence[str]) -> Mapping[str, float]:
        """Parameters of a structure read off the data by other means: one more start. May be empty."""
        ...

    def residuals(self, values: Sequence[Mapping[str, float]]) -> Array:
        """(sets, samples) measured minus simulated of several sets of parameters with the same names.

        An absent parameter means an absent effect.
        """
        ...
