"""Effects on the free joints and what hangs from them: friction, masses, lengths, hoses.

Masses and lengths go into the fields of each machine's MuJoCo model. Forces are returned to the twin, which
applies them every tick.
"""

from typing import Any

import numpy as np

from machine.conventions import Array
from sim_twin.effects.arrays import EffectArrays
from sim_twin.rigid_body.model import twin_model

LEAST_MASS_RATIO = 0.1
"""Of a nominal mass or inertia, which several effects together leave at least."""


def loaded_mass_kg(nominal_kg: Array | float, extra_kg: Array) -> Array:
    """Mass (N,) of a load with another mass than the nominal one; never negative."""
    return np.maximum(nominal_kg + extra_kg, LEAST_MASS_RATIO * np.asarray(nominal_kg))


class BodyEffects:
    """Effects of the stage `swing`."""

    def __init__(self, arrays: EffectArrays) -> None:
        """Look up what any of the machines has."""
        get = arrays.get
        self._viscous = get("passive_viscous_friction", "extra_viscous_per_s")
        self._coulomb = get("passive_coulomb_friction", "extra_coulomb_rad_per_s2")
        self._stiffness = get("hose_stiffness", "stiffness_per_s2")
        self._length = get("gripper_length", "extra_length_m")
        self._inertia = get("gripper_inertia", "extra_inertia_ratio")
        self._mass = get("payload_mass", "extra_mass_kg")
        self.offset_m: Array | None = None
        """(N, 3) of the load from the nominal grip centre, gripper frame."""
        if arrays.has("payload_offset") or self._length is not None:
            x, y = (arrays.filled("payload_offset", f"offset_{axis}_m") for axis in "xy")
            self.offset_m = np.stack([x, y, -arrays.filled("gripper_length", "extra_length_m")], -1)

    def change_models(self, batch: Any) -> None:
        """Write masses, lengths and inertias into the models of a `mujoco.batch.Batch`."""
        model, _ = twin_model()
        gripper, load = model.body("gripper").id, model.body("payload").id
        if self.offset_m is not None:
            batch.expand("body_pos")[:, load] += self.offset_m
        if self._length is not None:
            batch.expand("body_ipos")[:, gripper, 2] -= self._length
        if self._inertia is not None:
            ratio = np.maximum(1.0 + self._inertia, LEAST_MASS_RATIO)
            batch.expand("body_inertia")[:, gripper] *= ratio[:, None]
        if self._mass is not None:
            mass = batch.expand("body_mass")
            # A heavier load of the same size and make.
            loaded_kg = loaded_mass_kg(mass[:, load], self._mass)
            batch.expand("body_inertia")[:, load] *= (loaded_kg / mass[:, load])[:, None]
            mass[:, load] = loaded_kg
        if self.offset_m is not None or self._inertia is not None or self._mass is not None:
            batch.set_const()

    def friction(self, viscous_per_s: Array, coulomb_rad_per_s2: Array) -> tuple[Array, Array]:
        """Viscous and dry friction of both free joints, (2,) of the profile to (N, 2)."""
        viscous, coulomb = viscous_per_s, coulomb_rad_per_s2
        if self._viscous is not None:
            viscous = np.maximum(viscous + self._viscous[:, None], 0.0)
        if self._coulomb is not None:
            coulomb = np.maximum(coulomb + self._coulomb[:, None], 0.0)
        return viscous, coulomb

    def hose_acceleration(self, free_position_rad: Array, rest_rad: Array) -> Array | None:
        """Angular acceleration (N, 2) by which the hoses pull the free joints (N, 2) back."""
        if self._stiffness is None:
            return None
        return self._stiffness[:, None] * (rest_rad - free_position_rad)
