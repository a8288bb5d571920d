"""Sizes of the virtual machine's actuators and valves, from the machine's spec and its speed limits."""

from dataclasses import dataclass

import numpy as np

from machine.conventions import Array
from machine.spec import CylinderSpec, MachineSpec

TANK_PRESSURE_PA = 5.0e5
"""Back pressure of the return line, which supplies the anti-cavitation checks."""
PUMP_DROOP_PA = 2.0e6
"""Pressure range over which the pump's compensator reduces full flow to zero."""
SIZING_LOAD = np.array([2.0e3, 99.0e3, 32.0e3, -6.9e3])
"""Actuator load (N m, N) against positive motion at 5.8 m reach; 55 kN m at the boom (docs/machine.md)."""
SIZING_FRICTION = np.array([3.0e3, 10.0e3, 8.0e3, 5.5e3])
"""Actuator friction (N m, N) at those speeds."""
SIZING_POSITION_RAD_M = np.array([0.0, 0.5, 0.0, 0.5])


class CylinderTriangle:
    """Length and lever arm of the boom's and the dipper's cylinder, from the law of cosines."""

    def __init__(self, cylinders: tuple[CylinderSpec, CylinderSpec]) -> None:
        base = np.array([c.base_xz_m for c in cylinders])
        rod = np.array([c.rod_xz_m for c in cylinders])
        self._sum = (base**2).sum(1) + (rod**2).sum(1)
        self._product = 2.0 * np.hypot(*base.T) * np.hypot(*rod.T)
        self._phase = np.arctan2(rod[:, 1], rod[:, 0]) - np.arctan2(base[:, 1], base[:, 0])

    def length_and_lever(self, angle_rad: Array) -> tuple[Array, Array]:
        """Pin-to-pin length (N, 2), m, and its derivative by the angle (N, 2), m/rad."""
        angle = angle_rad + self._phase
        length = np.sqrt(self._sum - self._product * np.cos(angle))
        return length, 0.5 * self._product * np.sin(angle) / length


@dataclass(frozen=True, slots=True)
class Sizes:
    """Actuator sizes and valve edges of the machine type."""

    area_m2: Array
    """(2, 4) piston area of both chambers; m3/rad for the slew."""
    stroke_m: Array
    """(4,)"""
    inlet: Array
    """(2, 4) K of the edge rail -> chamber, full open, m3/s/sqrt(Pa); [0] opens in the positive direction."""
    outlet: Array
    """(2, 4) K of the edge chamber -> tank; [0], of the positive chamber, opens in the negative one."""


def size_machine(spec: MachineSpec) -> Sizes:
    """Actuator areas from the spec; valve edges such that full valves give about the speed limits.

    Both edges are equal where the load is small or opposes the motion. Boom down and dipper in, which the
    load drives, are metered out such that the driving side keeps 5 bar at the speed limit.
    """
    h = spec.hydraulics
    bore = np.array([h.boom_cylinder.bore_m, h.dipper_cylinder.bore_m, h.telescope_bore_m])
    rod = np.array([h.boom_cylinder.rod_m, h.dipper_cylinder.rod_m, h.telescope_rod_m])
    piston, ring = np.pi / 4.0 * bore**2, np.pi / 4.0 * (bore**2 - rod**2)
    area = np.empty((2, 4))
    area[:, 0] = h.slew_displacement_m3_per_rad
    # The dipper's cylinder shortens when the joint opens: its annulus side drives positively.
    area[0, 1:] = piston[0], ring[1], piston[2]
    area[1, 1:] = ring[0], piston[1], ring[2]
    low, high = spec.position_range_rad_m
    triangle = CylinderTriangle((h.boom_cylinder, h.dipper_cylinder))
    ends, _ = triangle.length_and_lever(np.stack([low[1:3], high[1:3]]))
    stroke = np.array([1.0, *np.abs(ends[1] - ends[0]), high[3] - low[3]])
    _, lever = triangle.length_and_lever(SIZING_POSITION_RAD_M[1:3])
    ratio = np.array([1.0, *np.abs(lever), 1.0])
    speed = np.stack(
        [spec.limits.speed_positive_rad_m_per_s, spec.limits.speed_negative_rad_m_per_s]
    )
    speed = speed * ratio
    rail = h.supply_pressure_pa - 0.9 * PUMP_DROOP_PA
    inlet, outlet = np.empty((2, 4)), np.empty((2, 4))
    for side, sign in ((0, 1.0), (1, -1.0)):
        into, out = area[side], area[1 - side]
        drive = rail * into - TANK_PRESSURE_PA * out - sign * SIZING_LOAD - SIZING_FRICTION
        edge = speed[side] * np.sqrt((into**3 + out**3) / drive)
        inlet[side], outlet[1 - side] = edge, edge
    for joint in (1, 2):
        filled = TANK_PRESSURE_PA
        weight = SIZING_LOAD[joint] - SIZING_FRICTION[joint]
        driven = (weight + filled * area[1, joint]) / area[0, joint]
        inlet[1, joint] = area[1, joint] * speed[1, joint] / np.sqrt(rail - filled)
        outlet[0, joint] = area[0, joint] * speed[1, joint] / np.sqrt(driven - TANK_PRESSURE_PA)
    return Sizes(area, stroke, inlet, outlet)
