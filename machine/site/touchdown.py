"""Flight of released loads to their first contact with a site."""

from typing import NamedTuple

import numpy as np

from machine.ballistics import MAX_FLIGHT_S, STEP_S, Spin, step_flight
from machine.conventions import Array
from machine.site.solids import Contact, Solids, touch_share


class Touchdown(NamedTuple):
    """First contacts of N loads; NaN and solid -1 without contact within 6 s."""

    contact: Contact
    centre_m: Array
    """(N, 3) velocity at contact."""
    time_s: Array
    """(N,) time since the start of the flight."""


def touchdown(
    solids: Solids,
    radius_m: float,
    position_m: Array,
    velocity_m_per_s: Array,
    drag_per_m: Array,
    wind_m_per_s: Array,
    spin: Spin | None = None,
) -> Touchdown:
    """Simulate flights (N, 3) until the loads touch ground or an object.

    Args:
        solids: the site.
        radius_m: radius of the load.
        position_m: (N, 3) release positions, frame `machine`; NaN for loads without a flight.
        velocity_m_per_s: (N, 3) release velocities.
        drag_per_m: (N,) k of machine.ballistics.
        wind_m_per_s: (N, 3).
        spin: spin of all loads; none if omitted.
    """
    count = position_m.shape[0]
    path, speed = [position_m], [velocity_m_per_s]
    # Loads below the lowest surface have no contact; so are loads without a flight.
    for _ in range(int(MAX_FLIGHT_S / STEP_S)):
        if not np.any(path[-1][:, 2] > solids.floor_m):
            break
        p, v = step_flight(path[-1], speed[-1], drag_per_m, wind_m_per_s, STEP_S, spin)
        path.append(p)
        speed.append(v)
    positions, velocities = np.stack(path), np.stack(speed)
    closes = solids.closes(positions[:-1], positions[1:], radius_m)
    rows = np.flatnonzero(closes.any(axis=0))
    before = closes.argmax(axis=0)[rows] if rows.size else rows
    p0, v0 = positions[before, rows], velocities[before, rows]
    drag, wind = drag_per_m[rows], wind_m_per_s[rows]
    turn = None if spin is None else spin.of(rows)

    def fly(share: Array) -> Array:
        return step_flight(p0, v0, drag, wind, share * STEP_S, turn)[0]

    share = touch_share(lambda u: solids.distance(fly(u)) - radius_m, rows.size)
    centre, time_s = np.full((count, 3), np.nan), np.full(count, np.nan)
    point = np.full((count, 3), np.nan)
    solid, is_side = np.full(count, -1, dtype=np.int64), np.zeros(count, dtype=np.bool_)
    if rows.size:
        centre[rows] = fly(share)
        time_s[rows] = (before + share) * STEP_S
        point[rows], solid[rows], is_side[rows] = solids.contact(centre[rows], radius_m)
    return Touchdown(Contact(point, solid, is_side), centre, time_s)
