"""Replays of the driven joints alone: from logged valve commands to joint velocities, without rigid bodies.

The twin's drives are stiff: the reaction of the arm changes their velocity by less than 1 mrad/s
(tests/sim_twin/replay/test_short_replays.py), and its simulation takes most of a replay's time.
"""

from collections.abc import Sequence

import numpy as np

from machine.calibration import ValveCalibration
from machine.conventions import ACTIVE_COUNT, CONTROL_PERIOD_S, Array
from machine.spec import load_spec
from sim_twin.effects.arrays import effect_arrays
from sim_twin.effects.effect import deterministic
from sim_twin.replay.motion import padded
from sim_twin.replay.types import ReplayElement, ReplayInput
from sim_twin.twin.profile import TwinProfile, exact_profile
from sim_twin.twin.response import VelocityResponse

STOP_RAD_M = 3e-3
"""Distance from the end of travel within which a joint is at its end stop: twice the position noise."""
STEADYING_TICKS = 9
"""Ticks over which velocities are averaged to detect standstill: 0.1 s."""


def replay_drives(
    inputs: Sequence[ReplayInput],
    elements: Sequence[ReplayElement],
    profile: TwinProfile,
    calibration: ValveCalibration,
    *,
    as_measured: bool = False,
) -> Array:
    """True velocities (M, T, 4) of the driven joints at every tick, rad/s and m/s, without sensor latency.

    Args:
        inputs: recorded throws; T is the number of ticks of the longest.
        elements: simulations; their measured joints are ignored.
        profile: profile of the machine; its effects act in every element.
        calibration: valve tables of the machine.
        as_measured: take lever arms, loads and end stops from the recorded joint positions, let sticking
            joints stop when the recorded ones did, and take the initial state of the slew's backlash from
            the recorded motion: whether a slow joint stops decides the rest of the simulation.
    """
    spec, exact, count = load_spec(), exact_profile(profile), len(elements)
    throws = [inputs[e.throw] for e in elements]
    arrays = effect_arrays(
        count,
        exact.effects,
        [deterministic(e.effects) for e in elements],
        np.array([t.progress_ratio for t in throws]),
    )
    response = VelocityResponse(spec, exact, calibration, count, arrays)
    response.reset(np.zeros((count, 3, ACTIVE_COUNT)))
    position = np.stack([t.position_rad_m[0] for t in throws])
    bias = None if arrays is None else arrays.get("joint_sensor_bias", "bias_rad_m")
    if bias is not None:
        position = position - bias
    low, high = spec.position_range_rad_m
    ticks = max(t.valve_ratio.shape[0] for t in throws)
    valve = np.stack([padded(t.valve_ratio, ticks, hold=False) for t in throws], axis=1)
    used = {e.throw for e in elements}
    steadied = {i: padded(_steadied(inputs[i]), ticks, hold=False) for i in used}
    seen = np.stack([steadied[e.throw] for e in elements], axis=1)
    place = np.stack([padded(t.position_rad_m, ticks, hold=True) for t in throws], axis=1)
    if bias is not None:
        place = place - bias
    out = np.zeros((count, ticks, ACTIVE_COUNT))
    for tick in range(ticks - 1):
        reference = response.step(
            valve[tick],
            place[tick] if as_measured else position,
            seen[tick + 1] if as_measured else None,
        )
        # A cylinder at its end stop stands still for any valve command.
        least, most = (low - position) / CONTROL_PERIOD_S, (high - position) / CONTROL_PERIOD_S
        if as_measured:
            least = np.where(place[tick] < low + STOP_RAD_M, 0.0, -np.inf)
            most = np.where(place[tick] > high - STOP_RAD_M, 0.0, np.inf)
        out[:, tick + 1] = np.clip(reference, least, most)
        position = position + CONTROL_PERIOD_S * out[:, tick + 1]
    return out


def _steadied(one: ReplayInput) -> Array:
    """Measured velocities (T, 4) over `STEADYING_TICKS` about every tick."""
    window = np.full(STEADYING_TICKS, 1.0 / STEADYING_TICKS)
    return np.apply_along_axis(np.convolve, 0, one.velocity_rad_m_per_s, window, mode="same")
