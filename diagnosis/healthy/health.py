"""The model of a healthy machine: filters, noise and scatter."""

from collections.abc import Mapping
from typing import NamedTuple

from diagnosis.healthy.filters import HealthyModel, load_healthy
from diagnosis.healthy.noise import NoiseModel, load_noise
from sim_twin.twin.profile import TwinProfile


class Health(NamedTuple):
    """Model of a healthy machine: of the type, or of this machine."""

    filters: HealthyModel
    noise: NoiseModel
    profile: TwinProfile | None = None
    """The twin profile with what reference throws show of this machine's own deviations.
    None for the model of the type."""
    replay_gap_m: Mapping[str, float] = {}
    """Impact gap of the reference throws against the twin as it was given, by mode, root mean square."""

    @property
    def is_own(self) -> bool:
        """Whether it was also learned from throws of this machine."""
        return self.profile is not None


def load_health() -> Health:
    """The calibrated model of the type."""
    return Health(load_healthy(), load_noise())
