"""Sensor samples made by hand."""

from dataclasses import replace
from typing import Any

import numpy as np

from machine.starts import safe_pose
from runtime.driver import SensorSample

NOW_NS = 5_000_000_000


def at_rest(count: int = 1, now_ns: int = NOW_NS, pose=None, **changes: Any) -> SensorSample:
    """Machines that stand in a pose (6,) or (N, 6) with a plumb gripper and a load."""
    poses = np.broadcast_to(safe_pose() if pose is None else pose, (count, 6))
    sample = SensorSample(
        t_mono_ns=now_ns,
        joint_position_rad_m=poses[:, :4].copy(),
        joint_velocity_rad_m_per_s=np.zeros((count, 4)),
        imu_t_mono_ns=np.full(count, now_ns - 20_000_000),
        imu_gyro_rad_per_s=np.zeros((count, 3)),
        imu_accel_m_per_s2=np.tile([0.0, 0.0, 9.81], (count, 1)),
        payload_held=np.ones(count, dtype=np.bool_),
        supply_pressure_pa=np.full(count, 35e6),
        local_enable=np.ones(count, dtype=np.bool_),
        emergency_stop=np.zeros(count, dtype=np.bool_),
        ball_t_mono_ns=np.zeros(count, dtype=np.int64),
        ball_position_m=np.full((count, 3), np.nan),
        impact_t_mono_ns=np.zeros(count, dtype=np.int64),
        impact_position_m=np.full((count, 3), np.nan),
        impact_sd_m=np.full(count, np.nan),
    )
    return replace(sample, **changes)
