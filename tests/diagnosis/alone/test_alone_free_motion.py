"""Free motion with dry friction, against a solver that stops at every turning point."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from diagnosis.alone.fit import fit
from diagnosis.alone.physics.free_motion import Pull, move
from diagnosis.alone.reading.decay import COULOMB, VISCOUS, frictions_of_decay
from diagnosis.alone.reading.free_swings import Swing, free_part, swing_noise
from diagnosis.alone.swing_problem import make_problem

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
    return Pull(nothing + 9.0, nothing, None, None, coulomb, None, is_linear)


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
    [(2.6, 0.05, 0.03, 0.4), (4.2, 0.14, 0.07, 0.6), (6.0, 0.03, 0.04, 0.9)],
)
def test_frictions_come_back_without_a_shift_between_them(
    omega: float, viscous: float, coulomb: float, start: float
) -> None:
    t = np.arange(0.0, 52.0 / omega, 1.0 / 40.0)
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


STOPPED = (2.5, 0.142, 0.061, 0.5)
"""rad/s, 1/s, rad/s^2, rad: at rest after 14 s, 9 mrad from the middle."""


def stopped_swing(noise: float, rate_hz: float = 20.0) -> Swing:
    """A swing that dry friction stops long before its record ends."""
    t = np.arange(0.0, 30.0, 1.0 / rate_hz)
    return Swing(t, exact(*STOPPED, t) + np.random.default_rng(3).normal(0.0, noise, len(t)))


def test_what_follows_after_dry_friction_has_stopped_the_body_is_no_swing() -> None:
    swing = stopped_swing(0.002)
    rests_s = float(swing.time_s[np.argmax(np.abs(np.diff(exact(*STOPPED, swing.time_s))) == 0.0)])
    free = free_part(swing, swing_noise([swing]))
    assert free is not None
    assert free.time_s[-1] == pytest.approx(rests_s, abs=2.6)  # a period


def test_the_fit_does_not_end_where_the_body_rests_on_the_wrong_side() -> None:
    """From dry friction alone every step to both frictions runs over the stop: amplitudes show the way."""
    swing = stopped_swing(0.002)
    noise = swing_noise([swing])
    free = free_part(swing, noise)
    assert free is not None
    problem = make_problem((free,), np.nan, noise)
    dry = [o for o in problem.options if o.key == "passive_coulomb_friction"]
    both = [o for o in problem.options if o.key != "air_drag"]
    found = fit(problem, tuple(both), fit(problem, tuple(dry), {}).as_mapping())
    assert np.sqrt(found.mean_square) < 1.1 * 0.002
    assert found.as_mapping()[VISCOUS] == pytest.approx(0.142, rel=0.03)


def test_amplitudes_tell_the_frictions_roughly() -> None:
    swing = free_part(stopped_swing(0.001), 0.001)
    assert swing is not None
    guess = frictions_of_decay((swing,), 0.001, 2.5, (VISCOUS, COULOMB, "rest_rad"))
    assert guess == {VISCOUS: pytest.approx(0.142, rel=0.2), COULOMB: pytest.approx(0.061, rel=0.2)}
    assert frictions_of_decay((swing,), 0.001, 2.5, ("rest_rad",)) == {}


def test_a_slow_record_is_not_taken_for_a_noisy_one() -> None:
    t = np.arange(0.0, 20.0, 1.0 / 15.0)
    noisy = 0.9 * np.cos(7.0 * t) + np.random.default_rng(1).normal(0.0, 0.003, len(t))
    assert swing_noise([Swing(t, noisy)]) == pytest.approx(0.003, rel=0.25)


def test_a_held_body_is_not_free_however_the_noise_shakes_its_angle() -> None:
    t = np.arange(0.0, 20.0, 0.01)
    angle = np.concatenate([np.full(100, 0.12), exact(3.0, 0.05, 0.0, 0.12, t)])
    angle += np.random.default_rng(5).normal(0.0, 0.008, len(angle))
    swing = Swing(np.arange(len(angle)) * 0.01, angle)
    free = free_part(swing, 0.008)
    assert free is not None
    # From 0.9 of the amplitude on the first zero comes within 64 degrees of 2.1 s a period.
    crossed_s = float(free.time_s[np.argmax(free.angle_rad < 0.0)])
    assert 0.25 < crossed_s < 0.55
