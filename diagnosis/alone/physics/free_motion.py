"""Free motion of bodies that something pulls back to rest, many at once, with exact dry friction.

Dry friction changes its sign where a body turns around. A step across that point is cut there: a sign made
smooth, or a step that runs over it, loses up to 3 % of the friction at 24 steps a period.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from machine.conventions import Array, BoolArray

Law = Callable[[Array, Array, Array], Array]


@dataclass(frozen=True, slots=True)
class Pull:
    """What acts on each particle, (particles,) each, or None; angles in rad, or ways in m on a spring.

    x'' = -w^2 sin(x - rest) - s (x - rest) - c x' - f sign(x') - q |x'| x'; on a spring the sine is x - rest.
    """

    square_per_s2: Array
    """w^2"""
    rest: Array
    stiff_per_s2: Array | None
    """s"""
    viscous_per_s: Array | None
    """c"""
    coulomb: Array | None
    """f, unit of the deflection/s^2"""
    air: Array | None
    """q, 1/unit of the deflection"""
    is_linear: bool = False

    def back(self, x: Array) -> Array:
        """Acceleration towards rest, without losses."""
        away = x - self.rest
        found = -self.square_per_s2 * (away if self.is_linear else np.sin(away))
        if self.stiff_per_s2 is not None:
            found -= self.stiff_per_s2 * away
        return found

    def acceleration(self, x: Array, v: Array, side: Array) -> Array:
        """Of all that acts; `side` is 1 or -1, 0 where friction holds."""
        found = self.back(x)
        if self.viscous_per_s is not None:
            found -= self.viscous_per_s * v
        if self.coulomb is not None:
            found -= self.coulomb * side
        if self.air is not None:
            found -= self.air * np.abs(v) * v
        return found

    def side(self, x: Array, v: Array) -> Array:
        """Where each particle goes: as it moves, or at rest as it is pulled; 0 where friction holds it."""
        if np.all(v != 0.0):
            return np.sign(v)
        pull = self.back(x)
        held = np.abs(pull) <= (0.0 if self.coulomb is None else self.coulomb)
        return np.where(v != 0.0, np.sign(v), np.where(held, 0.0, np.sign(pull)))

    def of(self, chosen: BoolArray) -> "Pull":
        """On some of the particles."""
        return Pull(
            self.square_per_s2[chosen],
            self.rest[chosen],
            *(
                None if part is None else part[chosen]
                for part in (self.stiff_per_s2, self.viscous_per_s, self.coulomb, self.air)
            ),
            is_linear=self.is_linear,
        )


def move(pull: Pull, start: Array, rate: Array, grid_s: Array) -> tuple[Array, Array]:
    """Deflections and rates at the times of an even grid that begins at 0, (steps, particles) each.

    Args:
        pull: what acts on each.
        start: (particles,) deflection at 0 s.
        rate: (particles,) its rate there.
        grid_s: (steps,) times.
    """
    xs, vs = np.empty((len(grid_s), len(start))), np.empty((len(grid_s), len(start)))
    x, v, step_s = start, rate, np.full(len(start), grid_s[1])
    dry = np.zeros(len(start), bool) if pull.coulomb is None else pull.coulomb > 0.0
    is_dry, law, no_side = bool(np.any(dry)), pull.acceleration, np.zeros_like(start)
    for index in range(len(grid_s)):
        xs[index], vs[index] = x, v
        side = pull.side(x, v) if is_dry else no_side
        moved_x, moved_v = _step(law, x, v, side, step_s)
        if is_dry:
            turned = dry & (side * moved_v <= 0.0)
            if np.any(turned):
                moved_x[turned], moved_v[turned] = _turn(
                    pull.of(turned), x[turned], v[turned], side[turned], step_s[turned]
                )
        x, v = moved_x, moved_v
    return xs, vs


def _turn(pull: Pull, x: Array, v: Array, side: Array, step_s: Array) -> tuple[Array, Array]:
    """A step in which each particle comes to rest: up to that moment, then back or held."""
    law = pull.acceleration
    until_s = np.clip(_until_rest(law, x, v, side), 0.0, step_s)
    # Newton's method for the moment at which the rate is 0: it is nearly a line there, once is enough.
    near_x, near_v = _step(law, x, v, side, until_s)
    until_s = np.clip(until_s + _until_rest(law, near_x, near_v, side), 0.0, step_s)
    turned_x, _ = _step(law, x, v, side, until_s)
    nothing = np.zeros_like(x)
    back = pull.side(turned_x, nothing)
    moved_x, moved_v = _step(law, turned_x, nothing, back, step_s - until_s)
    return np.where(back == 0.0, turned_x, moved_x), np.where(back == 0.0, 0.0, moved_v)


def _until_rest(law: Law, x: Array, v: Array, side: Array) -> Array:
    """Time in s until the rate is 0 if the acceleration stays as it is; 0 where there is none."""
    slowed = law(x, v, side)
    return np.divide(-v, slowed, out=np.zeros_like(v), where=slowed != 0.0)


def _step(law: Law, x: Array, v: Array, side: Array, h: Array) -> tuple[Array, Array]:
    """One step of the classical Runge-Kutta method, h (particles,) in s."""
    half, sixth = 0.5 * h, h / 6.0
    a1 = law(x, v, side)
    v2 = v + half * a1
    a2 = law(x + half * v, v2, side)
    v3 = v + half * a2
    a3 = law(x + half * v2, v3, side)
    v4 = v + h * a3
    a4 = law(x + h * v3, v4, side)
    return (
        x + sixth * (v + 2.0 * (v2 + v3) + v4),
        v + sixth * (a1 + 2.0 * (a2 + a3) + a4),
    )
