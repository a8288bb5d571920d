"""Simulation of free swings, and the frictions fitted to them, against an adaptive solver."""

import numpy as np
import pytest

from diagnosis.single_stage.fit import fit_structure
from diagnosis.single_stage.swing_problem import (
    COULOMB_PARAMETER,
    VISCOUS_PARAMETER,
    SwingDynamics,
    estimate_frictions_from_decay,
    make_swing_problem,
    simulate_swings,
)
from diagnosis.tables.free_swings import SwingRecord, estimate_swing_noise, extract_free_swing
from tests.diagnosis.single_stage.exact_pendulum import exact_angles, stopped_swing


def dynamics(coulomb: np.ndarray, is_linear: bool = False) -> SwingDynamics:
    """A swing of 3 rad/s with dry friction only, one particle per value."""
    zeros = np.zeros(len(coulomb))
    return SwingDynamics(zeros + 9.0, zeros, None, None, coulomb, None, is_linear)


def test_simulated_angles_agree_with_an_adaptive_solver() -> None:
    grid_s = np.arange(0.0, 12.0, 2.0 * np.pi / 3.0 / 96.0)
    coulomb = np.array([0.0, 0.05, 0.4])
    found, _ = simulate_swings(dynamics(coulomb), np.full(3, 0.6), np.zeros(3), grid_s)
    for k, friction in enumerate(coulomb):
        expected = exact_angles(3.0, 0.0, float(friction), 0.6, grid_s)
        np.testing.assert_allclose(found[:, k], expected, atol=1e-5)


def test_dry_friction_takes_an_equal_part_of_every_half_period_and_then_holds() -> None:
    """On a spring each half period loses 2 f / w^2, until the spring is weaker than friction."""
    coulomb, start = 0.3, 0.5
    grid_s = np.arange(0.0, 12.0, np.pi / 3.0 / 12.0)
    found, rate = simulate_swings(
        dynamics(np.array([coulomb]), is_linear=True), np.array([start]), np.zeros(1), grid_s
    )
    lost = 2.0 * coulomb / 9.0
    turning = start - lost * np.arange(int(start / lost) + 1)
    turning = turning[: int(np.flatnonzero(turning * 9.0 <= coulomb)[0]) + 1]
    at = found[::12][: len(turning), 0]
    np.testing.assert_allclose(np.abs(at), turning, atol=2e-4)
    assert np.ptp(found[12 * len(turning) :, 0]) == 0.0
    assert np.all(rate[12 * len(turning) :, 0] == 0.0)


def test_particles_are_independent() -> None:
    grid_s = np.arange(0.0, 8.0, 0.08)
    start, coulomb = np.array([0.5, -0.2, 0.01]), np.array([0.0, 0.2, 0.5])
    together, _ = simulate_swings(dynamics(coulomb), start, np.zeros(3), grid_s)
    for k in range(3):
        one, _ = simulate_swings(
            dynamics(coulomb[k : k + 1]), start[k : k + 1], np.zeros(1), grid_s
        )
        np.testing.assert_array_equal(together[:, k], one[:, 0])


def test_frictions_are_recovered_without_bias() -> None:
    for omega, viscous, coulomb, start in (
        (2.6, 0.05, 0.03, 0.4),
        (6.0, 0.03, 0.04, 0.9),
    ):
        t = np.arange(0.0, 52.0 / omega, 1.0 / 40.0)
        record = SwingRecord(t, exact_angles(omega, viscous, coulomb, start, t))
        swing = extract_free_swing(record, 1e-3)
        assert swing is not None
        problem = make_swing_problem((swing,), np.nan, 1e-3)
        frictions = tuple(o for o in problem.options if o.key != "air_drag")
        values = fit_structure(problem, frictions, {}).as_mapping()
        assert values[VISCOUS_PARAMETER] == pytest.approx(viscous, rel=2e-3)
        assert values[COULOMB_PARAMETER] == pytest.approx(coulomb, rel=2e-3)


def test_amplitudes_lead_the_fit_past_the_point_where_friction_stops_the_body() -> None:
    swing = stopped_swing(0.002)
    noise = estimate_swing_noise([swing])
    free = extract_free_swing(swing, noise)
    assert free is not None
    names = (VISCOUS_PARAMETER, COULOMB_PARAMETER, "rest_rad")
    assert estimate_frictions_from_decay((free,), noise, 2.5, names) == {
        VISCOUS_PARAMETER: pytest.approx(0.142, rel=0.2),
        COULOMB_PARAMETER: pytest.approx(0.061, rel=0.2),
    }
    assert estimate_frictions_from_decay((free,), noise, 2.5, ("rest_rad",)) == {}
    problem = make_swing_problem((free,), np.nan, noise)
    dry = tuple(o for o in problem.options if o.key == "passive_coulomb_friction")
    both = tuple(o for o in problem.options if o.key != "air_drag")
    found = fit_structure(problem, both, fit_structure(problem, dry, {}).as_mapping())
    assert np.sqrt(found.mean_square) < 1.1 * 0.002
    assert found.as_mapping()[VISCOUS_PARAMETER] == pytest.approx(0.142, rel=0.03)
