"""Free motion with dry friction, against a solver that stops at every turning point."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from diagnosis.alone.fit import fit
from diagnosis.alone.free_motion import Pull, move
from diagnosis.alone.reading.free_swings import Swing, free_part
from diagnosis.alone.swing import make_problem

NOISE_RAD = 1e-3
"""What the fit is told; the angles have none."""


def exact(omega: float, viscous: float, coulomb: float, start: float, t: np.ndarray) -> np.ndarray:
    """Angles of a pendulum released at rest, one half swing after the other."""
    angle = np.full(len(t), np.nan)
    x, begin = start, 0.0
    while begin < t[-1]:
        if abs(omega**2 * np.sin(x)) <= coulomb:
            angle[t >= begin] = x
            return angle
        side = -np.sign(x)

        def slowed(s: float, y: np.ndarray, begin: float = begin, side: float = side) -> float:
            return float(y[1] * side) if s > begin + 1e-6 else 1.0

        def law(_: float, y: np.ndarray, side: float = side) -> list[float]:
            return [y[1], -(omega**2) * np.sin(y[0]) - viscous * y[1] - coulomb * side]

        slowed.terminal, slowed.direction = True, -1.0
        half = solve_ivp(
            law, (begin, t[-1]), [x, 0.0], events=slowed, rtol=1e-9, atol=1e-11, dense_output=True
        )
        during = (t >= begin) & (t <= half.t[-1])
        angle[during] = half.sol(t[during])[0]
        x, begin = float(half.y[0, -1]), float(half.t[-1])
    return angle


def pull(coulomb: np.ndarray, is_linear: bool = False) -> Pull:
    """Of 3 rad/s and dry friction alone, a particle a value."""
    nothing = np.zeros(len(coulomb))
    return Pull(nothing + 9.0, nothing, nothing, nothing, coulomb, nothing, is_linear)


@pytest.mark.parametrize("coulomb", [0.0, 0.05, 0.4])
def test_angles_are_those_of_a_fine_solver(coulomb: float) -> None:
    grid_s = np.arange(0.0, 12.0, 2.0 * np.pi / 3.0 / 96.0)
    found, _ = move(pull(np.array([coulomb])), np.array([0.6]), np.zeros(1), grid_s)
    np.testing.assert_allclose(found[:, 0], exact(3.0, 0.0, coulomb, 0.6, grid_s), atol=1e-5)


def test_dry_friction_takes_the_same_from_every_half_swing_and_then_holds() -> None:
    """On a spring each half swing loses 2 f / w^2, until the spring is weaker than friction."""
    coulomb, start = 0.3, 0.5
    grid_s = np.arange(0.0, 12.0, np.pi / 3.0 / 12.0)
    found, rate = move(
        pull(np.array([coulomb]), is_linear=True), np.array([start]), np.zeros(1), grid_s
    )
    lost = 2.0 * coulomb / 9.0
    turning = start - lost * np.arange(int(start / lost) + 1)
    turning = turning[: int(np.flatnonzero(turning * 9.0 <= coulomb)[0]) + 1]
    at = found[::12][: len(turning), 0]
    np.testing.assert_allclose(np.abs(at), turning, atol=2e-4)
    assert np.ptp(found[12 * len(turning) :, 0]) == 0.0
    assert np.all(rate[12 * len(turning) :, 0] == 0.0)


def test_particles_do_not_feel_each_other() -> None:
    grid_s = np.arange(0.0, 8.0, 0.08)
    start, coulomb = np.array([0.5, -0.2, 0.01]), np.array([0.0, 0.2, 0.5])
    together, _ = move(pull(coulomb), start, np.zeros(3), grid_s)
    for k in range(3):
        alone, _ = move(pull(coulomb[k : k + 1]), start[k : k + 1], np.zeros(1), grid_s)
        np.testing.assert_array_equal(together[:, k], alone[:, 0])


@pytest.mark.parametrize(
    ("omega", "viscous", "coulomb", "start"),
    [(2.6, 0.05, 0.03, 0.4), (4.2, 0.14, 0.07, 0.6)],
)
def test_frictions_come_back_without_a_shift_between_them(
    omega: float, viscous: float, coulomb: float, start: float
) -> None:
    t = np.arange(0.0, 20.0, 1.0 / 40.0)
    swing = free_part(Swing(t, exact(omega, viscous, coulomb, start, t)), NOISE_RAD)
    assert swing is not None
    problem = make_problem((swing,), np.nan, NOISE_RAD)
    frictions = tuple(o for o in problem.options if o.key != "air_drag")
    found = fit(problem, frictions, {})
    values = found.as_mapping()
    assert values["passive_viscous_friction.extra_viscous_per_s"] == pytest.approx(
        viscous, rel=2e-3
    )
    assert values["passive_coulomb_friction.extra_coulomb_rad_per_s2"] == pytest.approx(
        coulomb, rel=2e-3
    )
