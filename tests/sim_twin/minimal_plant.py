"""A simulated machine with what docs/plants.md asks for, and nothing that is optional."""

from machine.calibration import nominal_calibration
from machine.spec import load_spec
from sim_twin.twin.profile import nominal_profile
from sim_twin.twin.twin import Twin


class MinimalPlant:
    """The nominal twin behind the methods of `runtime.driver.SimulatedDriver` alone."""

    def __init__(self, *, count: int, unit_seed: int) -> None:
        spec = load_spec()
        profile = nominal_profile(spec)
        self._twin = Twin(
            count=count, profile=profile, calibration=nominal_calibration(spec), seed=unit_seed
        )
        self.count = count
        for name in ("now_ns", "advance", "read", "write", "load", "close", "reset", "collided"):
            setattr(self, name, getattr(self._twin, name))
