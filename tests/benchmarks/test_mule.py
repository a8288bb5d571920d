"""The independent plant `mule`: mechanics, drives, release, repeatability, effects."""

import mujoco
import numpy as np
import pytest

from benchmarks.plants.compiled_plant import can_load
from benchmarks.plants.contents import PLANTS
from benchmarks.plants.mule.plant import Mule
from machine.conventions import CONTROL_PERIOD_NS, Array
from machine.spec import MJCF_PATH
from runtime.driver import SensorSample, ValveCommand

POSE = np.array([[0.2, 0.5, 0.1, 0.8, -0.6, 0.0]])


def run(
    plant: Mule, valve_ratio: list[float], ticks: int, *, opened: bool = False
) -> list[SensorSample]:
    """Hold the valves for some ticks of 10 ms; the sample of each."""
    samples: list[SensorSample] = []
    for _ in range(ticks):
        plant.write(ValveCommand(np.array([valve_ratio]), np.array([opened])))
        plant.advance(plant.now_ns() + CONTROL_PERIOD_NS)
        samples.append(plant.read())
    return samples


@pytest.mark.skipif(not can_load(Mule.source), reason="no C compiler is installed")
def test_the_plant_is_the_drawn_machine_and_throws():
    model = mujoco.MjModel.from_xml_path(str(MJCF_PATH))
    data = mujoco.MjData(model)
    plant = Mule()
    for pose in (POSE[0], np.array([1.0, 1.1, -0.8, 0.1, 0.3, 0.2])):
        plant.reset(pose[None], 1)
        data.qpos[:] = plant.true_position_rad_m()[0]
        mujoco.mj_forward(model, data)
        full = np.zeros((6, 6))
        mujoco.mj_fullM(model, data, full)
        mass, gravity = plant.mass_and_bias()
        np.testing.assert_allclose(mass, full, rtol=1e-6, atol=0.02)
        np.testing.assert_allclose(gravity, data.qfrc_bias, rtol=1e-5, atol=0.1)

    for joint in range(4):
        for ratio in (0.6, -0.6):
            plant.reset(POSE, 1)
            command = [0.0] * 4
            command[joint] = ratio
            moved = run(plant, command, 80)[-1].joint_position_rad_m - POSE[:, :4]
            assert np.sign(ratio) * moved[0, joint] > 0.05
    plant.reset(POSE, 1)
    samples = run(plant, [0.0] * 4, 220, opened=True)
    np.testing.assert_allclose(samples[15].joint_position_rad_m, POSE[:, :4], atol=3e-3)
    np.testing.assert_allclose(samples[15].imu_accel_m_per_s2, [[0.0, 0.0, 9.81]], atol=0.3)
    held = [bool(sample.payload_held[0]) for sample in samples]
    assert 0.2 < 0.01 * held.index(False) < 0.36
    assert samples[-1].impact_position_m[0, 2] == 0.0

    def path(unit: int, day: int, effects: list[dict[str, object]]) -> Array:
        one = Mule(unit_seed=unit, day_seed=day, effects=effects)
        one.reset(POSE, 7)
        return run(one, [0.5, 0.3, -0.4, 0.4], 60)[-1].joint_position_rad_m[0]

    first = path(4, 1, [])
    np.testing.assert_array_equal(first, path(4, 1, []))
    for other in (path(5, 1, []), path(4, 2, []), path(4, 1, [PLANTS["mule"].singles[0]])):
        assert not np.array_equal(first, other)
    healthy = Mule(unit_seed=1).parameters
    for effect in (*PLANTS["mule"].singles, *PLANTS["mule"].unknowns):
        changed = Mule(unit_seed=1, effects=[effect]).parameters
        assert any(not np.array_equal(healthy[name], changed[name]) for name in healthy), effect
