"""Constants of the machine type, read from spec.json, which is generated from m545.xml (`make spec`).

No constant has a default or can be overridden, so that the diff of the file shows every change.
"""

import hashlib
import json
from functools import cache, cached_property
from pathlib import Path

import numpy as np
from pydantic import BaseModel, ConfigDict

from machine.conventions import Array

MJCF_PATH = Path(__file__).with_name("m545.xml")
SPEC_PATH = Path(__file__).with_name("spec.json")

Pair = tuple[float, float]
Four = tuple[float, float, float, float]


class _Frozen(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Geometry(_Frozen):
    """Lengths of the kinematic chain (source: URDF of the machine type)."""

    slew_frame_height_m: float
    """Ground to the slew frame (0.85 m base + 0.444 m)."""
    boom_pivot_m: tuple[float, float, float]
    """Boom pivot in the slew frame, xyz; y is the offset of the arm plane from the slew axis."""
    boom_length_m: float
    telescope_axis_offset_m: float
    """Dipper pivot to telescope axis, along the dipper's x."""
    dipper_to_telescope_m: float
    """Dipper pivot to telescope frame at zero extension, along the tube."""
    telescope_to_pin_m: float
    pitch_to_roll_m: float
    roll_to_grip_centre_m: float

    @property
    def arm_plane_offset_m(self) -> float:
        """Signed y of the arm plane in the slew frame."""
        return self.boom_pivot_m[1]


class Limits(_Frozen):
    """Limits of the four active joints, in joint order; infinite slew is a null."""

    position_min_rad_m: tuple[float | None, float, float, float]
    position_max_rad_m: tuple[float | None, float, float, float]
    speed_positive_rad_m_per_s: Four
    speed_negative_rad_m_per_s: Four
    acceleration_rad_m_per_s2: Four
    swing_rad: float
    """Absolute swing of the gripper from the vertical that ends a throw."""


class CylinderSpec(_Frozen):
    """A hydraulic cylinder between two pins; x and z in the frame of the joint's pivot."""

    bore_m: float
    rod_m: float
    base_xz_m: Pair
    """Base pin, in the parent's frame, from the joint's pivot."""
    rod_xz_m: Pair
    """Rod pin, in the child's frame, from the joint's pivot."""


class HydraulicsSpec(_Frozen):
    """Pump, cylinders and the slew drive."""

    pump_flow_m3_per_s: float
    supply_pressure_pa: float
    boom_cylinder: CylinderSpec
    dipper_cylinder: CylinderSpec
    telescope_bore_m: float
    telescope_rod_m: float
    slew_displacement_m3_per_rad: float
    """Oil volume per radian of the upper carriage."""
    valve_dead_band_ratio: float


class Response(_Frozen):
    """Nominal velocity response of a servo-valve loop: dead time, then first-order lag."""

    dead_time_s: Four
    lag_s: Four


class Release(_Frozen):
    """Opening of the gripper: command to free flight (paper, section III-F)."""

    delay_s: float
    delay_sd_s: float


class Passive(_Frozen):
    """Friction of the two free joints, as acceleration (paper, eq. 3)."""

    viscous_friction_per_s: float
    coulomb_friction_rad_per_s2: float
    hanger_mass_kg: float
    hanger_com_m: float
    """Below the pin."""
    hanger_inertia_kg_m2: tuple[float, float, float]
    gripper_mass_kg: float
    gripper_com_m: float
    """Below the roll axis."""
    gripper_inertia_kg_m2: tuple[float, float, float]
    """About the centre of mass, xyz."""


class Ball(_Frozen):
    """The payload of the paper: a size 7 basketball."""

    mass_kg: float
    radius_m: float
    drag_coefficient_ratio: float
    air_density_kg_per_m3: float


class CollisionShape(_Frozen):
    """A solid for collision checks, in the frame of the body that carries it."""

    name: str
    body: str
    """chassis, upper, boom, dipper, telescope or gripper (the only one that collides with the others)."""
    kind: str
    """``capsule`` (radius, half length along z), ``sphere`` (radius) or ``box`` (half sizes)."""
    size_m: tuple[float, float, float]
    position_m: tuple[float, float, float]
    quaternion_wxyz_ratio: tuple[float, float, float, float]


class MachineSpec(_Frozen):
    """All constants of the machine type that runtime, training and twin use."""

    model_name: str
    geometry: Geometry
    limits: Limits
    hydraulics: HydraulicsSpec
    response: Response
    release: Release
    passive: Passive
    ball: Ball
    static_reach_m: float
    collision_shapes: tuple[CollisionShape, ...]

    @cached_property
    def sha256(self) -> str:
        """Model hash, which must be equal in plans, policies and runtime.

        Covers geometry, masses, limits, hydraulics and collision shapes, not the visual meshes.
        """
        canonical = json.dumps(self.model_dump(mode="json"), sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(canonical.encode()).hexdigest()

    def __hash__(self) -> int:
        """Hash of the model hash, so that values derived from a spec can be cached."""
        return hash(self.sha256)

    def speed_limit(self, velocity_rad_m_per_s: Array) -> Array:
        """Speed limit in the direction of each velocity, shape (..., 4), rad/s and m/s."""
        positive = np.asarray(self.limits.speed_positive_rad_m_per_s)
        negative = np.asarray(self.limits.speed_negative_rad_m_per_s)
        return np.where(velocity_rad_m_per_s >= 0.0, positive, negative)

    @property
    def position_range_rad_m(self) -> tuple[Array, Array]:
        """Lower and upper position limits, shape (4,), infinite for the slew."""
        low = [-np.inf if v is None else v for v in self.limits.position_min_rad_m]
        high = [np.inf if v is None else v for v in self.limits.position_max_rad_m]
        return np.asarray(low), np.asarray(high)


@cache
def load_spec(path: Path = SPEC_PATH) -> MachineSpec:
    """Read the spec.

    Raises:
        FileNotFoundError: spec.json is missing; run ``make spec``.
        ValueError: the file does not fit the schema.
    """
    return MachineSpec.model_validate(json.loads(path.read_text(encoding="utf-8")))
