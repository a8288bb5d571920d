"""Arming checks: one function each, with the numbers and the remedy an operator needs; pure.

A failed check of severity `error` forbids arming and firing, and disarms. A warning is shown and forbids
nothing. Values that a machine does not measure (NaN) are said to be unmeasured, not passed over.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from machine.conventions import Array, Mode
from machine.messages import CheckResult
from machine.policy_card import PolicyCard
from machine.spec import MachineSpec
from machine.starts import is_valid_start
from runtime.guard.zones import ZoneEntry

SENSOR_AGE_MAX_S = 0.05
IMU_AGE_MAX_S = 0.15
STILL_RAD_M_PER_S = 0.06
"""Six standard deviations of the velocity sensors."""
SWING_MAX_RAD = 0.35
"""More takes longer to die down than an operator wants to hold the button."""
PRESSURE_MIN_RATIO = 0.80
LATE_TICK_MAX_RATIO = 0.01
"""Design target of the control loop."""
OUTBOX_MAX_COUNT = 10_000

Severity = Literal["info", "warning", "error"]


@dataclass(frozen=True, slots=True)
class CheckInputs:
    """What the checks look at, of one machine at one moment."""

    spec: MachineSpec
    cards: dict[Mode, PolicyCard]
    calibration_machine_id: str
    machine_id: str
    local_enable: bool
    emergency_stop: bool
    payload_held: bool
    sensor_age_s: float
    imu_age_s: float
    """Infinite = never heard of."""
    joint_position_rad_m: Array
    """(6,) estimate."""
    joint_speed_rad_m_per_s: Array
    """(4,) of the driven joints, filtered."""
    swing_amplitude_rad: float
    supply_pressure_pa: float
    """NaN = not measured."""
    zone_count: int | None
    """Exclusion zones on board; None = they cannot be read."""
    arm_zone: ZoneEntry | None
    """Zone that the arm stands in."""
    late_tick_ratio: float
    outbox_count: int
    recorder_dropped_count: int
    policy_refusals: dict[Mode, str] = field(default_factory=dict[Mode, str])
    """Why a mode has no policy."""


def check_enable(given: CheckInputs) -> CheckResult:
    """The enable switch at the machine."""
    on = given.local_enable
    return _result(
        "local_enable",
        on,
        "error",
        f"Enable switch at the machine is {'on' if on else 'off'}.",
        "Turn it on at the machine.",
    )


def check_emergency_stop(given: CheckInputs) -> CheckResult:
    """The hardwired emergency stop."""
    pressed = given.emergency_stop
    return _result(
        "emergency_stop",
        not pressed,
        "error",
        f"Emergency stop is {'pressed' if pressed else 'released'}.",
        "Release it at the machine when the cause is gone.",
    )


def check_joint_sensors(given: CheckInputs) -> CheckResult:
    """Joint sensors: numbers, and fresh ones."""
    finite = bool(np.isfinite(given.joint_position_rad_m).all())
    age_s = given.sensor_age_s
    if not finite:
        text = "A joint position is not a number."
    else:
        text = (
            f"Joint sensors are {age_s * 1e3:.0f} ms old ({SENSOR_AGE_MAX_S * 1e3:.0f} ms allowed)."
        )
    fresh = 0.0 <= age_s <= SENSOR_AGE_MAX_S
    return _result(
        "joint_sensors", finite and fresh, "error", text, "Check the driver and the sensor bus."
    )


def check_imu(given: CheckInputs) -> CheckResult:
    """The gripper's IMU."""
    age_s = given.imu_age_s
    if math.isinf(age_s):
        text = "The gripper IMU has not been heard."
    else:
        text = f"Gripper IMU is {age_s * 1e3:.0f} ms old ({IMU_AGE_MAX_S * 1e3:.0f} ms allowed)."
    return _result(
        "gripper_imu", age_s <= IMU_AGE_MAX_S, "error", text, "Check its battery and radio."
    )


def check_standstill(given: CheckInputs) -> CheckResult:
    """No driven joint moves."""
    fastest = float(np.max(np.abs(given.joint_speed_rad_m_per_s)))
    return _result(
        "standstill",
        fastest <= STILL_RAD_M_PER_S,
        "error",
        f"Fastest joint moves at {fastest:.3f} rad/s or m/s ({STILL_RAD_M_PER_S:.3f} allowed).",
        "Wait until the machine stands.",
    )


def check_swing(given: CheckInputs) -> CheckResult:
    """The gripper hangs still enough to begin."""
    swing = given.swing_amplitude_rad
    return _result(
        "gripper_swing",
        swing <= SWING_MAX_RAD,
        "error",
        f"Gripper swings by {swing:.2f} rad ({SWING_MAX_RAD:.2f} rad allowed).",
        "Wait until it hangs still.",
    )


