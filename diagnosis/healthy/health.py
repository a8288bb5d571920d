"""What is known of healthy machines: filters, noise and scatter."""

from typing import NamedTuple

from diagnosis.healthy.filters import HealthyModel, load_healthy
from diagnosis.healthy.noise import NoiseModel, load_noise


class Health(NamedTuple):
    """A healthy machine, of the type or this very one."""

    filters: HealthyModel
    noise: NoiseModel
    is_own: bool = False
    """Learned from throws of this very machine as well: there is nothing left to adapt."""


def load_health() -> Health:
    """The type's, as calibrated."""
    return Health(load_healthy(), load_noise())
