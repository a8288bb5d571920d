"""The model of a healthy machine: filters, noise and scatter."""

from typing import NamedTuple

from diagnosis.healthy.filters import HealthyModel, load_healthy
from diagnosis.healthy.noise import NoiseModel, load_noise


class Health(NamedTuple):
    """Model of a healthy machine: of the type, or of this machine."""

    filters: HealthyModel
    noise: NoiseModel
    is_own: bool = False
    """Whether it was also learned from throws of this machine; then it is not adapted further."""


def load_health() -> Health:
    """The calibrated model of the type."""
    return Health(load_healthy(), load_noise())