def check_payload(given: CheckInputs) -> CheckResult:
    """A load is between the claws."""
    held = given.payload_held
    return _result(
        "payload",
        held,
        "error",
        "A load is in the gripper." if held else "The gripper is empty.",
        "Load the machine.",
    )


def check_pressure(given: CheckInputs) -> CheckResult:
    """Hydraulic supply pressure."""
    pressure, nominal = given.supply_pressure_pa, given.spec.hydraulics.supply_pressure_pa
    needed = PRESSURE_MIN_RATIO * nominal
    if math.isnan(pressure):
        return _result(
            "supply_pressure",
            True,
            "info",
            "This machine does not measure its supply pressure.",
            "",
        )
    return _result(
        "supply_pressure",
        pressure >= needed,
        "error",
        f"Supply pressure {pressure * 1e-6:.1f} MPa ({needed * 1e-6:.1f} MPa needed).",
        "Wait for the pump, or check it.",
    )


def check_policies(given: CheckInputs) -> CheckResult:
    """At least one policy is on board."""
    names = ", ".join(f"{mode.value}: {card.policy_id}" for mode, card in given.cards.items())
    for mode, refusal in given.policy_refusals.items():
        names += f"{', ' * bool(names)}{mode.value}: none ({refusal})"
    return _result(
        "policies",
        bool(given.cards),
        "error",
        f"Policies on board: {names or 'none'}.",
        "Deploy a policy for this machine's model.",
    )


def check_start_pose(given: CheckInputs) -> CheckResult:
    """Whether a throw may start from here, or the arm has to go to the safe pose first."""
    pose = np.nan_to_num(given.joint_position_rad_m)
    valid = bool(is_valid_start(given.spec, pose))
    text = "The arm is in a pose to throw from."
    if not valid:
        text = "The arm is too near to a limit, the ground or the machine to throw from."
    return _result(
        "start_pose",
        valid,
        "warning",
        text,
        "It goes to the safe pose first, while the button is held.",
    )


def check_zones(given: CheckInputs) -> CheckResult:
    """The exclusion zones can be read, and the arm is in none."""
    inside = given.arm_zone
    if given.zone_count is None:
        text = "The exclusion zones on this machine cannot be read."
        remedy = "Connect it to its server, which sends them again."
    elif inside is not None:
        text = f"The arm reaches {inside.depth_m:.2f} m into zone '{inside.name}'."
        remedy = "Move it out at the machine, or change the zone."
    else:
        named = {0: "No exclusion zone", 1: "1 exclusion zone"}
        count = named.get(given.zone_count, f"{given.zone_count} exclusion zones")
        text, remedy = f"{count} on board.", ""
    passed = given.zone_count is not None and inside is None
    return _result("exclusion_zones", passed, "error", text, remedy)


def check_calibration(given: CheckInputs) -> CheckResult:
    """The valve tables were measured on this machine."""
    own = given.calibration_machine_id == given.machine_id
    return _result(
        "calibration",
        own,
        "warning",
        f"Valve tables of {given.calibration_machine_id}, this is {given.machine_id}.",
        "Run `downrange calibrate` for this machine.",
    )


def check_loop(given: CheckInputs) -> CheckResult:
    """The control loop keeps its time."""
    late = given.late_tick_ratio
    return _result(
        "control_loop",
        late <= LATE_TICK_MAX_RATIO,
        "warning",
        f"{late:.1%} of the control ticks were late ({LATE_TICK_MAX_RATIO:.0%} allowed).",
        "Take other work off the machine's computer.",
    )


def check_records(given: CheckInputs) -> CheckResult:
    """Recorder and outbox keep up."""
    waiting, dropped = given.outbox_count, given.recorder_dropped_count
    return _result(
        "records",
        waiting <= OUTBOX_MAX_COUNT and dropped == 0,
        "warning",
        f"{waiting} events wait for the server ({OUTBOX_MAX_COUNT} allowed), "
        f"{dropped} rows were not recorded.",
        "Restore the link; check the machine's disk.",
    )


CHECKS: tuple[Callable[[CheckInputs], CheckResult], ...] = (
    check_enable,
    check_emergency_stop,
    check_joint_sensors,
    check_imu,
    check_standstill,
    check_swing,
    check_payload,
    check_pressure,
    check_policies,
    check_start_pose,
    check_zones,
    check_calibration,
    check_loop,
    check_records,
)
"""In the order in which operators read them."""


def run_checks(given: CheckInputs) -> tuple[CheckResult, ...]:
    """All checks."""
    return tuple(check(given) for check in CHECKS)


def _result(check_id: str, passed: bool, severity: Severity, text: str, remedy: str) -> CheckResult:
    return CheckResult(
        check_id=check_id,
        passed=passed,
        severity=severity,
        text=text,
        remedy="" if passed else remedy,
    )
