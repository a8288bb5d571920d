"""Calibration of one machine: valve tables for the feed-forward, and registrations of its throws.

Speeds are actuator speeds: m/s of the cylinder for boom, dipper and telescope, rad/s for the slew. They do
not depend on the varying lever arm of a cylinder.
"""

import hashlib
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, model_validator

from machine.conventions import ACTIVE_COUNT, Array
from machine.errors import UsageError
from machine.kinematics import components, cylinder_arm_m, namespace
from machine.registration import Registration
from machine.spec import MachineSpec


class ValveTable(BaseModel):
    """Steady actuator speed over the valve command of one joint, both directions, increasing."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    valve_ratio: tuple[float, ...]
    actuator_speed_rad_m_per_s: tuple[float, ...]

    @model_validator(mode="after")
    def _increasing(self) -> "ValveTable":
        valve, speed = np.asarray(self.valve_ratio), np.asarray(self.actuator_speed_rad_m_per_s)
        if len(valve) != len(speed) or len(valve) < 3:
            raise ValueError("a valve table needs the same number (3 or more) of valves and speeds")
        if np.any(np.diff(valve) <= 0.0) or np.any(np.diff(speed) <= 0.0):
            raise ValueError("valve commands and speeds of a valve table must both increase")
        return self


class ValveCalibration(BaseModel):
    """Tables of the four driven joints of one machine, and its registrations, at most one per policy."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    schema_version: Literal[1] = 1
    machine_id: str
    tables: tuple[ValveTable, ValveTable, ValveTable, ValveTable]
    registrations: tuple[Registration, ...] = ()
    """Empty: the policy aims at the target itself."""
    twin_registrations: tuple[Registration, ...] = ()
    """Registrations of the machine's twin from the same registration throws. The twin aims by them, so that a
    preview shows the error that remains after registration, and later changes."""

    @cached_property
    def sha256(self) -> str:
        """Of everything that it says."""
        return hashlib.sha256(self.model_dump_json().encode()).hexdigest()

    def aim(self, policy_sha256: str, target_m: Array, slew_rad: Array) -> Array:
        """Aim points (N, 3) with which this policy hits `target_m` (N, 3) on average; frame `machine`.

        Args:
            policy_sha256: of the policy that throws.
            target_m: targets.
            slew_rad: (N,) slew angle at the start of the throw.
        """
        for registration in self.registrations:
            if registration.policy_sha256 == policy_sha256:
                return registration.aim(target_m, slew_rad)
        return target_m

    def without_registrations(self) -> "ValveCalibration":
        """The calibration with its valve tables only."""
        return self.model_copy(update={"registrations": (), "twin_registrations": ()})

    def for_twin(self) -> "ValveCalibration":
        """Calibration of the machine's twin, with the twin's registrations."""
        return self.model_copy(
            update={"registrations": self.twin_registrations, "twin_registrations": ()}
        )


def actuator_ratio(spec: MachineSpec, active_position_rad_m: Array) -> Array:
    """Signed actuator speed per joint speed at active joint positions (..., 4); shape (..., 4).

    Slew and telescope have ratio 1. The dipper's cylinder shortens as the joint opens, so its ratio
    is negative; valve tables and flows use the magnitude with the joint's sign.
    """
    boom = cylinder_arm_m(spec.hydraulics.boom_cylinder, active_position_rad_m[..., 1])
    dipper = cylinder_arm_m(spec.hydraulics.dipper_cylinder, active_position_rad_m[..., 2])
    one = boom * 0.0 + 1.0
    xp = namespace(boom)
    return xp.stack([one, boom, dipper, one], axis=-1)


def actuator_ratio_magnitude(spec: MachineSpec, active_position_rad_m: Array) -> Array:
    """|actuator_ratio| (N, 4) of numpy arrays (N, 4), fast enough for every control tick."""
    ratio = np.ones_like(active_position_rad_m)
    _, boom, dipper, _ = components(active_position_rad_m.T)
    ratio[:, 1] = cylinder_arm_m(spec.hydraulics.boom_cylinder, boom)
    ratio[:, 2] = cylinder_arm_m(spec.hydraulics.dipper_cylinder, dipper)
    return np.abs(ratio, out=ratio)


def nominal_calibration(spec: MachineSpec, machine_id: str = "nominal") -> ValveCalibration:
    """Calibration of an unmeasured machine: linear to the speed limits, with the residual dead band."""
    middle = np.array([[0.0, 0.5, 0.0, 0.5]])
    ratio = np.abs(actuator_ratio(spec, middle))[0]
    band = spec.hydraulics.valve_dead_band_ratio
    tables: list[ValveTable] = []
    for joint in range(ACTIVE_COUNT):
        up = spec.limits.speed_positive_rad_m_per_s[joint] * float(ratio[joint])
        down = spec.limits.speed_negative_rad_m_per_s[joint] * float(ratio[joint])
        tables.append(
            ValveTable(
                valve_ratio=(-1.0, -band, band, 1.0),
                actuator_speed_rad_m_per_s=(-down, -1e-4, 1e-4, up),
            )
        )
    return ValveCalibration(
        machine_id=machine_id, tables=(tables[0], tables[1], tables[2], tables[3])
    )


def load_calibration(path: Path) -> ValveCalibration:
    """Read a calibration file.

    Raises:
        UsageError: missing or not a calibration.
    """
    try:
        return ValveCalibration.model_validate_json(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise UsageError(
            f"{path} is not a valve calibration ({error}); make one with `downrange calibrate`"
        ) from error
