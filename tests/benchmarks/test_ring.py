"""The independent plant `ring`: mechanics, drives, release, sensors, repeatability, effects."""

import re
from pathlib import Path

import numpy as np
import pytest

from benchmarks.plants import ring
from benchmarks.plants.compiled_plant import can_load
from benchmarks.plants.ring.effects import ADDED, JOINTS, KNOWN, UNKNOWN, Effect
from benchmarks.plants.ring.plant import Ring
from machine.conventions import CONTROL_PERIOD_NS
from machine.spec import MJCF_PATH
from runtime.driver import SensorSample, SimulatedDriver, ValveCommand

pytestmark = pytest.mark.skipif(not can_load(Ring.source), reason="no C compiler is installed")
POSE = np.array([[0.2, 0.5, 0.1, 0.8, -0.6, 0.0]])


def run(
    plant: Ring, valve_ratio: list[float], ticks: int, *, opened: bool = False
) -> list[SensorSample]:
    """Hold the valves for some ticks of 10 ms; the sample of each."""
    samples: list[SensorSample] = []
    for _ in range(ticks):
        valves = np.tile(valve_ratio, (plant.count, 1))
        plant.write(ValveCommand(valves, np.full(plant.count, opened)))
        plant.advance(plant.now_ns() + CONTROL_PERIOD_NS)
        samples.append(plant.read())
    return samples


def test_rigid_body_dynamics_agree_with_the_machine_file():
    """Mass matrix and gravity forces against MuJoCo's, which the plant does not use."""
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_path(str(MJCF_PATH))
    data = mujoco.MjData(model)
    plant = Ring()
    for pose in (POSE[0], np.array([1.0, 1.1, -0.8, 0.1, 0.3, 0.2])):
        plant.reset(pose[None], 1)
        data.qpos[:] = plant.true_position_rad_m()[0]
        mujoco.mj_forward(model, data)
        full = np.zeros((6, 6))
        mujoco.mj_fullM(model, data, full)
        mass, bias = plant.mass_and_bias()
        np.testing.assert_allclose(mass, full, rtol=1e-6, atol=0.02)
        np.testing.assert_allclose(bias, data.qfrc_bias, rtol=1e-6, atol=0.05)


def test_each_joint_follows_its_valve_and_rests_without():
    plant = Ring()
    assert isinstance(plant, SimulatedDriver)
    for joint in range(4):
        for ratio in (0.6, -0.6):
            plant.reset(POSE, 1)
            command = [0.0] * 4
            command[joint] = ratio
            samples = run(plant, command, 80)
            moved = samples[-1].joint_position_rad_m - POSE[:, :4]
            assert np.sign(moved[0, joint]) == np.sign(ratio)
            assert abs(moved[0, joint]) > 0.05
    plant.reset(POSE, 1)
    samples = run(plant, [0.0] * 4, 100)
    np.testing.assert_allclose(samples[-1].joint_position_rad_m, POSE[:, :4], atol=2e-3)
    np.testing.assert_allclose(samples[-1].imu_accel_m_per_s2, [[0.0, 0.0, 9.81]], atol=0.3)


def test_the_slew_swings_on_its_oil_spring():
    """1.1 Hz and 20 % of critical damping at a middle reach: the speed rings after the valve closes."""
    plant = Ring()
    plant.reset(POSE, 1)
    run(plant, [0.8, 0.0, 0.0, 0.0], 150)
    speed = np.array([s.joint_velocity_rad_m_per_s[0, 0] for s in run(plant, [0.0] * 4, 150)])
    assert speed.min() < -0.1


def test_a_load_leaves_after_its_delay_flies_and_lands():
    plant = Ring()
    plant.reset(POSE, 1)
    held = [bool(s.payload_held[0]) for s in run(plant, [0.0] * 4, 120, opened=True)]
    switch_s = 0.01 * held.index(False)
    assert 0.2 < switch_s < 0.36
    sample = plant.read()
    assert sample.impact_t_mono_ns[0] > 0
    assert sample.impact_position_m[0, 2] == 0.0
    plant.reset(POSE, 2)
    assert plant.read().impact_t_mono_ns[0] == 0
    assert plant.read().payload_held[0]


def test_a_machine_is_its_unit_day_and_seed():
    def path(unit: int, day: int, seed: int) -> np.ndarray:
        plant = Ring(count=2, unit_seed=unit, day_seed=day)
        plant.reset(np.tile(POSE, (2, 1)), seed)
        return run(plant, [0.5, 0.3, -0.4, 0.4], 60)[-1].joint_position_rad_m[0]

    first = path(4, 1, 7)
    np.testing.assert_array_equal(first, path(4, 1, 7))
    for other in (path(5, 1, 7), path(4, 2, 7), path(4, 1, 8)):
        assert not np.array_equal(first, other)
    assert np.abs(path(4, 2, 7) - first).max() < 0.05


def test_every_effect_changes_the_machine():
    """Each effect of the plant, known or not, changes parameters; a wrong parameter is refused."""
    healthy = Ring(unit_seed=1).parameters
    extra = {
        "valve_dead_band": "positive_ratio",
        "passive_coulomb_friction": "extra_coulomb_rad_per_s2",
        "gripper_length": "extra_length_m",
        "gripper_inertia": "extra_inertia_ratio",
        "pump_flow_sharing": "shortage_ratio",
        "release_jitter": "extra_sd_s",
        "air_drag": "extra_drag_coefficient_ratio",
    }
    unchanged: list[str] = []
    for name in (*KNOWN, *UNKNOWN):
        names = ADDED.get(name) or {extra.get(name, "size"): None}
        for parameter in names:
            effect = Effect(name, JOINTS[1], {parameter: 0.05})
            changed = Ring(unit_seed=1, effects=[vars(effect)]).parameters
            if all(np.array_equal(healthy[field], changed[field]) for field in healthy):
                unchanged.append(f"{name}.{parameter}")
    assert not unchanged
    with pytest.raises(ValueError, match="has no parameter"):
        Ring(effects=[{"effect": "air_drag", "joint": None, "parameters": {"drag": 1.0}}])


def test_the_plant_shares_no_code_with_the_twin_and_the_diagnosis():
    """It may use the drawing's numbers and the driver's interface, nothing else of the project."""
    allowed = {"machine.spec", "machine.conventions", "runtime.driver"}
    imports = {
        f"{path.name}: {found}"
        for path in Path(ring.__file__).parent.glob("*.py")
        for found in re.findall(
            r"^(?:from|import) ((?:machine|runtime|sim_twin|diagnosis|challenge|mujoco)[\w.]*)",
            path.read_text(encoding="utf-8"),
            re.MULTILINE,
        )
        if found not in allowed
    }
    assert not imports
