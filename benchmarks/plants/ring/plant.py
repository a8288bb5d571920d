"""The plant as a driver: `downrange record --plant benchmarks.plants.ring.plant:Ring`."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.plants.compiled_plant import CompiledPlant
from benchmarks.plants.ring.effects import apply, parse_effects
from benchmarks.plants.ring.parameters import nominal, vary_day, vary_unit


class Ring(CompiledPlant):
    """Machines of the plant `ring`; its options are in ``RING_OPTIONS``."""

    source = Path(__file__).with_name("ring.c")
    options_variable = "RING_OPTIONS"
    survey_sd_m = 0.02

    def _parameters(
        self,
        sizes: Mapping[str, int],
        unit_seed: int,
        day_seed: int,
        effects: Sequence[Mapping[str, Any]],
    ) -> dict[str, Any]:
        wrong = parse_effects(effects)
        parameters = nominal(sizes)
        vary_unit(parameters, unit_seed)
        vary_day(parameters, unit_seed, day_seed)
        for effect in wrong:
            apply(effect, parameters)
        return parameters

    def _time(self) -> float:
        return self._now_ns * 1e-9
