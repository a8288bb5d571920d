"""Exact steps of first- and second-order lags whose input is held over a step."""

import numpy as np

from machine.conventions import CONTROL_PERIOD_S, Array


def lag_matrices(
    natural_frequency_rad_per_s: Array, damping_ratio: Array, period_s: float
) -> tuple[Array, Array, Array, Array]:
    """Exact step of e'' + 2 z w e' + w^2 e = 0 in the state (e, e'/w), e = y - u with u held.

    With tau = w h and s = sqrt(z^2 - 1): exp(-z tau) [[C + z S, S], [-S, C - z S]],
    C = cosh(s tau), S = sinh(s tau) / s (tau at s = 0).

    Args:
        natural_frequency_rad_per_s: w, any shape.
        damping_ratio: z, same shape.
        period_s: h.

    Returns:
        The four elements of the matrix, each of that shape.
    """
    tau = natural_frequency_rad_per_s * period_s
    s = np.sqrt(np.asarray(damping_ratio**2 - 1.0, dtype=np.complex128))
    small = np.abs(s * tau) < 1e-6
    cosh = np.real(np.cosh(s * tau))
    sinh = np.where(small, tau, np.real(np.sinh(s * tau) / np.where(small, 1.0, s)))
    decay = np.exp(-damping_ratio * tau)
    return (
        decay * (cosh + damping_ratio * sinh),
        decay * sinh,
        -decay * sinh,
        decay * (cosh - damping_ratio * sinh),
    )


def first_order(lag_s: Array) -> tuple[Array, Array]:
    """What is left of a first-order lag's error after a control tick, and its mean over the tick.

    exp(-h / T) and (1 - exp(-h / T)) T / h; both 0 without a lag.

    Args:
        lag_s: T, any shape.
    """
    share = np.maximum(lag_s, 1e-9) / CONTROL_PERIOD_S
    decay = np.where(lag_s > 0.0, np.exp(-1.0 / share), 0.0)
    return decay, np.where(lag_s > 0.0, (1.0 - decay) * share, 0.0)
