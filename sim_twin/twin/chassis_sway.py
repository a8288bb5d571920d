"""Compliant chassis: tilts under the arm's weight and inertia, on springs with damping.

Two small angles about the slew axis's foot; the counterweight is balanced by levelling. The arm's drives are
stiff, so that its motion relative to the machine is independent of the sway.
"""

import numpy as np

from machine.conventions import (
    ACTIVE_COUNT,
    CONTROL_PERIOD_S,
    GRAVITY_M_PER_S2,
    Array,
)
from machine.spec import MachineSpec
from sim_twin.lag import lag_matrices
from sim_twin.rigid_body.arm_load import largest_tipping_moment, tipping_ratio

BASE_INERTIA_KG_M2 = (24_000.0, 36_000.0)
"""Moments of inertia of chassis and upper carriage about ground level, roll and pitch: 5.3 t as a box of
4.6 x 2.6 x 1.1 m at 0.85 m, and 4.7 t at 1.85 m (docs/machine.md, A)."""
ARM_INERTIA_SHARE_RATIO = 1.25
"""Arm's moment of inertia relative to that of its mass at its centre of mass: links spread along a line."""
DAMPING_RATIO = 0.3
"""Damping relative to critical: legs on soil (assumed)."""
MIN_SIZE_RAD = 1e-5
"""Lower bound of the tilt from which the stiffness is computed; the static tilt is not affected."""


class ChassisSway:
    """Tilts of N machines as rotation vectors (N, 3), frame `machine`; z is 0."""

    def __init__(self, spec: MachineSpec, pitch_rad: Array) -> None:
        """`pitch_rad` (N,): tilt under the arm's largest gravity moment."""
        self._spec, self._size = spec, pitch_rad
        self._largest = GRAVITY_M_PER_S2 * largest_tipping_moment(spec)
        none = np.zeros((pitch_rad.size, 3))
        self.lean_rad, self.rate_rad_per_s, self.change_rad_per_s2 = none, none.copy(), none.copy()
        self._momentum: Array | None = None

    def settled(self, position: Array) -> Array:
        """Static tilts (N, 3) of machines with joints (N, 6) at rest."""
        return self._size[:, None] * tipping_ratio(self._spec, position[:, :ACTIVE_COUNT])

    def start(self, position: Array) -> None:
        """Start at rest in static equilibrium."""
        self.lean_rad = self.settled(position)
        self.rate_rad_per_s = np.zeros_like(self.lean_rad)
        self.change_rad_per_s2 = np.zeros_like(self.lean_rad)
        self._momentum = None

    def step(self, arm_kg: Array, centre: Array, velocity: Array, spin: Array) -> None:
        """Advance by one tick.

        Args:
            arm_kg: (N,) mass of the arm with gripper and load.
            centre: (N, 3) its centre of mass, frame `machine`.
            velocity: (N, 3) of that.
            spin: (N, 3) its angular momentum about it, kg m2/s.
        """
        weight = arm_kg[:, None] * GRAVITY_M_PER_S2
        moment = weight * np.stack([-centre[:, 1], centre[:, 0]], axis=-1)
        momentum = (spin + arm_kg[:, None] * np.cross(centre, velocity))[:, :2]
        if self._momentum is not None:
            moment -= (momentum - self._momentum) / CONTROL_PERIOD_S
        self._momentum = momentum
        away = np.stack([centre[:, 1], centre[:, 0]], axis=-1) ** 2 + centre[:, 2:] ** 2
        inertia = BASE_INERTIA_KG_M2 + ARM_INERTIA_SHARE_RATIO * arm_kg[:, None] * away
        size = np.maximum(self._size, MIN_SIZE_RAD)[:, None]
        frequency = np.sqrt(self._largest / (size * inertia))
        damping = np.full(frequency.shape, DAMPING_RATIO)
        a11, a12, a21, a22 = lag_matrices(frequency, damping, CONTROL_PERIOD_S)
        rest = self._size[:, None] * moment / self._largest
        error, slope = self.lean_rad[:, :2] - rest, self.rate_rad_per_s[:, :2] / frequency
        lean, rate = np.zeros_like(self.lean_rad), np.zeros_like(self.lean_rad)
        lean[:, :2] = rest + a11 * error + a12 * slope
        rate[:, :2] = frequency * (a21 * error + a22 * slope)
        self.change_rad_per_s2 = (rate - self.rate_rad_per_s) / CONTROL_PERIOD_S
        self.lean_rad, self.rate_rad_per_s = lean, rate
