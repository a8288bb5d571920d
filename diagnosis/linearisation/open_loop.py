"""Open-loop simulation of throws from their valve commands, with the known misfit of healthy machines."""

from collections.abc import Sequence

import numpy as np

from diagnosis.healthy.filters import HealthyModel, correction
from diagnosis.linearisation.simulation import joint_latency_s, late, sliced
from diagnosis.linearisation.simulation_batch import ALL
from diagnosis.loading.prepared import PreparedThrow
from machine.calibration import ValveCalibration
from machine.conventions import ACTIVE_COUNT, CONTROL_PERIOD_S, Array
from sim_twin.replay.drives import replay_drives
from sim_twin.replay.replay import ReplayElement, ReplayInput, replay
from sim_twin.twin.profile import TwinProfile

AFTER_COMMAND_S = 1.0
"""Simulated time after the opening command, s; the load has left by then, whatever delays its release."""


def impacts(
    prepared: Sequence[PreparedThrow],
    healthy: HealthyModel,
    profile: TwinProfile,
    calibration: ValveCalibration,
) -> Array:
    """Impacts (N, 2) from the valve commands alone, with the deviations that all healthy machines share.

    The driven joints are simulated from their commands and corrected by the healthy filters. They then
    drive swing, release and flight.
    """
    inputs = [p.input for p in prepared]
    alone = replay_drives(
        inputs, [ReplayElement(i) for i in range(len(inputs))], profile, calibration
    )
    moved = [
        sliced(
            corrected_input(p, healthy, alone[i], joint_latency_s(profile.effects, p.input)),
            0,
            p.input.release_t_s + AFTER_COMMAND_S,
        )
        for i, p in enumerate(prepared)
    ]
    elements = [ReplayElement(i, measured_joints=ALL) for i in range(len(inputs))]
    return replay(moved, elements, profile, calibration).impact_m[:, :2]


def corrected_input(
    p: PreparedThrow, healthy: HealthyModel, velocity: Array, latency_s: Array
) -> ReplayInput:
    """The throw with simulated and corrected joint motion, as its sensors report it, for the measured one."""
    rows = p.motion.t_s.size
    corrected, motion = velocity[:rows].copy(), p.motion.early(latency_s)
    for joint in range(ACTIVE_COUNT):
        track = velocity[:rows, joint]
        track = track + correction(healthy, motion, joint, track)
        corrected[:, joint] = late(track, float(latency_s[joint]))
    travelled = np.cumsum(corrected[1:] * CONTROL_PERIOD_S, axis=0)
    start = p.input.position_rad_m[:1]
    position = np.vstack([start, start + travelled])
    return p.input._replace(position_rad_m=position, velocity_rad_m_per_s=corrected)
