"""Predictions of the twin at the sensors' sample times."""

import numpy as np

from diagnosis.healthy.filters import nothing
from diagnosis.linearisation.parameters import ReplayKind
from diagnosis.linearisation.predictions import predict
from diagnosis.linearisation.simulation import simulate
from diagnosis.linearisation.simulation_batch import ALL
from diagnosis.loading.prepared import PreparedThrow, prepare
from machine.conventions import Array
from sim_twin.replay.replay import ReplayElement
from sim_twin.twin.profile import TwinProfile
from tests.diagnosis.twin_throws import profile, throws

START_SWING_RAD = 0.5


def free_swing(prepared: PreparedThrow, twin: TwinProfile) -> Array:
    """What the twin says of a throw whose joints stand while the gripper swings, (n,)."""
    still = prepared.input._replace(
        position_rad_m=np.tile(prepared.input.position_rad_m[0], (len(prepared.motion.t_s), 1)),
        velocity_rad_m_per_s=np.zeros_like(prepared.motion.velocity_rad_m_per_s),
        swing_start_rad=prepared.input.swing_start_rad + np.array([START_SWING_RAD, 0.0]),
        hung_at_rest=False,
    )
    elements = [ReplayElement(0, (), ALL)]
    output = simulate([still], elements, [ReplayKind.SWING], twin, prepared.throw.calibration)
    return predict(prepared, output, np.array([0]), ReplayKind.SWING, (), nothing())[0]


def left_if_early(at_s: Array, rate: Array, force: Array, early_s: float) -> float:
    """What is left of the forces (n, k) if they were reported so much early."""
    turn = np.gradient(rate, at_s)
    columns = np.column_stack([np.ones(rate.size), rate**2, turn])[2:-2]
    real = np.stack([np.interp(at_s - early_s, at_s, one) for one in force.T], axis=1)[2:-2]
    known, *_ = np.linalg.lstsq(columns, real)
    return float(np.sum((real - columns @ known) ** 2))


def test_specific_force_and_rate_are_predicted_for_the_same_moment() -> None:
    none = (0.0, 0.0)
    twin = profile().model_copy(
        update={"viscous_friction_per_s": none, "coulomb_friction_rad_per_s2": none}
    )
    (prepared,) = prepare(throws(count=1).throws, twin)
    found = free_swing(prepared, twin)
    blocks = {block.name: found[block.rows] for block in prepared.blocks}
    at_s = prepared.imu_pair @ prepared.imu_at_s
    rate = blocks["swing.gyro.y"]
    force = np.stack([blocks["swing.accel.x"], blocks["swing.accel.z"]], axis=1)
    early_s = np.linspace(-0.01, 0.01, 41)
    left = [left_if_early(at_s, rate, force, one_s) for one_s in early_s]
    assert np.ptp(rate) > 2.0
    # The part of the rate squared is of the row itself; the rows alone are 3.5 ms early here.
    assert abs(early_s[np.argmin(left)]) < 2e-3
