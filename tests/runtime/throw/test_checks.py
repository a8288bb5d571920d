from dataclasses import replace

import numpy as np

from machine.conventions import Mode
from machine.spec import load_spec
from machine.starts import safe_pose
from runtime.guard.zones import ZoneEntry
from runtime.throw import checks
from runtime.throw.checks import CheckInputs, run_checks
from tests.cases import each
from tests.runtime.protocol_bench import card

SPEC = load_spec()
GOOD = CheckInputs(
    spec=SPEC,
    cards={Mode.PLANAR: card()},
    calibration_machine_id="m001",
    machine_id="m001",
    local_enable=True,
    emergency_stop=False,
    payload_held=True,
    sensor_age_s=0.004,
    imu_age_s=0.025,
    joint_position_rad_m=safe_pose(),
    joint_speed_rad_m_per_s=np.zeros(4),
    swing_amplitude_rad=0.01,
    supply_pressure_pa=35e6,
    zone_count=0,
    arm_zone=None,
    late_tick_ratio=0.0,
    outbox_count=0,
    recorder_dropped_count=0,
)
ERRORS = {
    "local_enable",
    "emergency_stop",
    "joint_sensors",
    "gripper_imu",
    "standstill",
    "gripper_swing",
    "payload",
    "supply_pressure",
    "policies",
    "exclusion_zones",
}
WARNINGS = {"start_pose", "calibration", "control_loop", "records"}


def result(check_id, **changes):
    (found,) = [r for r in run_checks(replace(GOOD, **changes)) if r.check_id == check_id]
    return found


def test_a_ready_machine_passes_everything():
    results = run_checks(GOOD)
    assert all(r.passed for r in results)
    assert all(r.text and r.remedy == "" for r in results)


def test_zones_that_cannot_be_read_and_an_arm_in_a_zone_forbid_arming():
    unread = result("exclusion_zones", zone_count=None)
    assert not unread.passed and "cannot be read" in unread.text and "server" in unread.remedy
    inside = result("exclusion_zones", zone_count=2, arm_zone=ZoneEntry("Office", 0.125, 3.0))
    assert not inside.passed and "0.12 m into zone 'Office'" in inside.text
    assert inside.remedy
    counts = [result("exclusion_zones", zone_count=count).text for count in (0, 1, 3)]
    assert counts == [
        "No exclusion zone on board.",
        "1 exclusion zone on board.",
        "3 exclusion zones on board.",
    ]


def test_every_check_has_its_own_name_and_severity():
    severity = {r.check_id: r.severity for r in run_checks(GOOD)}
    assert len(severity) == len(checks.CHECKS) == len(ERRORS) + len(WARNINGS)
    assert {name for name, s in severity.items() if s == "error"} == ERRORS
    assert {name for name, s in severity.items() if s == "warning"} == WARNINGS


def speed(value):
    return np.array([0.0, 0.0, -value, 0.0])


@each(
    "check_id, passing, failing, number",
    [
        ("local_enable", {}, {"local_enable": False}, "off"),
        ("emergency_stop", {}, {"emergency_stop": True}, "pressed"),
        ("joint_sensors", {"sensor_age_s": 0.05}, {"sensor_age_s": 0.0501}, "50 ms"),
        ("joint_sensors", {"sensor_age_s": 0.0}, {"sensor_age_s": -0.0001}, "-0 ms"),
        ("joint_sensors", {}, {"joint_position_rad_m": np.full(6, np.nan)}, "not a number"),
        ("gripper_imu", {"imu_age_s": 0.15}, {"imu_age_s": 0.1501}, "150 ms"),
        ("gripper_imu", {}, {"imu_age_s": np.inf}, "not been heard"),
        ("standstill", {"joint_speed_rad_m_per_s": speed(0.06)},
         {"joint_speed_rad_m_per_s": speed(0.0601)}, "0.060"),
        ("standstill", {"joint_speed_rad_m_per_s": speed(-0.06)},
         {"joint_speed_rad_m_per_s": speed(-0.0601)}, "0.060"),
        ("gripper_swing", {"swing_amplitude_rad": 0.35}, {"swing_amplitude_rad": 0.3501}, "0.35 rad"),
        ("payload", {}, {"payload_held": False}, "empty"),
        ("supply_pressure", {"supply_pressure_pa": 28e6}, {"supply_pressure_pa": 27.99e6}, "28.0 MPa"),
        ("policies", {}, {"cards": {}}, "none"),
        ("start_pose", {}, {"joint_position_rad_m": np.zeros(6)}, "too near"),
        ("calibration", {}, {"calibration_machine_id": "nominal"}, "nominal"),
        ("control_loop", {"late_tick_ratio": 0.01}, {"late_tick_ratio": 0.0101}, "1.0%"),
        ("records", {"outbox_count": 10_000}, {"outbox_count": 10_001}, "10001"),
        ("records", {}, {"recorder_dropped_count": 1}, "1 rows"),
    ],
)  # fmt: skip
def test_both_sides_of_every_check(check_id, passing, failing, number):
    good = result(check_id, **passing)
    assert good.passed and good.remedy == ""
    bad = result(check_id, **failing)
    assert not bad.passed
    assert number in bad.text
    assert bad.remedy
    others = [r for r in run_checks(replace(GOOD, **failing)) if r.check_id != check_id]
    assert all(r.passed for r in others if r.check_id not in ("start_pose", "joint_sensors"))


def test_texts_of_good_news():
    assert result("local_enable").text == "Enable switch at the machine is on."
    assert result("emergency_stop").text == "Emergency stop is released."
    assert result("joint_sensors").text == "Joint sensors are 4 ms old (50 ms allowed)."
    assert result("gripper_imu").text == "Gripper IMU is 25 ms old (150 ms allowed)."
    assert result("payload").text == "A load is in the gripper."
    assert result("policies").text == "Policies on board: 2d: test-2d."
    assert result("supply_pressure").text == "Supply pressure 35.0 MPa (28.0 MPa needed)."
    assert result("start_pose").text == "The arm is in a pose to throw from."


def test_an_unmeasured_pressure_is_said_to_be_so():
    found = result("supply_pressure", supply_pressure_pa=np.nan)
    assert found.passed and found.severity == "info"
    assert "does not measure" in found.text
