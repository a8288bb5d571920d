"""What the virtual machine really did: for scoring and tests, never for anything that runs on a machine."""

from dataclasses import dataclass

from machine.conventions import Array, IntArray


@dataclass(frozen=True, slots=True)
class PlantTruth:
    """What really happened, for scoring and tests; leading axis N, frame `machine`."""

    joint_position_rad_m: Array
    """(N, 6)"""
    joint_velocity_rad_m_per_s: Array
    """(N, 6)"""
    ball_position_m: Array
    """(N, 3) centre of the load: in the gripper, in the air, or where it touched down."""
    ball_velocity_m_per_s: Array
    release_t_mono_ns: IntArray
    """(N,) 0 = still held."""
    release_position_m: Array
    release_velocity_m_per_s: Array
    impact_t_mono_ns: IntArray
    """(N,) 0 = not yet."""
    impact_position_m: Array
    """(N, 3) point of the target surface that the load touched."""
    pump_flow_m3_per_s: Array
    """(N,) what the pump delivers at this instant."""
