"""Replays of the driven joints alone: from logged valve commands to joint velocities, without a body.

The twin's drives are stiff: what the arm does to them changes their velocity by less than 1 mrad/s
(tests/sim_twin/replay/test_short_replays.py measures it), and costs most of a replay's time.
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


def replay_drives(
    inputs: Sequence[ReplayInput],
    elements: Sequence[ReplayElement],
    profile: TwinProfile,
    calibration: ValveCalibration,
) -> Array:
    """True velocities (M, T, 4) of the driven joints at every tick, rad/s and m/s; no sensor's latency.

    Args:
        inputs: recorded throws; T is the longest one's number of ticks.
        elements: what to simulate; what they take as measured is not looked at.
        profile: of the machine; its own effects act in every element.
        calibration: of its valves.
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
    out = np.zeros((count, ticks, ACTIVE_COUNT))
    for tick in range(ticks - 1):
        reference = response.step(valve[tick], position)
        # A cylinder at its end stop stands still, whatever its valve does.
        reference = np.maximum(reference, (low - position) / CONTROL_PERIOD_S)
        out[:, tick + 1] = np.minimum(reference, (high - position) / CONTROL_PERIOD_S)
        position = position + CONTROL_PERIOD_S * out[:, tick + 1]
    return out
