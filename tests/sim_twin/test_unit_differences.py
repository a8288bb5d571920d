"""sim_twin/virtual/units.py (tests/machine has a test_units.py of its own)."""

from dataclasses import fields

import numpy as np
import pytest

from machine.conventions import UNIT_SUFFIXES
from machine.spec import load_spec
from sim_twin.virtual.units import (
    UNIT_HALF_WIDTH,
    MachineUnit,
    draw_conditions,
    make_unit,
    nominal_unit,
)
from tests.cases import each

SPEC = load_spec()

# Ranges to randomise of the machine facts: (low, high); the draw must cover half of each.
RANGES = {
    "dead_time_s": [(0.1, 0.4)] + [(0.05, 0.15)] * 3,
    "spool_lag_s": [(0.05, 0.2)] * 4,
    "dead_band_positive_ratio": [(0.0, 0.10)] * 4,
    "dead_band_negative_ratio": [(0.0, 0.10)] * 4,
    "valve_gain_positive_ratio": [
        (0.84 / 0.95, 1.05 / 0.95),
        (0.8, 1.2),
        (0.75, 1.25),
        (0.75, 1.25),
    ],
    "pump_flow_m3_per_s": [(180 / 60e3, 260 / 60e3)],
    "supply_pressure_pa": [(33e6, 42e6)],
    "slew_relief_pressure_pa": [(0.85 * 24e6, 1.15 * 24e6)],
    "boom_pivot_x_m": [(0.678, 0.718)],
    "boom_length_m": [(2.83, 2.87)],
    "telescope_to_pin_m": [(0.53 + 0.2, 0.53 + 0.5)],
    "pitch_to_roll_m": [(0.10, 0.25)],
    "roll_to_grip_centre_m": [(0.85, 1.15)],
    "gripper_com_m": [(0.4855, 0.7855)],
    "upper_mass_ratio": [(0.8, 1.2)],
    "boom_mass_ratio": [(0.85, 1.15)],
    "gripper_mass_kg": [(300.0, 500.0)],
    "gripper_inertia_ratio": [(0.7, 1.3)],
    "ball_mass_kg": [(0.567, 0.650)],
    "ball_radius_m": [(0.1192, 0.1241)],
    "drag_coefficient_ratio": [(0.47, 0.54)],
    "swing_coulomb_ratio": [(0.5, 1.5)],
}


def test_unit_zero_is_the_nominal_machine():
    assert make_unit(SPEC, 0) == nominal_unit(SPEC)
    assert nominal_unit(SPEC).boom_length_m == SPEC.geometry.boom_length_m
    assert nominal_unit(SPEC).release_delay_s == SPEC.release.delay_s


def test_a_seed_always_names_the_same_machine_and_another_seed_another():
    assert make_unit(SPEC, 7) == make_unit(SPEC, 7)
    first, second = make_unit(SPEC, 7), make_unit(SPEC, 8)
    for field in fields(MachineUnit)[1:]:
        assert getattr(first, field.name) != getattr(second, field.name), field.name
        assert getattr(first, field.name) != getattr(nominal_unit(SPEC), field.name), field.name


def test_draws_stay_inside_their_half_widths_and_fill_them():
    nominal, units = nominal_unit(SPEC), [make_unit(SPEC, seed) for seed in range(1, 201)]
    assert set(UNIT_HALF_WIDTH) == {field.name for field in fields(MachineUnit)[1:]}
    for name, half in UNIT_HALF_WIDTH.items():
        middle = np.asarray(getattr(nominal, name))
        away = np.array([getattr(unit, name) for unit in units]) - middle
        scaled = away / np.asarray(half)
        assert np.abs(scaled).max() <= 1.0 + 1e-9, name
        assert np.abs(scaled).max() > 0.9, name
        assert abs(scaled.mean()) < 0.2, name


@each("name", sorted(RANGES))
def test_the_draw_covers_at_least_half_of_the_known_range(name):
    half = np.atleast_1d(np.asarray(UNIT_HALF_WIDTH[name]))
    for joint, (low, high) in enumerate(RANGES[name]):
        width = 2.0 * half[joint if half.size > 1 else 0]
        assert width >= 0.5 * (high - low) * (1.0 - 1e-9)


def test_every_unit_is_physical():
    for seed in range(1, 201):
        unit = make_unit(SPEC, seed)
        for name in ("dead_time_s", "spool_lag_s", "dead_band_positive_ratio", "hysteresis_ratio"):
            assert min(getattr(unit, name)) > 0.0
        assert unit.gripper_com_m < unit.roll_to_grip_centre_m
        assert unit.slew_relief_pressure_pa < unit.supply_pressure_pa


def test_every_number_carries_its_unit():
    for field in fields(MachineUnit):
        assert field.name == "unit_seed" or field.name.endswith(UNIT_SUFFIXES), field.name


def test_conditions_of_throws():
    unit = nominal_unit(SPEC)
    drawn = draw_conditions(unit, 4000, np.random.default_rng(1))
    assert drawn.release_delay_s.mean() == pytest.approx(0.258, abs=0.001)
    assert drawn.release_delay_s.std() == pytest.approx(0.015, rel=0.05)
    offset = np.linalg.norm(drawn.grasp_offset_m, axis=1)
    assert offset.min() >= 0.01 - 1e-12
    assert offset.max() <= 0.02 + 1e-12
    assert np.abs(drawn.grasp_offset_m.mean(0)).max() < 0.001
    # Warm oil flows more and moves the spools faster: one cause, fully correlated.
    warm = np.corrcoef(drawn.flow_ratio[:, 0], drawn.lag_ratio[:, 0])[0, 1]
    assert warm < -0.99
