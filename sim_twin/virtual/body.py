"""The virtual machine's rigid body: the MJCF with one unit's lengths, masses and tilt, and true sensors."""

from typing import NamedTuple, Protocol

import mujoco
import numpy as np

from machine.conventions import PASSIVE_JOINTS, Array
from machine.spec import MJCF_PATH, MachineSpec
from sim_twin.virtual.units import MachineUnit

ACCEL = slice(0, 3)
GYRO = slice(3, 6)
GRIP_POSITION = slice(6, 9)
GRIP_VELOCITY = slice(9, 12)
GRIP_RATE = slice(12, 15)
"""Columns of the model's true sensor data; the grip's are in frame `machine`, the IMU's in its own."""


class PlantBody(NamedTuple):
    """A compiled unit and the friction of its two free joints, shape (2,), N m s/rad and N m."""

    model: mujoco.MjModel
    swing_viscous: Array
    swing_coulomb: Array


class BodyFaults(Protocol):
    """Faults of the body (sim_twin.faults.body_faults)."""

    def build(self, tree: mujoco.MjSpec) -> None:
        """Change the MJCF tree of one unit before compilation."""
        ...


def build_body(
    spec: MachineSpec,
    unit: MachineUnit,
    step_s: float,
    integrator: mujoco.mjtIntegrator = mujoco.mjtIntegrator.mjINT_EULER,
    faults: BodyFaults | None = None,
) -> PlantBody:
    """Compile the model of one unit, without drives, joint friction and end stops."""
    tree = mujoco.MjSpec.from_file(str(MJCF_PATH))
    tree.option.timestep = step_s
    tree.option.integrator = integrator
    off = mujoco.mjtDisableBit
    # Automatic resets would hide a divergence by moving the machine to zero.
    tree.option.disableflags |= int(off.mjDSBL_EULERDAMP) | int(off.mjDSBL_AUTORESET)
    for geom in list(tree.geoms):
        if not geom.contype and not geom.conaffinity:
            tree.delete(geom)
    swing = [tree.joint(name) for name in PASSIVE_JOINTS]
    viscous = np.array([float(np.ravel(joint.damping)[0]) for joint in swing])
    coulomb = np.array([float(joint.frictionloss) for joint in swing])
    # Hydraulic end stops and smooth bearing friction replace MuJoCo's constraints, at half the cost.
    for joint in tree.joints:
        joint.limited = mujoco.mjtLimited.mjLIMITED_FALSE
        joint.frictionloss = 0.0
        joint.damping = np.zeros_like(joint.damping)
    _place(tree, spec, unit)
    _weigh(tree, unit)
    if faults is not None:
        faults.build(tree)
    site = mujoco.mjtObj.mjOBJ_SITE
    for kind, name in (
        (mujoco.mjtSensor.mjSENS_ACCELEROMETER, "imu"),
        (mujoco.mjtSensor.mjSENS_GYRO, "imu"),
        (mujoco.mjtSensor.mjSENS_FRAMEPOS, "grip_centre"),
        (mujoco.mjtSensor.mjSENS_FRAMELINVEL, "grip_centre"),
        (mujoco.mjtSensor.mjSENS_FRAMEANGVEL, "grip_centre"),
    ):
        tree.add_sensor(type=kind, objtype=site, objname=name)
    return PlantBody(
        tree.compile(), viscous * unit.swing_viscous_ratio, coulomb * unit.swing_coulomb_ratio
    )


def _place(tree: mujoco.MjSpec, spec: MachineSpec, unit: MachineUnit) -> None:
    chassis = tree.body("chassis")
    chassis.pos[2] += unit.base_height_error_m
    roll, pitch = 0.5 * unit.base_tilt_rad[0], 0.5 * unit.base_tilt_rad[1]
    chassis.quat = np.array([1.0, roll, pitch, 0.0]) / np.sqrt(1.0 + roll**2 + pitch**2)
    boom = tree.body("boom")
    boom.pos[0], boom.pos[2] = unit.boom_pivot_x_m, unit.boom_pivot_z_m
    tree.body("dipper").pos[0] = unit.boom_length_m
    tree.body("telescope").pos[2] = -unit.dipper_to_telescope_m
    tree.body("hanger").pos[2] = -unit.telescope_to_pin_m
    tree.body("gripper").pos[2] = -unit.pitch_to_roll_m
    tree.site("grip_centre").pos[2] = -unit.roll_to_grip_centre_m
    tree.body("payload").pos[2] = -unit.roll_to_grip_centre_m
    longer = unit.roll_to_grip_centre_m - spec.geometry.roll_to_grip_centre_m
    tree.geom("gripper_claw_collision").pos[2] -= longer


def _weigh(tree: mujoco.MjSpec, unit: MachineUnit) -> None:
    for name, ratio in (
        ("upper", unit.upper_mass_ratio),
        ("boom", unit.boom_mass_ratio),
        ("dipper", unit.dipper_mass_ratio),
        ("telescope", unit.telescope_mass_ratio),
    ):
        body = tree.body(name)
        body.mass *= ratio
        body.inertia = np.asarray(body.inertia) * ratio
    gripper = tree.body("gripper")
    gripper.mass = unit.gripper_mass_kg
    gripper.inertia = np.asarray(gripper.inertia) * unit.gripper_inertia_ratio
    gripper.ipos[2] = -unit.gripper_com_m
    tree.body("payload").mass = unit.ball_mass_kg
