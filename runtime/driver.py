"""The seam to a machine: read sensors, write valves, on the driver's own clock.

A driver serves `count` machines at once; a real one has count 1, and all its arrays a leading axis of
length 1. docs/drivers.md teaches an integrator to write one.
"""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from machine.conventions import Array, BoolArray, IntArray
from machine.site.solids import Solids
from machine.site.thrown_material import ThrownMaterial


@dataclass(frozen=True, slots=True)
class SensorSample:
    """What the machine's sensors say at one control tick; leading axis N = machines.

    Values that a machine does not measure are NaN (or False, or time 0).
    """

    t_mono_ns: int
    """When the joint sensors were sampled, machine clock."""
    joint_position_rad_m: Array
    """(N, 4) active joints. The slew angle is continuous, not wrapped."""
    joint_velocity_rad_m_per_s: Array
    """(N, 4) active joints."""
    imu_t_mono_ns: IntArray
    """(N,) sample time of the newest gripper IMU sample received so far (not of its arrival); 0 = never."""
    imu_gyro_rad_per_s: Array
    """(N, 3) in the gripper's frame (x forward, y left, z up when it hangs plumb at zero slew)."""
    imu_accel_m_per_s2: Array
    """(N, 3) specific force in the gripper's frame; at rest (0, 0, +9.81)."""
    payload_held: BoolArray
    """(N,) gripper switch: a load is between the claws."""
    supply_pressure_pa: Array
    """(N,)"""
    local_enable: BoolArray
    """(N,) the enable switch at the machine."""
    emergency_stop: BoolArray
    """(N,) the hardwired emergency stop's contact, for display; it does not depend on this software."""
    ball_t_mono_ns: IntArray
    """(N,) sample time of the newest ball-tracker sample; 0 = no tracker or not seen."""
    ball_position_m: Array
    """(N, 3) frame `machine`."""
    impact_t_mono_ns: IntArray
    """(N,) time of impact of the last surveyed landing since the last load; 0 = none yet."""
    impact_position_m: Array
    """(N, 3) surveyed point where the load touched down, frame `machine`."""
    impact_sd_m: Array
    """(N,) standard deviation of the survey, each horizontal axis."""
    impact_volume_m3: Array | None = None
    """(N,) volume of bulk material that landed; NaN: a ball. None = such loads are not measured."""
    impact_covariance_m2: Array | None = None
    """(N, 3) xx, xy and yy of its places about the impact, frame `machine`."""


@dataclass(frozen=True, slots=True)
class ValveCommand:
    """What the safety gate lets through to the valves; leading axis N = machines."""

    valve_ratio: Array
    """(N, 4) spool command -1..1, joint order; positive moves the joint positively."""
    gripper_open: BoolArray
    """(N,) opens the gripper while true."""
    supply_enabled: BoolArray | None = None
    """(N,) false asks the machine's controller to cut the hydraulic supply of the arm (pilot pressure, pump
    unloading): a spool that sticks moves a joint whatever its command says. None = not spoken of."""
    alive_count: int = -1
    """Changes with every tick of the control loop. The machine's controller closes the valves when it stands
    still for 100 ms, although writes go on. -1 = a sender without a loop; then only the writes count."""


@runtime_checkable
class Driver(Protocol):
    """A machine, real or simulated. None of these calls may block longer than a millisecond or two."""

    count: int
    """Machines served: the length of the leading axis."""

    def now_ns(self) -> int:
        """The driver's monotonic clock; everything in the control path is stamped with it."""
        ...

    def advance(self, until_ns: int) -> None:
        """Bring a simulated machine to this time of its clock; a real machine does nothing here."""
        ...

    def read(self) -> SensorSample:
        """The newest sensor values."""
        ...

    def write(self, command: ValveCommand) -> None:
        """Set the valves; they stay so until the next write, or close by the driver's own watchdog."""
        ...

    def load(self) -> None:
        """Take up a payload. A machine that cannot do so by itself waits for the operator."""
        ...

    def close(self) -> None:
        """Close the valves and let go of the hardware."""
        ...


@runtime_checkable
class SimulatedDriver(Driver, Protocol):
    """A driver whose machines can be put anywhere: what evaluation campaigns need on top."""

    def reset(self, joint_position_rad_m: Array, seed: int) -> None:
        """Start over at rest at these poses (N, 6), with a load in the gripper and fresh per-throw noise.

        The clock goes on from where it was; valves are closed.
        """
        ...

    def collided(self) -> BoolArray:
        """(N,) whether the gripper has touched ground, arm or machine since the reset."""
        ...


@runtime_checkable
class LandingDriver(Protocol):
    """A driver that simulates the loads' flight too, and wants to know what they can land on."""

    def set_solids(self, solids: Solids) -> None:
        """Ground and objects, frame `machine`, from now on."""
        ...


@runtime_checkable
class MaterialDriver(Protocol):
    """A driver that simulates loads of bulk material too."""

    def set_material(self, material: ThrownMaterial | None) -> None:
        """What the grippers hold from now on; None: the ball."""
        ...


class SimulatedPlantFactory(Protocol):
    """What ``--plant package.module:Class`` names: called with these keywords, returns the plant."""

    def __call__(self, *, count: int, unit_seed: int) -> SimulatedDriver:
        """Make `count` copies of the machine number `unit_seed`."""
        ...
