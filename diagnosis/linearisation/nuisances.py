"""Slopes of the nuisances: deviations between throws of a healthy machine, or in the sensors of a set.

Each is a column of slopes times its standard deviation. All are marginalised; none is ever a cause.
"""

import numpy as np

from diagnosis.linearisation.parameters import SET_NUISANCES, index_of, library
from diagnosis.linearisation.sensitivities import LinearThrow
from diagnosis.loading.prepared import PreparedThrow
from machine.conventions import ACTIVE_JOINTS, Array
from machine.kinematics import rotate_z

THROW_NUISANCES = (
    "oil_flow_ratio",
    "start_pitch_rad",
    "start_roll_rad",
    "start_pitch_rate_rad_per_s",
    "start_roll_rate_rad_per_s",
    "release_delay_s",
    "switch_lag_s",
    "grasp_x_m",
    "grasp_y_m",
    "grasp_z_m",
    "slip_x_m_per_s",
    "slip_y_m_per_s",
    "slip_z_m_per_s",
)
"""Deviations between throws of any machine; those of all parameters of the library follow."""
OIL_LAG_S = 0.05 * 0.06
"""Change of the spools' lag with 1 % of flow, s: warm oil is faster."""


def throw_nuisances() -> tuple[str, ...]:
    """Names of the deviations between throws, in the order of the throw's scatter."""
    return (*THROW_NUISANCES, *(p.key for p in library()))


def set_columns(prepared: PreparedThrow, linear: LinearThrow) -> Array:
    """Slopes (n, q) of the set's nuisances."""
    out = np.zeros((linear.residual.size, len(SET_NUISANCES)))
    for kind, first in (("gyro", 0), ("accel", 3)):
        for axis, letter in enumerate("xyz"):
            block = prepared.block(f"swing.{kind}.{letter}")
            if block is not None:
                out[block.rows, first + axis] = 1.0
    _switch_and_flight(prepared, linear, out[:, 6])
    angle = np.interp(
        prepared.input.opening_t_s, prepared.motion.t_s, prepared.motion.position_rad_m[:, 0]
    )
    directions = rotate_z(np.eye(3), np.full(3, angle))
    for axis in range(3):
        flight_shift(prepared, linear, out[:, 7 + axis], np.r_[directions[axis], np.zeros(3)])
    return out


def _switch_and_flight(prepared: PreparedThrow, linear: LinearThrow, out: Array) -> None:
    """Column of a switch that reports late: the opening was earlier than assumed."""
    switch = prepared.block("release.switch")
    if switch is not None:
        out[switch.rows] = 1.0
        out -= linear.opening


def flight_shift(prepared: PreparedThrow, linear: LinearThrow, out: Array, state: Array) -> None:
    """Column of a shift (6,) of position and velocity at the release."""
    ball, impact = prepared.block("flight.ball"), prepared.block("flight.impact")
    if ball is not None:
        since = (prepared.throw.ball_t_s - linear.release_t_s)[:, None]
        out[ball.rows] = (state[:3] + since * state[3:]).ravel()
    if impact is not None:
        out[impact.rows] = linear.landing_slope @ state


def throw_columns(prepared: PreparedThrow, linear: LinearThrow) -> Array:
    """Slopes (n, q) of the throw's nuisances (`THROW_NUISANCES`)."""
    index, slopes = index_of(), linear.jacobian
    n = linear.residual.size
    gains = [
        slopes[:, index[f"valve_gain.{joint}.positive_ratio"]]
        + slopes[:, index[f"valve_gain.{joint}.negative_ratio"]]
        for joint in ACTIVE_JOINTS
    ]
    lags = [slopes[:, index[f"valve_lag.{joint}.extra_lag_s"]] for joint in ACTIVE_JOINTS]
    # Warm oil is faster as well.
    found = [np.sum(gains, axis=0) - OIL_LAG_S / 0.01 * np.sum(lags, axis=0)]
    found += list(linear.start.T)
    jitter = np.zeros(n)
    switch = prepared.block("release.switch")
    if switch is None:
        jitter += linear.opening
    else:
        jitter[switch.rows] = 1.0
    late = np.zeros(n)
    _switch_and_flight(prepared, linear, late)
    found += [jitter, late]
    for axis in range(6):
        shift = np.zeros(n)
        flight_shift(prepared, linear, shift, np.eye(6)[axis])
        found.append(shift)
    return np.column_stack(found)
