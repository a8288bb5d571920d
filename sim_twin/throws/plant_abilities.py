"""What a simulated plant may be able to do beyond `SimulatedDriver`; campaigns use it where it is there."""

from typing import Protocol, runtime_checkable

from machine.conventions import Array, BoolArray


@runtime_checkable
class Freezable(Protocol):
    """A plant that can spare the work for machines (N,) whose throw is over."""

    def freeze(self, frozen: BoolArray) -> None:
        """Stop moving these machines until the next reset."""
        ...


@runtime_checkable
class HasSurface(Protocol):
    """A plant on which loads can land above or below the machine's ground."""

    def set_surface_height(self, height_m: Array) -> None:
        """Height (N,) of the surface, from the next release on."""
        ...


@runtime_checkable
class KnowsTruth(Protocol):
    """A plant that knows where loads really came down, apart from its survey."""

    def true_impact_m(self) -> Array:
        """True impact points (N, 3), NaN before the impact."""
        ...


@runtime_checkable
class PredictsImpact(Protocol):
    """A plant that can tell where a load comes down as soon as it has left the gripper."""

    def predicted_impact(self) -> tuple[Array, Array]:
        """True impact points (N, 3) and flight times (N,) of the loads that have left; NaN otherwise."""
        ...
