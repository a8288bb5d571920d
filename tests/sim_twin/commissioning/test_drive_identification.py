import numpy as np
import pytest

from machine.conventions import CONTROL_PERIOD_S
from machine.spec import load_spec
from sim_twin.commissioning.drive_fit import UPPER, as_array, fit_drive, simulate
from sim_twin.commissioning.drive_identification import explain_joint, linear_drive, with_drives
from sim_twin.commissioning.drive_motion import DriveMotion
from sim_twin.commissioning.response_fit import fit_response
from sim_twin.twin.oil_spring import OilSpringDrive
from sim_twin.twin.profile import nominal_profile

OIL = OilSpringDrive(
    dead_time_s=0.1,
    valve_lag_s=0.06,
    natural_frequency_rad_per_s=8.0,
    oil_damping_ratio=0.25,
    friction_damping_ratio=0.03,
    reach_inertia_ratio=0.6,
    swing_inertia_ratio=0.1,
    acceleration_limit_rad_m_per_s2=1.8,
    jerk_limit_rad_m_per_s3=6.0,
)
LINEAR = OilSpringDrive(
    dead_time_s=0.1,
    valve_lag_s=0.0,
    natural_frequency_rad_per_s=12.0,
    oil_damping_ratio=0.0,
    friction_damping_ratio=0.9,
)


def recorded(drive: OilSpringDrive, runs: int = 8, noise: float = 0.003) -> DriveMotion:
    """Steps, stops and reversals of a joint with this drive."""
    rng = np.random.default_rng(1)
    speed = np.zeros((runs, 250))
    for run in speed:
        run[20:90], run[90:170] = rng.uniform(0.4, 1.0), -rng.uniform(0.3, 1.0)
        run[90:120] *= rng.choice([0.0, 1.0])
    reach = np.repeat(np.linspace(0.7, 1.5, runs)[:, None], 250, axis=1)
    still = DriveMotion(speed, np.ones_like(speed), reach, np.zeros_like(speed), speed, 0.0)
    velocity = simulate(still._replace(velocity_rad_m_per_s=0.0 * speed), as_array(drive)[None])[0]
    steps = 0.5 * CONTROL_PERIOD_S * (velocity[:, 1:] + velocity[:, :-1])
    position = np.pad(np.cumsum(steps, axis=1), ((0, 0), (1, 0)))
    velocity = velocity + noise * rng.standard_normal(velocity.shape)
    return still._replace(velocity_rad_m_per_s=velocity, position_rad_m=position)


def test_an_oil_spring_is_found_again_and_replaces_the_linear_response() -> None:
    record = recorded(OIL)
    response = fit_response(record.actuator_speed_rad_m_per_s, record.velocity_rad_m_per_s)
    explained = explain_joint("slew", record, linear_drive(response))
    found = explained.drive
    assert found.natural_frequency_rad_per_s == pytest.approx(8.0, rel=0.06)
    assert found.oil_damping_ratio == pytest.approx(0.25, abs=0.06)
    assert found.acceleration_limit_rad_m_per_s2 == pytest.approx(1.8, rel=0.06)
    assert found.dead_time_s + found.valve_lag_s == pytest.approx(0.16, abs=0.02)
    assert found.reach_inertia_ratio == pytest.approx(0.6, abs=0.2)
    assert explained.is_oil_spring
    assert explained.explained_ratio > 0.995 > explained.linear_explained_ratio
    assert sum(explained.unexplained_by_phase_ratio.values()) == pytest.approx(1.0)
    profile = nominal_profile(load_spec())
    changed = with_drives(profile, (explained,) * 4)
    assert changed.drives == (found,) * 4
    assert "oil springs of slew" in changed.note


def test_a_linear_joint_keeps_its_linear_response() -> None:
    found = explain_joint("boom", recorded(LINEAR, noise=0.01), LINEAR)
    assert not found.is_oil_spring
    assert found.drive == LINEAR
    assert found.at_bound == ()
    profile = nominal_profile(load_spec())
    assert with_drives(profile, (found,) * 4) is profile


def test_a_parameter_at_its_bound_is_named() -> None:
    fast = OIL.model_copy(update={"gain_ratio": 1.2 * float(UPPER[-1])})
    assert fit_drive(recorded(fast)).at_bound == ("gain_ratio",)


def test_the_lag_of_the_speed_sensor_is_seen() -> None:
    record = recorded(OIL, noise=0.0)
    assert record.velocity_lag_s == pytest.approx(0.0, abs=0.001)
    late = record._replace(velocity_rad_m_per_s=np.roll(record.velocity_rad_m_per_s, 3, axis=1))
    assert late.velocity_lag_s - record.velocity_lag_s == pytest.approx(0.03, abs=0.004)
