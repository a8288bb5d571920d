"""spec.json is what the MJCF says, and its values are the sources' values."""

import mujoco
import numpy as np
import pytest

from machine.spec import MJCF_PATH, SPEC_PATH, MachineSpec, load_spec
from sim_twin.spec_export import build_spec

SPEC = load_spec()


def test_the_file_on_disk_is_regenerated_without_a_difference():
    assert SPEC_PATH.read_text(encoding="utf-8") == build_spec().model_dump_json(indent=2) + "\n"


def test_total_mass_is_twelve_tons_with_the_chassis():
    model = mujoco.MjModel.from_xml_path(str(MJCF_PATH))
    chassis_kg = 5300.0  # legs, wheels and frame stand on the ground and carry no joint
    assert float(np.sum(model.body_mass)) + chassis_kg == pytest.approx(12_000, rel=0.005)


def test_pendulum_of_the_gripper_has_the_period_of_the_facts():
    model = mujoco.MjModel.from_xml_path(str(MJCF_PATH))
    data = mujoco.MjData(model)
    inertia = np.zeros((6, 6))
    torque = []
    for swing in (-0.01, 0.01):
        data.qpos[:] = [0.0, 0.5, 0.0, 0.5, -0.5 + swing, 0.0]
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, inertia)
        torque.append(float(data.qfrc_bias[4]))
    stiffness = (torque[1] - torque[0]) / 0.02
    assert 2 * np.pi * np.sqrt(inertia[4, 4] / stiffness) == pytest.approx(1.92, abs=0.06)


def test_hash_changes_with_what_acts():
    changed = SPEC.model_dump(mode="json")
    changed["limits"]["acceleration_rad_m_per_s2"][1] += 0.1
    assert MachineSpec.model_validate(changed).sha256 != SPEC.sha256


def test_speed_limit_depends_on_direction():
    np.testing.assert_allclose(
        SPEC.speed_limit(np.array([1.0, 1.0, 1.0, 1.0])), [0.95, 0.4, 0.7, 0.4]
    )
    np.testing.assert_allclose(SPEC.speed_limit(-np.ones(4)), [0.95, 0.5, 0.7, 0.5])


def test_slew_is_unlimited():
    low, high = SPEC.position_range_rad_m
    assert low[0] == -np.inf
    assert high[0] == np.inf
    assert np.isfinite(low[1:]).all()


def test_an_unknown_field_is_refused():
    tree = SPEC.model_dump(mode="json") | {"surprise_m": 1.0}
    with pytest.raises(ValueError, match="surprise_m"):
        MachineSpec.model_validate(tree)
