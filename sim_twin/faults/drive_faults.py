"""Faults of valves and actuators of the virtual machine, between command and joint torque.

They act where the real fault acts: on the command, the metering edges, the flow or the force.
"""

import numpy as np

from machine.conventions import Array, BoolArray
from machine.spec import MachineSpec
from sim_twin.faults.fault import EffectSizes
from sim_twin.faults.unlisted_valve_faults import UnlistedValveFaults
from sim_twin.virtual.hydraulics import Hydraulics
from sim_twin.virtual.sizing import TANK_PRESSURE_PA

STANDING_RAD_M_PER_S = 0.004
"""Slower than this a joint counts as standing."""
HOLD_DAMPING_RATIO = 0.5
HOLD_STIFFNESS_RATIO = 0.05
"""Of what one step of a joint's least inertia can bear: a stuck joint yields by a tenth of a milliradian."""


class DriveLimits:
    """What the drive effects must know of the arm: largest gravity moments, least inertias."""

    def __init__(self, moment: Array, inertia: Array) -> None:
        self.moment = moment
        """(4,) N m, N; the slew's is infinite, because gravity does not load it."""
        self.inertia = inertia
        """(4,) kg m2, kg"""


class FaultyDrive:
    """Valves and actuators of N machines; all calls once a physics step, arrays changed in place."""

    def __init__(
        self, sizes: EffectSizes, spec: MachineSpec, limits: DriveLimits, step_s: float
    ) -> None:
        self._step_s, self._limits = step_s, limits
        self._dead_time_s = sizes.joints("valve_dead_time", "extra_dead_time_s")
        self._lag_s = sizes.joints("valve_lag", "extra_lag_s")
        self._band = self._both(sizes, "valve_dead_band")
        self._gain = 1.0 + self._both(sizes, "valve_gain")
        self._play = sizes.joints("valve_hysteresis", "half_width_ratio")
        self._flow_ratio = 1.0 - sizes.machine("pump_flow_sharing", "shortage_ratio")
        speed = np.stack(
            [spec.limits.speed_positive_rad_m_per_s, spec.limits.speed_negative_rad_m_per_s]
        )
        self._rated = speed[:, None, :]
        reduction = sizes.joints("speed_limit", "reduction_ratio")
        self._cap = np.where(reduction > 0.0, (1.0 - reduction) * self._rated, np.inf)
        self._is_capped = bool((reduction > 0.0).any())
        self._loss = sizes.joints("load_dependent_speed", "loss_ratio")
        self._gap = sizes.joints("backlash", "gap_rad_m")
        self._breakaway = sizes.joints("stiction", "breakaway_rad_m_per_s")
        self._load_torque = np.zeros((sizes.count, 4))
        self._holds = bool((self._gap > 0.0).any() or (self._breakaway > 0.0).any())
        self._unlisted = (
            UnlistedValveFaults(sizes, step_s) if UnlistedValveFaults.is_in(sizes) else None
        )
        one = (sizes.count, 4)
        self._steady = np.zeros(one)
        self._slack, self._anchor = np.zeros(one), np.zeros(one)
        self._stuck = np.zeros(one, dtype=np.bool_)
        self._free = np.zeros(one, dtype=np.bool_)

    @staticmethod
    def _both(sizes: EffectSizes, effect: str) -> Array:
        return np.stack(
            [sizes.joints(effect, "positive_ratio"), sizes.joints(effect, "negative_ratio")]
        )

    def fit(self, hydraulics: Hydraulics, load_torque: Array) -> None:
        """Give worn parts to the valves and the pump, once, when the machine is built.

        `load_torque` (N, 4) is a live view: what keeps the joints where they are, N m, N.
        """
        self._load_torque = load_torque
        hydraulics.spools.wear(self._dead_time_s, self._lag_s, self._band, self._play)
        hydraulics.wear(self, self._gain, self._flow_ratio)

    def reset(self, position_rad_m: Array, seed: int) -> None:
        """Everything stands, teeth and pins touching on the side that carries the load."""
        self._stuck = self._breakaway > 0.0
        self._free[:] = False
        self._slack[:] = np.where(self._load_torque >= 0.0, 0.5, -0.5) * self._gap
        self._anchor[:] = position_rad_m
        if self._unlisted is not None:
            self._unlisted.reset(position_rad_m, seed)

    def command(self, command_ratio: Array, position_rad_m: Array) -> Array:
        """What reaches the valves (N, 4) of what was commanded."""
        if self._unlisted is None:
            return command_ratio
        return self._unlisted.command(command_ratio, position_rad_m)

    def meter(self, opening_ratio: Array, position_rad_m: Array) -> None:
        """Change openings (2, N, 4) in place by load, and note the speed that they stand for."""
        load_ratio = self._load_torque / self._limits.moment
        load = self._loss * load_ratio
        opening_ratio[0] *= np.maximum(1.0 - load, 0.0)
        opening_ratio[1] *= np.maximum(1.0 + load, 0.0)
        if self._unlisted is not None:
            self._unlisted.meter(opening_ratio, position_rad_m, load_ratio)
        rated = self._rated
        np.subtract(opening_ratio[0] * rated[0], opening_ratio[1] * rated[1], out=self._steady)

    def regulate(
        self, from_rail: Array, to_tank: Array, pressure_pa: Array, rail_pa: Array, width: Array
    ) -> None:
        """Flow regulators in all edges: no more oil than the capped joint speed takes.

        Args:
            from_rail: (2, N, 4) conductances, m3/s/Pa, changed in place.
            to_tank: (2, N, 4) likewise.
            pressure_pa: (2, N, 4) of the chambers.
            rail_pa: (N, 1).
            width: (2, N, 4) oil a unit of joint motion, m3/rad and m2.
        """
        if not self._is_capped:
            return
        allowed = width * self._cap
        flow = from_rail * np.maximum(rail_pa - pressure_pa, 0.0)
        from_rail *= np.minimum(1.0, allowed / np.maximum(flow, 1e-12))
        # Chamber [0] empties with negative motion. Below tank pressure the check valve is the way in.
        head = pressure_pa - TANK_PRESSURE_PA
        flow = to_tank * np.maximum(head, 0.0)
        cut = np.minimum(1.0, width * self._cap[::-1] / np.maximum(flow, 1e-12))
        to_tank *= np.where(head > 0.0, cut, 1.0)

    def drive_velocity(self, velocity_rad_m_per_s: Array, position_rad_m: Array) -> Array:
        """Joint velocities (N, 4) as the actuators have them: in a gap they run alone."""
        if not self._holds:
            return velocity_rad_m_per_s
        self._stick(velocity_rad_m_per_s, position_rad_m)
        self._cross_gaps(velocity_rad_m_per_s, position_rad_m)
        return np.where(self._free, self._steady, velocity_rad_m_per_s)

    def _stick(self, velocity: Array, position: Array) -> None:
        moving = np.abs(self._steady) > self._breakaway
        stops = ~self._stuck & ~moving & (np.abs(velocity) < STANDING_RAD_M_PER_S)
        self._anchor = np.where(stops, position, self._anchor)
        self._stuck = (self._stuck | stops) & ~moving & (self._breakaway > 0.0)

    def _cross_gaps(self, velocity: Array, position: Array) -> None:
        half = 0.5 * self._gap
        side = np.sign(self._slack)
        leaves: BoolArray = (
            (half > 0.0)
            & ~self._free
            & (side * self._steady < -STANDING_RAD_M_PER_S)
            & (side * velocity < STANDING_RAD_M_PER_S)
        )
        self._anchor = np.where(leaves, position, self._anchor)
        self._free |= leaves
        self._slack += np.where(self._free, self._steady * self._step_s, 0.0)
        arrived = self._free & (np.abs(self._slack) >= half)
        self._slack = np.clip(self._slack, -half, half)
        self._free &= ~arrived

    def hold(self, torque: Array, position_rad_m: Array, velocity_rad_m_per_s: Array) -> None:
        """Replace torques (N, 4) of joints that stick or hang in a gap by what keeps them there."""
        if not self._holds:
            return
        unit = self._limits.inertia / self._step_s
        held = self._load_torque - HOLD_DAMPING_RATIO * unit * velocity_rad_m_per_s
        held -= HOLD_STIFFNESS_RATIO * unit / self._step_s * (position_rad_m - self._anchor)
        np.copyto(torque, held, where=self._stuck | self._free)
