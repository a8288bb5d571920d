"""Rows of the log channels as numpy dtypes.

Sensor time and log time are kept apart. All arrays over joints are in joint order.
"""

import numpy as np

from machine.conventions import ACTIVE_COUNT, JOINT_COUNT

CONTROL_ROW = np.dtype(
    [
        ("t_mono_ns", np.int64),  # control tick, machine clock
        ("sensor_t_mono_ns", np.int64),  # when the joint sensors were sampled
        ("tick_count", np.int64),  # since the throw's first logged tick
        ("motion_code_count", np.int8),  # conventions.Motion
        ("sensor_position_rad_m", np.float64, ACTIVE_COUNT),  # as read
        ("sensor_velocity_rad_m_per_s", np.float64, ACTIVE_COUNT),  # as read
        ("joint_position_rad_m", np.float64, JOINT_COUNT),  # estimate used by the policy
        ("joint_velocity_rad_m_per_s", np.float64, JOINT_COUNT),  # estimate used by the policy
        ("velocity_request_rad_m_per_s", np.float64, ACTIVE_COUNT),  # from policy or state machine
        ("velocity_reference_rad_m_per_s", np.float64, ACTIVE_COUNT),  # after limits and pump flow
        ("valve_requested_ratio", np.float64, ACTIVE_COUNT),  # what the controller wants, -1..1
        ("valve_applied_ratio", np.float64, ACTIVE_COUNT),  # what the safety gate let through
        ("safety_code_count", np.int32),  # bit set of safety.Intervention; 0 = none
        ("gripper_open_commanded", np.bool_),
        ("payload_held", np.bool_),  # gripper switch
        ("supply_pressure_pa", np.float64),
    ]
)

POLICY_ROW = np.dtype(
    [
        ("t_mono_ns", np.int64),
        (
            "observation_ratio",
            np.float64,
            65,
        ),  # mixed units, order in docs/throw_log.md; 2D fills 56
        ("action_ratio", np.float64, 5),  # 3D: 4 joints + release; 2D: 3 joints + release, then 0
    ]
)

IMU_ROW = np.dtype(
    [
        ("t_mono_ns", np.int64),  # sample time, machine clock
        ("gyro_rad_per_s", np.float64, 3),  # gripper frame, as driver.SensorSample
        ("accel_m_per_s2", np.float64, 3),  # specific force, gripper frame
    ]
)

BALL_ROW = np.dtype(
    [
        ("t_mono_ns", np.int64),  # sample time, machine clock
        ("position_m", np.float64, 3),  # frame `machine`
    ]
)
