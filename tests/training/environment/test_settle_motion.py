import numpy as np

from machine.conventions import Array
from machine.kinematics import hanging_pitch_rad
from machine.spec import load_spec
from runtime.control import control_loop, swing_control
from runtime.control.arm_motion import ArmMotion
from runtime.control.imu_estimator import ImuEstimate
from sim_twin.twin.twin import Twin
from training.environment.settle_motion import settle_request

SPEC = load_spec()


def _runtime_request(q: Array, v: Array) -> Array:
    count = len(q)
    plant = Twin.for_plant(count=count, unit_seed=0)
    sample = plant.read()
    sample.joint_position_rad_m[:] = q[:, :4]
    sample.joint_velocity_rad_m_per_s[:] = v[:, :4]
    fields = {name: np.zeros(count) for name in ImuEstimate._fields}
    fields |= {
        "swing_rad": q[:, 1] + q[:, 2] + q[:, 4],
        "swing_rate_rad_per_s": v[:, 1] + v[:, 2] + v[:, 4],
        "roll_rad": q[:, 5],
        "roll_rate_rad_per_s": v[:, 5],
    }
    imu = ImuEstimate(**fields)
    amplitude = swing_control.swing_amplitude_rad(SPEC, imu)
    _, output = swing_control.settle(
        SPEC,
        swing_control.initial_swing(q[:, 0]),
        q[:, :4],
        v[:, :4],
        ArmMotion.of(SPEC, sample),
        imu,
        amplitude,
    )
    return output.request_rad_m_per_s


def test_settle_request_is_the_runtimes():
    assert control_loop.swing_control is swing_control
    rng = np.random.default_rng(0)
    q = np.zeros((64, 6))
    q[:, :4] = rng.uniform([-3.0, -0.1, -1.1, 0.0], [3.0, 1.28, 1.0, 1.7], (64, 4))
    q[:, 4] = hanging_pitch_rad(q[:, :4]) + rng.uniform(-1.2, 1.2, 64)
    q[:, 5] = rng.uniform(-0.8, 0.8, 64)
    v = rng.uniform(-1.0, 1.0, (64, 6)) * np.array([0.9, 0.5, 0.7, 0.5, 3.0, 2.0])
    np.testing.assert_allclose(
        settle_request(SPEC, np.zeros(64), q, v), _runtime_request(q, v), atol=1e-9
    )
