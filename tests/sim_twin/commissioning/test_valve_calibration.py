"""The measured tables predict what the machine then does, and a dead valve is noticed."""

import numpy as np
import pytest

from machine.calibration import actuator_ratio
from machine.conventions import ACTIVE_COUNT, CONTROL_PERIOD_NS
from machine.errors import PlantError
from machine.spec import load_spec
from machine.starts import safe_pose
from runtime.driver import ValveCommand
from sim_twin.commissioning.valve_calibration import CALIBRATION_STEP_COUNT, _table, calibrate
from sim_twin.virtual_machine import VirtualMachine
from tests.cases import each

SPEC = load_spec()
UNIT_SEED = 3


@pytest.fixture(scope="module")
def calibration():
    plant = VirtualMachine(count=CALIBRATION_STEP_COUNT, unit_seed=UNIT_SEED)
    try:
        return calibrate(plant, SPEC, "m003")
    finally:
        plant.close()


def test_tables_have_a_dead_band_and_reach_the_speeds_of_the_machine(calibration):
    ratio = np.abs(actuator_ratio(SPEC, safe_pose()[None, :4]))[0]
    for joint, table in enumerate(calibration.tables):
        valve, speed = np.array(table.valve_ratio), np.array(table.actuator_speed_rad_m_per_s)
        still = np.abs(speed) < 1e-5
        assert np.all(np.abs(valve[still]) < 0.10)
        top = np.array([speed[-1], -speed[0]]) / ratio[joint]
        limits = [
            SPEC.limits.speed_positive_rad_m_per_s[joint],
            SPEC.limits.speed_negative_rad_m_per_s[joint],
        ]
        assert np.all(np.abs(top / limits - 1.0) < 0.35)


@each(("joint", "share"), [(0, 0.5), (1, 0.4), (2, -0.4), (3, 0.4)])
def test_the_inverse_table_gives_the_wanted_speed(calibration, joint, share):
    table = calibration.tables[joint]
    speeds = np.array(table.actuator_speed_rad_m_per_s)
    wanted = share * (speeds[-1] if share > 0 else -speeds[0])
    plant = VirtualMachine(count=1, unit_seed=UNIT_SEED)
    try:
        plant.reset(safe_pose()[None], seed=11)
        valve = np.zeros((1, ACTIVE_COUNT))
        valve[0, joint] = np.interp(wanted, speeds, table.valve_ratio)
        seen = []
        for _ in range(350 if joint == 0 else 130):
            plant.write(ValveCommand(valve, np.zeros(1, dtype=np.bool_)))
            plant.advance(plant.now_ns() + CONTROL_PERIOD_NS)
            sample = plant.read()
            ratio = np.abs(actuator_ratio(SPEC, sample.joint_position_rad_m))
            seen.append((sample.joint_velocity_rad_m_per_s * ratio)[0, joint])
        assert np.mean(seen[-40:]) == pytest.approx(wanted, rel=0.2)
    finally:
        plant.close()


def test_creep_against_a_small_command_is_no_speed_of_the_valve():
    """Telescope of unit 4336: 2 mm/s out at 3 % in, because the arm hangs on it."""
    valve = np.array([-1.0, -0.8, -0.1, -0.07, -0.05, -0.03, 0.03, 0.05, 0.07, 0.1, 0.8, 1.0])
    speed = np.array(
        [-0.43, -0.33, -0.025, -0.011, -1e-4, 2.2e-3, -5e-4, 2.4e-3, 0.010, 0.021, 0.29, 0.39]
    )
    table = _table(3, valve, speed)
    commands = np.array(table.valve_ratio)
    speeds = np.array(table.actuator_speed_rad_m_per_s)
    assert np.all(np.diff(speeds) > 0.0)
    assert np.all(speeds[commands < 0.0] < 0.0)
    np.testing.assert_allclose(speeds[[0, -1]], [-0.43, 0.39], atol=1e-6)


def test_a_creep_inside_the_dead_band_does_not_end_it():
    # Telescope of virtual machine 44301: at -0.03 it sinks, at -0.05 it does not.
    valve = np.array([-1.0, -0.45, -0.15, -0.1, -0.07, -0.05, -0.03, 0.03, 0.05, 0.1, 0.45, 1.0])
    speed = np.array(
        [-0.57, -0.21, -0.051, -0.027, -0.01, 0.0012, -0.0024, 0.0035, 0.0075, 0.024, 0.15, 0.38]
    )
    table = _table(3, valve, speed)
    assert np.all(np.diff(table.actuator_speed_rad_m_per_s) > 0.0)
    assert sum(-0.07 < v < 0.0 for v in table.valve_ratio) == 1


def test_a_machine_that_does_not_move_is_refused():
    class Dead(VirtualMachine):
        def write(self, command: ValveCommand) -> None:
            super().write(ValveCommand(np.zeros_like(command.valve_ratio), command.gripper_open))

    plant = Dead(count=CALIBRATION_STEP_COUNT, unit_seed=0)
    try:
        with pytest.raises(PlantError, match="does not move in both directions"):
            calibrate(plant, SPEC, "dead")
    finally:
        plant.close()
