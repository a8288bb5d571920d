"""Motion of the tool pin in the arm plane: what swings the gripper, and what can damp it; batched."""

from typing import NamedTuple

import numpy as np

from machine.conventions import Array
from machine.kinematics import components
from machine.spec import MachineSpec
from runtime.driver import SensorSample


class ArmMotion(NamedTuple):
    """Tool pin of N machines at one tick."""

    radius_m: Array
    """(N,) from the slew axis, in the arm plane."""
    dipper_arm_m: Array
    """(N,) outward motion of the pin a radian of the dipper."""
    telescope_arm_ratio: Array
    """(N,) outward motion of the pin a metre of the telescope."""
    velocity_rad_m_per_s: Array
    """(3, N) outward and up in the turning arm plane, and the slew rate."""

    @classmethod
    def of(cls, spec: MachineSpec, sample: SensorSample) -> "ArmMotion":
        """From the joint sensors, by the derivative of machine.kinematics.pin_in_plane."""
        g = spec.geometry
        position, velocity = sample.joint_position_rad_m.T, sample.joint_velocity_rad_m_per_s.T
        _, boom, dipper, extension = components(position)
        turning, boom_rate, dipper_rate, extending = components(velocity)
        tube = boom + dipper
        cos_tube, sin_tube = np.cos(tube), np.sin(tube)
        length = g.dipper_to_telescope_m + g.telescope_to_pin_m + extension
        across = g.telescope_axis_offset_m * cos_tube + length * sin_tube
        along = length * cos_tube - g.telescope_axis_offset_m * sin_tube
        boom_x, boom_z = g.boom_length_m * np.cos(boom), g.boom_length_m * np.sin(boom)
        tube_rate = boom_rate + dipper_rate
        rows = np.empty((6, position.shape[1]))
        rows[0] = along * tube_rate - boom_z * boom_rate + sin_tube * extending
        rows[1] = across * tube_rate + boom_x * boom_rate - cos_tube * extending
        rows[2] = turning
        rows[3] = g.boom_pivot_m[0] + boom_x + across
        rows[4] = along
        rows[5] = sin_tube
        return cls(
            radius_m=rows[3],
            dipper_arm_m=rows[4],
            telescope_arm_ratio=rows[5],
            velocity_rad_m_per_s=rows[:3],
        )
