"""From arrays to the protocol's facts: what the last control step says about one machine.

The only place where control outputs become words; it decides nothing.
"""

from dataclasses import replace

from machine.conventions import Motion
from runtime.control import safety
from runtime.control.control_loop import IMU_AGE_MAX_S, ControlOutputs, Violation
from runtime.driver import SensorSample
from runtime.throw.protocol import Facts


def with_control(
    facts: Facts,
    outputs: ControlOutputs,
    sample: SensorSample,
    swing_limit_rad: float,
    index: int = 0,
) -> Facts:
    """The facts with everything that the control step and its sample say about machine `index`."""
    row = outputs.row[index]
    return replace(
        facts,
        payload_held=bool(sample.payload_held[index]),
        local_enable=bool(sample.local_enable[index]),
        emergency_stop=bool(sample.emergency_stop[index]),
        motion=Motion(int(row["motion_code_count"])),
        aligned=bool(outputs.aligned[index]),
        release_commanded=bool(outputs.release_commanded[index]),
        throw_done=bool(outputs.throw_done[index]),
        load_gone=bool(outputs.load_gone[index]),
        settled=bool(outputs.settled[index]),
        abort_reason=abort_reason(int(outputs.violation_count[index]), swing_limit_rad),
        abort_is_policys_own=is_policys_own(int(outputs.violation_count[index])),
        fault_reason=fault_reason(int(row["safety_code_count"])),
    )


def abort_reason(violation_count: int, swing_limit_rad: float) -> str:
    """Why a throw may not go on, from `Violation` bits; empty = it may."""
    if not violation_count:
        return ""
    found = Violation(violation_count)
    if Violation.SWING in found:
        return f"the gripper swung beyond {swing_limit_rad:.2f} rad"
    if Violation.IMU in found:
        return f"no gripper IMU sample for more than {IMU_AGE_MAX_S:.2f} s; check its radio and battery"
    if Violation.LATE in found:
        return "the policy took too long for its tick; free the machine's computer, or use another policy"
    if Violation.POLICY in found:
        return "the policy gave a number that is not finite; use another policy version"
    if Violation.ZONE in found:
        return "the release was refused: the load would have flown through an exclusion zone"
    if Violation.RELEASE in found:
        return "the release was refused: the load would have come down outside the plan's region"
    return ""


def is_policys_own(violation_count: int) -> bool:
    """Whether what the policy did, and not the IMU, is the reason of `abort_reason`."""
    return bool(violation_count & _POLICYS_OWN) and not violation_count & _IMU


# Numbers, not members: flags are slow to combine, and this is asked in every tick.
_IMU = int(Violation.IMU)
_POLICYS_OWN = int(
    Violation.SWING | Violation.LATE | Violation.POLICY | Violation.ZONE | Violation.RELEASE
)
_LATCHING = int(safety.LATCHING)


def fault_reason(safety_code_count: int) -> str:
    """Why the machine may not move, from `safety.Intervention` bits; empty = it may."""
    if not safety_code_count & _LATCHING:
        return ""
    found = safety.Intervention(safety_code_count) & safety.LATCHING
    if safety.Intervention.NOT_FINITE in found:
        return "a joint sensor or a valve request was not a number; check the sensors' wiring"
    if safety.Intervention.STALE_SENSORS in found:
        age_ms = safety.SENSOR_AGE_MAX_NS * 1e-6
        return f"the joint sensors were silent for more than {age_ms:.0f} ms; check the driver"
    if safety.Intervention.OVER_SPEED in found:
        ratio = safety.OVER_SPEED_RATIO
        return f"a joint moved faster than {ratio:.1f} times its limit; check valves and hoses"
    for bit, text in _CONTRADICTION_TEXTS.items():
        if bit in found:
            return text
    return ""


_CONTRADICTION_TEXTS = {
    safety.Intervention.SENSOR_JUMP: (
        "a joint's position contradicts its velocity; check its encoder before anything moves"
    ),
    safety.Intervention.SENSOR_FROZEN: "a joint's sensor repeats itself; check the sensor bus",
    safety.Intervention.VALVE_CONTRADICTED: (
        "a joint moves otherwise than its valve says; check for a stuck valve, a blocked joint"
    ),
    safety.Intervention.IMU_CONTRADICTED: (
        "the gripper IMU contradicts itself or the arm's motion; check its mounting and radio"
    ),
    safety.Intervention.TOOL_LIMIT: "the tool was too fast or pulled too hard for the machine",
    safety.Intervention.ARM_IN_ZONE: (
        "arm or gripper were in an exclusion zone, or could no longer stop before it; move them out, or "
        "change the zone"
    ),
    safety.Intervention.NOT_PERMITTED: "a valve was asked for although the machine was to hold",
}
