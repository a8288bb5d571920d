"""Bulk material in the virtual machine: how heavy it is, how it leaves, flies and lies."""

import numpy as np
import pytest

from bulk.material import MATERIALS
from machine.site.thrown_material import ThrownMaterial
from machine.starts import safe_pose
from runtime.driver import MaterialDriver, ValveCommand
from sim_twin.virtual_machine import VirtualMachine
from tests.cases import each

TICK_NS = 10_000_000


def grab(name, volume_m3=0.25):
    kind = MATERIALS[name]
    return ThrownMaterial(
        name=name,
        volume_m3=volume_m3,
        mass_kg=kind.mass_kg(volume_m3),
        grain_diameter_m=kind.grain_diameter_m,
        grain_spread_ratio=kind.grain_spread_ratio,
        grain_density_kg_per_m3=kind.grain_density_kg_per_m3,
        drag_coefficient_ratio=kind.drag_coefficient_ratio,
    )


def drop(material, *, wind_m_per_s=0.0, count=4):
    """Let go over one spot; the machine, and its last sample."""
    machine = VirtualMachine(count=count, unit_seed=0)
    machine.reset(np.tile(safe_pose(), (count, 1)), 1)
    machine.wind_m_per_s[:, 1] = wind_m_per_s
    machine.set_material(material)
    return machine, drive(machine, 200, is_open=True)


def drive(machine, ticks, *, is_open):
    command = ValveCommand(np.zeros((machine.count, 4)), np.full(machine.count, is_open))
    for _ in range(ticks):
        machine.write(command)
        machine.advance(machine.now_ns() + TICK_NS)
    return machine.read()


def test_a_grab_of_gravel_is_measured_with_its_volume_and_spread():
    machine, sample = drop(grab("gravel"))
    assert isinstance(machine, MaterialDriver)
    assert (sample.impact_t_mono_ns > 0).all() and not sample.payload_held.any()
    volume, (xx, xy, yy) = sample.impact_volume_m3, sample.impact_covariance_m2.T
    np.testing.assert_allclose(volume, 0.25, rtol=0.4)
    assert len(set(volume)) == machine.count  # no two grabs are alike
    assert (xx > 0.02).all() and (yy > 0.02).all() and (xy**2 < xx * yy).all()
    off = sample.impact_position_m - machine.truth().release_position_m
    assert np.abs(off[:, :2]).max() < 0.3


def test_a_ball_after_material_is_a_ball_again():
    machine, _ = drop(grab("gravel"))
    drive(machine, 2, is_open=False)
    machine.load()
    machine.set_material(None)
    sample = drive(machine, 200, is_open=True)
    assert (sample.impact_t_mono_ns > 0).all()
    assert np.isnan(sample.impact_volume_m3).all() and np.isnan(sample.impact_covariance_m2).all()


def test_a_heavy_grab_weighs_on_the_arm_until_it_is_let_go():
    heights = {}
    for name in ("ball", "gravel"):
        machine = VirtualMachine(count=1, unit_seed=0)
        machine.reset(np.tile(safe_pose(), (1, 1)), 1)
        machine.set_material(None if name == "ball" else grab(name))
        drive(machine, 100, is_open=False)
        held = machine.truth().joint_position_rad_m[0, 1]
        drive(machine, 200, is_open=True)
        heights[name] = held, machine.truth().joint_position_rad_m[0, 1]
    sagged, risen = (heights["gravel"][i] - heights["ball"][i] for i in (0, 1))
    assert abs(sagged) > 1e-3
    assert abs(risen) < 0.5 * abs(sagged)


def test_grains_of_a_dense_load_shield_each_other_from_the_wind():
    drift = {}
    for volume_m3 in (0.25, 1e-4):
        machine, sample = drop(grab("sand", volume_m3), wind_m_per_s=10.0)
        away = sample.impact_position_m - machine.truth().release_position_m
        drift[volume_m3] = float(away[:, 1].mean())
    assert 0.0 < drift[0.25] < 0.3 * drift[1e-4]


@each("plan", [{"volume_m3": 0.0}, {"mass_kg": float("nan")}])
def test_a_load_of_nothing_is_refused(plan):
    with pytest.raises(ValueError, match=next(iter(plan))):
        ThrownMaterial.model_validate(grab("gravel").model_dump() | plan)
