"""Optional abilities of simulated plants beyond `SimulatedDriver`, which campaigns use."""

from typing import Protocol, runtime_checkable

from machine.conventions import Array, BoolArray


@runtime_checkable
class Freezable(Protocol):
    """A plant that can stop simulating machines (N,) whose throw has ended."""

    def freeze(self, frozen: BoolArray) -> None:
        """Stop moving these machines until the next reset."""
        ...


@runtime_checkable
class HasSurface(Protocol):
    """A plant whose loads can land above or below ground level."""

    def set_surface_height(self, height_m: Array) -> None:
        """Height (N,) of the surface, from the next release on."""
        ...


@runtime_checkable
class KnowsTruth(Protocol):
    """A plant that provides true impacts besides surveyed ones."""

    def true_impact_m(self) -> Array:
        """True impact points (N, 3), NaN before the impact."""
        ...


@runtime_checkable
class PredictsImpact(Protocol):
    """A plant that predicts the impact at the release."""

    def predicted_impact(self) -> tuple[Array, Array]:
        """True impact points (N, 3) and flight times (N,) of released loads; NaN otherwise."""
        ...
