"""The interface of a fit: free parameters, effect options, and the data and simulation of one stage.

A model structure is a set of effect options; each adds the parameters of one effect to the simulation.
"""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple, Protocol

import numpy as np

from machine.conventions import Array, BoolArray, IntArray


class FreeParameter(NamedTuple):
    """A parameter that is fitted, with its bounds; `low` is the smallest magnitude worth naming."""

    name: str
    unit: str
    low: float
    high: float
    starts: tuple[float, ...]
    """Start values of the fit; the first is the prior mean."""
    is_absent_at_high: bool = False
    """Whether the effect is absent at `high`."""
    is_absent_at_low: bool = True
    """Whether the effect is absent, or small, at a `low` that is not negative."""
    prior_sd: float = math.inf
    """Standard deviation of the prior about the first start value; infinite without one."""
    is_threshold: bool = False
    """Whether the response is piecewise constant in it, so that it has no gradient."""


class EffectOption(NamedTuple):
    """One way to model an effect."""

    key: str
    """Unique name."""
    effect: str
    parameters: tuple[FreeParameter, ...]
    least: float = 0.0
    """Smallest distance from `null` worth naming; an effect with all parameters nearer is insignificant."""
    null: float = 0.0
    """Value of its parameters at which it is absent."""
    least_difference: float = 0.0
    """Smallest difference of the first two parameters worth two of them; 0 for any."""
    stands_for: str = ""
    """Effect whose place it takes, and which it therefore excludes; empty for its own."""

    @property
    def place(self) -> str:
        """Options of the same place exclude each other."""
        return self.stands_for or self.effect

    @property
    def magnitudes(self) -> tuple[FreeParameter, ...]:
        """The parameters that may be 0, or else the first: without them the effect is absent.

        Others say when or where it acts; they may be sure while the magnitude is not.
        """
        return tuple(p for p in self.parameters if p.low <= 0.0) or self.parameters[:1]


class FitProblem(Protocol):
    """Measured data of one stage and its simulation."""

    @property
    def nuisance(self) -> tuple[FreeParameter, ...]:
        """Parameters of every structure: scale, offset, initial conditions."""
        ...

    @property
    def options(self) -> tuple[EffectOption, ...]:
        """Effect options that may be added."""
        ...

    @property
    def full_structure(self) -> tuple[str, ...]:
        """Keys of options with which backward elimination starts; may be empty."""
        ...

    @property
    def block(self) -> IntArray:
        """(samples,) number of the contiguous block of each residual; a block is held out as a whole."""
        ...

    @property
    def held_out_mask(self) -> BoolArray:
        """(samples,) samples kept from the fit on which the explained share is scored."""
        ...

    @property
    def noise(self) -> float:
        """Standard deviation of one sample's measurement noise, unit of the residual."""
        ...

    @property
    def timestamp_error_s(self) -> float:
        """Common error of the input's time stamps, s; widens the intervals of delays."""
        ...

    @property
    def simulation_error_ratio(self) -> float:
        """Relative error of a parameter without noise, from discretisation."""
        ...

    @property
    def run_nuisance(self) -> frozenset[str]:
        """Nuisance parameters of one run, such as a flight's initial state; refitted on held-out runs."""
        ...

    @property
    def prefix_weights(self) -> tuple[Array, ...]:
        """(samples,) weights of successively longer parts from the record's start; may be empty.

        These parts are fitted first where a slightly wrong start value makes the simulation diverge.
        """
        ...

    def initial_guess(self, names: Sequence[str]) -> Mapping[str, float]:
        """Start values of some parameters, estimated from the data by other means; may be empty."""
        ...

    def residuals(self, values: Sequence[Mapping[str, float]]) -> Array:
        """Measured minus simulated, (sets, samples), for several sets of parameters with the same names.

        An absent parameter means an absent effect.
        """
        ...


def mask_every_third_block(block: IntArray) -> BoolArray:
    """(samples,) whether a sample is in every third block, beginning with the second."""
    return np.isin(block, np.unique(block)[1::3])


def number_blocks(time_s: Array, seconds: float, run: IntArray) -> IntArray:
    """Number of the contiguous block of `seconds` within each run, (samples,)."""
    piece = np.floor((time_s - time_s[0]) / seconds)
    label = run * (np.max(piece) + 1.0) + piece
    return np.asarray(np.unique(label, return_inverse=True)[1], dtype=np.int64)
