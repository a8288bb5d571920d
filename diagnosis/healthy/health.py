"""What is known of healthy machines: filters, noise and scatter."""

from typing import NamedTuple

from diagnosis.healthy.filters import HealthyModel, load_healthy
from diagnosis.healthy.noise import NoiseModel, load_noise
from sim_twin.effects.effect import Effect
from sim_twin.twin.profile import TwinProfile


class Health(NamedTuple):
    """A healthy machine, of the type or this very one."""

    filters: HealthyModel
    noise: NoiseModel
    is_own: bool = False
    """Learned from throws of this very machine as well: there is nothing left to adapt."""
    home: tuple[Effect, ...] = ()
    """What this machine is off its twin by effects that bend. The twin is simulated there, and `noise` tells
    of what is off beside it."""

    def at_home(self, profile: TwinProfile) -> TwinProfile:
        """The twin as this machine is known to be while it is healthy."""
        return profile.model_copy(update={"effects": (*profile.effects, *self.home)})


def load_health() -> Health:
    """The type's, as calibrated."""
    return Health(load_healthy(), load_noise())
