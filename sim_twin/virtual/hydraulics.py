"""Hydraulics of the virtual machine at pressure level: pump, rail, orifices, chambers, actuators; batched.

Every actuator has two compressible chambers: [0] drives the joint positively, [1] negatively. All flows
into a chamber are written as conductance times pressure difference, with the conductance of the turbulent
orifice Q = K a sqrt(dp) taken at the last pressures; the chamber pressure then solves implicitly, so that
500 Hz is stable at any opening.
"""

from typing import Protocol

import numpy as np

from machine.conventions import Array
from machine.spec import MachineSpec
from sim_twin.virtual.sizing import PUMP_DROOP_PA, TANK_PRESSURE_PA, CylinderTriangle, size_machine
from sim_twin.virtual.spools import Spools
from sim_twin.virtual.units import MachineUnit, ThrowConditions

LAMINAR_PRESSURE_PA = 2.0e5
"""Pressure difference below which orifice flow is laminar, which keeps it smooth at zero."""
RAIL_VOLUME_M3 = 4.0e-3
DEAD_VOLUME_M3 = np.array([3.0e-3, 1.2e-3, 1.0e-3, 1.2e-3])
"""Volume of hoses and ports on each side; for the slew half of the motor circuit."""
CHECK_CONDUCTANCE_M3_PER_S_PA = 2.5e-9
"""Anti-cavitation check valve: 75 l/min at 5 bar."""
RELIEF_CONDUCTANCE_M3_PER_S_PA = 1.8e-9
"""Port relief valve: 220 l/min at 20 bar above its setting."""
PORT_RELIEF_PA = 38.0e6
LEAK_CONDUCTANCE_M3_PER_S_PA = np.array([6.0e-12, 1.0e-13, 1.0e-13, 1.0e-13])
"""Leakage across the piston; for the slew the motor's internal leakage, 9 l/min at 240 bar."""
AIR_PRESSURES_PA = (3.0e5, 13.0e5)
"""Free air softens the oil at low pressure: beta (p + a) / (p + b)."""
VISCOUS_PRESSURE_PA_S = np.array([6.0e5, 6.0e5, 6.0e5, 6.0e5])
"""Viscous friction as pressure per actuator speed (rad/s for the slew, m/s)."""
FRICTION_SPEED = np.array([0.01, 0.008, 0.008, 0.015])
"""Actuator speed at which Coulomb friction is fully developed, rad/s and m/s."""
CUSHION_STROKE_M = 0.05
CUSHION_MIN_RATIO = 0.08
STOP_STIFFNESS = np.array([0.0, 2.0e7, 1.0e7, 2.0e7])
"""Stiffness of end stops, N m/rad and N/m."""
STOP_DAMPING = np.array([0.0, 2.0e5, 3.0e4, 6.0e4])
START_PRESSURE_PA = 1.5e6
"""Pressure of the less loaded chamber of a machine at rest."""


class DriveFaults(Protocol):
    """Faults between command and force (sim_twin.faults.drive_faults)."""

    def drive_velocity(self, velocity_rad_m_per_s: Array, position_rad_m: Array) -> Array:
        """Joint velocities (N, 4) as the actuators have them."""
        ...

    def meter(self, opening_ratio: Array, position_rad_m: Array) -> None:
        """Change openings (2, N, 4) in place."""
        ...

    def regulate(
        self, from_rail: Array, to_tank: Array, pressure_pa: Array, rail_pa: Array, width: Array
    ) -> None:
        """Change conductances (2, N, 4) in place; `width` is the oil volume per joint motion."""
        ...

    def hold(self, torque: Array, position_rad_m: Array, velocity_rad_m_per_s: Array) -> None:
        """Change torques (N, 4) in place."""
        ...


