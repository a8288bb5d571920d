"""Fit a joint's oil spring (sim_twin.twin.oil_spring) to recorded valve motion, and say what it explains."""

from typing import Any, NamedTuple

import numpy as np

from machine.conventions import CONTROL_PERIOD_S, Array
from sim_twin.commissioning.drive_motion import DriveMotion
from sim_twin.twin.oil_spring import DriveArrays, OilSpringDrive, OilSprings

NAMES = (
    "dead_time_s",
    "valve_lag_s",
    "natural_frequency_rad_per_s",
    "oil_damping_ratio",
    "friction_damping_ratio",
    "reach_inertia_ratio",
    "swing_inertia_ratio",
    "acceleration_limit_rad_m_per_s2",
    "jerk_limit_rad_m_per_s3",
    "gain_ratio",
)
LOWER = np.array([0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.1, 0.5, 0.7])
UPPER = np.array([0.4, 0.4, 60.0, 2.0, 3.0, 1.0, 2.0, 40.0, 400.0, 1.3])
SCALE = np.array([0.02, 0.02, 3.0, 0.1, 0.1, 0.3, 0.3, 1.0, 5.0, 0.1])
STEP = np.array([2e-3, 2e-3, 5e-2, 1e-2, 1e-2, 2e-2, 2e-2, 3e-2, 1e-1, 2e-3])
"""Finite differences of the Jacobian."""
LIMITS = (7, 8)
"""Places of the parameters that a drive may be without: at their upper bound."""
FIRST_ROUND_COUNT = 12
"""Rounds from each start; the best goes on."""
MAX_ROUND_COUNT = 40
BOUND_MARGIN_RATIO = 0.01
"""Share of a parameter's range within which it counts as at its bound."""


class DriveFit(NamedTuple):
    """Fitted drive of one joint."""

    drive: OilSpringDrive
    at_bound: tuple[str, ...]
    """Parameters at a bound of the search for which a bound is no meaningful value."""


def simulate(record: DriveMotion, parameters: Array) -> Array:
    """Joint speeds (P, N, T) that the sensor would read with parameters (P, 10) in the order of `NAMES`."""
    count, ticks = record.actuator_speed_rad_m_per_s.shape
    column = parameters.T[:, :, None]
    springs = OilSprings(
        DriveArrays(*(np.broadcast_to(p, (len(parameters), count)) for p in column[1:9])),
        (len(parameters), count),
    )
    delayed = np.stack(
        [_delayed(record.actuator_speed_rad_m_per_s, float(d)) for d in parameters[:, 0]]
    )
    target = column[9][..., None] * delayed / record.moment_ratio
    out = np.zeros((len(parameters), count, ticks))
    for tick in range(ticks):
        out[..., tick] = springs.step(target[..., tick], record.squared_reach_ratio[:, tick])
    return _delayed(out, record.sensor_age_s + record.velocity_lag_s)


def _delayed(values: Array, by_s: float) -> Array:
    """Values (..., T) later by a time, interpolated between ticks; 0 before the first."""
    whole, fraction = divmod(by_s / CONTROL_PERIOD_S, 1.0)
    pad = [(0, 0)] * (values.ndim - 1) + [(int(whole) + 1, 0)]
    padded = np.pad(values, pad)[..., : values.shape[-1] + 1]
    return padded[..., 1:] + fraction * (padded[..., :-1] - padded[..., 1:])


def as_array(drive: OilSpringDrive) -> Array:
    """Parameters (10,) in the order of `NAMES`."""
    values = [getattr(drive, name) for name in NAMES]
    pairs = zip(values, UPPER.tolist(), strict=True)
    return np.array([most if value is None else value for value, most in pairs])


def starts(record: DriveMotion) -> list[Array]:
    """Parameter sets (10,) of a slow drive at its limits, a fast one, and a linear one."""
    v = record.velocity_rad_m_per_s
    a = float(np.quantile(np.abs(v[:, 10:] - v[:, :-10]), 0.99)) / (10.0 * CONTROL_PERIOD_S)
    slow = np.array([0.12, 0.08, 8.0, 0.3, 0.05, 0.5, 0.1, a, 3.0 * a, 1.0])
    fast = np.array([0.06, 0.03, 18.0, 0.4, 0.15, 0.5, 0.1, 1.2 * a, 5.0 * a, 1.0])
    linear = np.array([0.07, 0.03, 15.0, 0.1, 0.6, 0.1, 0.0, *UPPER[7:9], 1.0])
    return [slow, fast, linear]


def fit_drive(record: DriveMotion, first: OilSpringDrive | None = None) -> DriveFit:
    """Least-squares fit over all runs.

    Args:
        record: of one joint.
        first: drive from which the search starts; several if None.
    """
    reach = record.squared_reach_ratio
    # Where the reach does not change, its parameter says nothing.
    held = np.array([name == "reach_inertia_ratio" and np.ptp(reach) < 1e-6 for name in NAMES])

    def residual(x: Array) -> Array:
        return (simulate(record, x[None])[0] - record.velocity_rad_m_per_s).ravel()

    def slopes(x: Array) -> Array:
        step = np.where(x + STEP > UPPER, -STEP, STEP)
        values = simulate(record, np.vstack([x, x + np.diag(step)]))
        found = (values[1:] - values[0]).reshape(len(x), -1) / step[:, None]
        return np.where(held[:, None], 0.0, found).T

    jacobian: Any = slopes

    # Not at the top: every process that throws imports this module, few of them fit.
    from scipy.optimize import least_squares

    def search(start: Array, rounds: int) -> Any:
        return least_squares(
            residual,
            np.clip(np.where(held, 0.0, start), LOWER + 1e-6, UPPER - 1e-6),
            jac=jacobian,
            bounds=(LOWER, UPPER),
            x_scale=SCALE,
            max_nfev=rounds,
            ftol=1e-4,
            xtol=1e-5,
        )

    begun = starts(record) if first is None else [as_array(first)]
    best = min((search(x, FIRST_ROUND_COUNT) for x in begun), key=lambda fit: float(fit.cost))
    return _drive_fit(np.where(held, 0.0, search(best.x, MAX_ROUND_COUNT).x))


def _drive_fit(x: Array) -> DriveFit:
    """The drive of parameters (10,), without limits that are never reached."""
    values: dict[str, float | None] = dict(zip(NAMES, x.tolist(), strict=True))
    margin = BOUND_MARGIN_RATIO * (UPPER - LOWER)
    at_bound = (x > UPPER - margin) | ((x < LOWER + margin) & (LOWER > 0.0))
    for place in LIMITS:
        if x[place] > UPPER[place] - margin[place]:
            values[NAMES[place]] = None
        at_bound[place] = x[place] < LOWER[place] + STEP[place]
    # A lag, a damper or a share of 0 is a drive without it.
    return DriveFit(
        OilSpringDrive.model_validate(values),
        tuple(name for name, at in zip(NAMES, at_bound, strict=True) if at),
    )
