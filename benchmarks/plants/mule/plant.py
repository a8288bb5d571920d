"""The plant as a driver: `downrange record --plant benchmarks.plants.mule.plant:Mule`."""

import ctypes
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.plants.compiled_plant import CompiledPlant
from benchmarks.plants.mule.effects import apply, parse_effects
from benchmarks.plants.mule.parameters import nominal, vary_day, vary_unit

MILLISECOND_NS = 1_000_000


class Mule(CompiledPlant):
    """Machines of the plant `mule`; its options are in ``MULE_OPTIONS``."""

    source = Path(__file__).with_name("mule.c")
    standard = "gnu11"
    options_variable = "MULE_OPTIONS"
    time = ctypes.c_int64
    time_unit_ns = 1e6
    survey_sd_m = 0.015

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

    def _time(self) -> int:
        return self._now_ns // MILLISECOND_NS