class Hydraulics:
    """Pump, valves and actuators of N machines; one `step` per physics step.

    Attributes:
        pressure_pa: (2, N, 4) chamber pressures.
        rail_pa: (N, 1) supply pressure.
        spools: the valves.
    """

    def __init__(self, spec: MachineSpec, unit: MachineUnit, count: int, step_s: float) -> None:
        h = spec.hydraulics
        self._sizes = sizes = size_machine(spec)
        self._area = sizes.area_m2
        self._signed_area = sizes.area_m2[:, None, :] * np.array([1.0, -1.0])[:, None, None]
        # The slew motor has no stroke: its volumes are constant and it has no end cushions.
        strokes = np.array([0.0, 1.0, 1.0, 1.0])
        self._volume_area = sizes.area_m2[:, None, :] * strokes
        self._per_cushion = strokes / CUSHION_STROKE_M
        self._cushion_floor = np.where(strokes > 0.0, CUSHION_MIN_RATIO, 1.0)
        self._unit = unit
        self._triangle = CylinderTriangle((h.boom_cylinder, h.dipper_cylinder))
        self._low, self._high = spec.position_range_rad_m
        self._length_low, _ = self._triangle.length_and_lever(self._low[1:3])
        self.spools = Spools(unit, count, step_s)
        self.pressure_pa = np.full((2, count, 4), START_PRESSURE_PA)
        self.rail_pa = np.full((count, 1), unit.supply_pressure_pa)
        self._relief_pa = np.array([unit.slew_relief_pressure_pa] + [PORT_RELIEF_PA] * 3)
        self._valve_gain = np.stack(
            [unit.valve_gain_positive_ratio, unit.valve_gain_negative_ratio]
        )[:, None, :]
        viscous = VISCOUS_PRESSURE_PA_S * np.asarray(unit.viscous_friction_ratio)
        self._viscous = viscous * self._area[0]
        self._bulk_step = unit.bulk_modulus_pa * step_s
        self._rail_gain = step_s * unit.bulk_modulus_pa / RAIL_VOLUME_M3
        self._set_pa = unit.supply_pressure_pa
        self._pump_m3_per_s: float | Array = unit.pump_flow_m3_per_s
        self._pump_slope: float | Array = unit.pump_flow_m3_per_s / PUMP_DROOP_PA
        self._faults: DriveFaults | None = None
        self._allocate(count)

    def _allocate(self, count: int) -> None:
        one, both = (count, 4), (2, count, 4)
        self._lever, self._extension, self._speed = np.ones(one), np.zeros(one), np.zeros(one)
        self._friction, self._force, self._work = np.zeros(one), np.zeros(one), np.zeros(one)
        self._volume, self._cushion, self._soft = np.zeros(both), np.zeros(both), np.zeros(both)
        self._inlet, self._outlet = np.zeros(both), np.zeros(both)
        self._from_rail, self._to_tank, self._relief = (
            np.zeros(both),
            np.zeros(both),
            np.zeros(both),
        )
        self._inflow, self._gain_sum, self._both = np.zeros(both), np.zeros(both), np.zeros(both)
        self._is_lower = np.zeros(both, dtype=np.bool_)

    def wear(self, faults: DriveFaults, gain_ratio: Array, flow_ratio: Array) -> None:
        """Install faults; scale orifices (2, N, 4) and pump flows (N,)."""
        self._faults = faults
        self._valve_gain = self._valve_gain * gain_ratio
        self._pump_m3_per_s = self._pump_m3_per_s * flow_ratio
        self._pump_slope = self._pump_slope * flow_ratio

    def reset(self, position_rad_m: Array, load_torque: Array, conditions: ThrowConditions) -> None:
        """Start at rest at active positions (N, 4) with loads (N, 4) against positive motion, N m and N."""
        self.spools.reset(conditions)
        flow = conditions.flow_ratio * self._valve_gain
        self._inlet = self._sizes.inlet[:, None, :] * flow
        # The edge from chamber [0] to tank opens for negative motion and has that direction's gain.
        self._outlet = self._sizes.outlet[:, None, :] * flow[::-1]
        friction = np.asarray(self._unit.friction_pressure_pa) * self._area[0]
        self._friction = friction * conditions.friction_ratio
        self._geometry(position_rad_m)
        force = load_torque / self._lever
        both = START_PRESSURE_PA * self._area
        self.pressure_pa[0] = (both[1] + np.maximum(force, both[0] - both[1])) / self._area[0]
        self.pressure_pa[1] = (self.pressure_pa[0] * self._area[0] - force) / self._area[1]
        self.rail_pa[:] = self._unit.supply_pressure_pa

    def step(
        self, position_rad_m: Array, velocity_rad_m_per_s: Array, command_ratio: Array
    ) -> Array:
        """Advance one step; active positions, velocities, valve commands (N, 4) -> joint torque (N, 4)."""
        opening = self.spools.step(command_ratio)
        self._geometry(position_rad_m)
        speed, faults = self._speed, self._faults
        if faults is None:
            np.multiply(velocity_rad_m_per_s, self._lever, out=speed)
            self._conduct(opening)
        else:
            faults.meter(opening, position_rad_m)
            driven = faults.drive_velocity(velocity_rad_m_per_s, position_rad_m)
            np.multiply(driven, self._lever, out=speed)
            self._conduct(opening)
            width = self._area[:, None, :] * self._lever
            faults.regulate(self._from_rail, self._to_tank, self.pressure_pa, self.rail_pa, width)
        self._step_rail()
        self._step_chambers(speed)
        force, work = self._force, self._work
        np.multiply(self.pressure_pa[0], self._area[0], out=force)
        np.multiply(self.pressure_pa[1], self._area[1], out=work)
        force -= work
        np.multiply(speed, 1.0 / FRICTION_SPEED, out=work)
        np.tanh(work, out=work)
        work *= self._friction
        force -= work
        np.multiply(speed, self._viscous, out=work)
        force -= work
        force *= self._lever
        np.maximum(position_rad_m, self._low, out=work)
        np.minimum(work, self._high, out=work)
        np.subtract(position_rad_m, work, out=work)
        if work.any():
            force -= STOP_STIFFNESS * work
            force -= STOP_DAMPING * velocity_rad_m_per_s * (work != 0.0)
        if faults is not None:
            faults.hold(force, position_rad_m, velocity_rad_m_per_s)
        return force

    def _conduct(self, opening_ratio: Array) -> None:
        """Conductances Q / dp of rail edges, tank edges, checks and reliefs at the last pressures."""
        pressure, work, inlet, tank = self.pressure_pa, self._both, self._from_rail, self._to_tank
        np.subtract(self.rail_pa, pressure, out=work)
        np.greater(work, 0.0, out=self._is_lower)
        work += LAMINAR_PRESSURE_PA
        np.maximum(work, LAMINAR_PRESSURE_PA, out=work)
        np.sqrt(work, out=work)
        np.multiply(self._inlet, opening_ratio, out=inlet)
        inlet /= work
        # Load-holding checks prevent flow from a chamber to the rail.
        inlet *= self._is_lower
        np.subtract(pressure, TANK_PRESSURE_PA, out=work)
        np.less(work, 0.0, out=self._is_lower)
        np.abs(work, out=work)
        work += LAMINAR_PRESSURE_PA
        np.sqrt(work, out=work)
        np.multiply(self._outlet, opening_ratio[::-1], out=tank)
        tank *= self._cushion
        tank /= work
        np.multiply(self._is_lower, CHECK_CONDUCTANCE_M3_PER_S_PA, out=work)
        tank += work
        np.greater(pressure, self._relief_pa, out=self._is_lower)
        np.multiply(self._is_lower, RELIEF_CONDUCTANCE_M3_PER_S_PA, out=self._relief)

    def _step_chambers(self, speed: Array) -> None:
        """Implicit pressures: p' = (p + k (sum G p_source - A w)) / (1 + k sum G), k = dt beta / V."""
        pressure, inflow, gain, work = self.pressure_pa, self._inflow, self._gain_sum, self._both
        np.add(pressure, AIR_PRESSURES_PA[0], out=self._soft)
        np.add(pressure, AIR_PRESSURES_PA[1], out=work)
        work *= self._volume
        self._soft /= work
        self._soft *= self._bulk_step
        np.multiply(self._from_rail, self.rail_pa, out=inflow)
        np.multiply(self._to_tank, TANK_PRESSURE_PA, out=work)
        inflow += work
        np.multiply(self._relief, self._relief_pa, out=work)
        inflow += work
        np.multiply(pressure[::-1], LEAK_CONDUCTANCE_M3_PER_S_PA, out=work)
        inflow += work
        np.multiply(self._signed_area, speed, out=work)
        inflow -= work
        inflow *= self._soft
        inflow += pressure
        np.add(self._from_rail, self._to_tank, out=gain)
        gain += self._relief
        gain += LEAK_CONDUCTANCE_M3_PER_S_PA
        gain *= self._soft
        gain += 1.0
        np.divide(inflow, gain, out=pressure)
        np.maximum(pressure, 0.0, out=pressure)

    def pump_flow_m3_per_s(self) -> Array:
        """Pump flow (N,), m3/s."""
        wanted = self._pump_slope * (self._set_pa - self.rail_pa[:, 0])
        return np.minimum(wanted, self._pump_m3_per_s)

    def _step_rail(self) -> None:
        """Implicit rail pressure; the pump delivers min(full flow, slope (set - rail))."""
        gain, slope = self._rail_gain, self._pump_slope
        taken = gain * np.einsum("snj->n", self._from_rail)
        back = gain * np.einsum("snj,snj->n", self._from_rail, self.pressure_pa)
        back += self.rail_pa[:, 0]
        limited = (back + gain * self._pump_m3_per_s) / (1.0 + taken)
        back += gain * slope * self._set_pa
        taken += 1.0 + gain * slope
        back /= taken
        np.minimum(back, limited, out=self.rail_pa[:, 0])

    def _geometry(self, position_rad_m: Array) -> None:
        """Lever arms, chamber volumes and end cushions at active positions (N, 4)."""
        length, lever = self._triangle.length_and_lever(position_rad_m[:, 1:3])
        np.abs(lever, out=self._lever[:, 1:3])
        extension, stroke, volume = self._extension, self._sizes.stroke_m, self._volume
        length -= self._length_low
        np.abs(length, out=extension[:, 1:3])
        np.subtract(position_rad_m[:, 3], self._low[3], out=extension[:, 3])
        np.maximum(extension, 0.0, out=extension)
        np.minimum(extension, stroke, out=volume[0])
        np.subtract(stroke, volume[0], out=volume[1])
        np.multiply(volume, self._per_cushion, out=self._cushion)
        self._cushion += self._cushion_floor
        np.minimum(self._cushion, 1.0, out=self._cushion)
        volume *= self._volume_area
        volume += DEAD_VOLUME_M3
