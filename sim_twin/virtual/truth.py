"""True state of the virtual machine, never for its control."""

from dataclasses import dataclass

from machine.conventions import Array, IntArray


@dataclass(frozen=True, slots=True)
class PlantTruth:
    """True state of N machines, frame `machine`."""

    joint_position_rad_m: Array
    """(N, 6)"""
    joint_velocity_rad_m_per_s: Array
    """(N, 6)"""
    ball_position_m: Array
    """(N, 3) centre of the load: in the gripper, in flight, or at its impact."""
    ball_velocity_m_per_s: Array
    release_t_mono_ns: IntArray
    """(N,) 0 = still held."""
    release_position_m: Array
    release_velocity_m_per_s: Array
    impact_t_mono_ns: IntArray
    """(N,) 0 = not yet."""
    impact_position_m: Array
    """(N, 3) contact point on the target surface."""
    pump_flow_m3_per_s: Array
    """(N,) pump flow."""


@dataclass(frozen=True, slots=True)
class GripMotion:
    """True motion of the grip centres, frame `machine`, leading axis N."""

    time_ns: int
    position_m: Array
    velocity_m_per_s: Array
    rate_rad_per_s: Array
    """(N, 3) angular velocity of the gripper."""
    rotation: Array
    """(N, 3, 3) gripper to `machine`."""
