"""The twin's MuJoCo model, derived from machine/m545.xml."""

import logging
from copy import copy
from functools import cache

import mujoco
import numpy as np

from machine.conventions import (
    ACTIVE_JOINTS,
    CONTROL_PERIOD_S,
    JOINT_COUNT,
    PASSIVE_JOINTS,
    Array,
)
from machine.errors import PlantError
from machine.spec import MJCF_PATH, load_spec

logger = logging.getLogger(__name__)


def _note_warning(text: str) -> None:
    logger.warning("MuJoCo: %s", text.strip())


# Left to itself MuJoCo writes MUJOCO_LOG.TXT into the current folder. Who steps a model checks its numbers.
mujoco.set_mju_user_warning(_note_warning)

DRIVE_INERTIA = 1e9
"""Rotor inertia (kg m2, telescope kg) that makes a drive a velocity source: the arm's 70 kN m accelerate it
by 0.07 mrad/s2 only. With an implicit velocity servo of the same stiffness, MuJoCo's accelerometer would
not measure the driven accelerations."""
DETECTION_DEPTH_M = 5.0
"""Negative margin and positive gap of this size: contacts are detected but exert no force."""
_MOMENTUM_SENSORS = (
    mujoco.mjtSensor.mjSENS_SUBTREECOM,
    mujoco.mjtSensor.mjSENS_SUBTREELINVEL,
    mujoco.mjtSensor.mjSENS_SUBTREEANGMOM,
)


@cache
def twin_model() -> tuple[mujoco.MjModel, Array]:
    """The twin's model and the passive friction moments of unit acceleration (2,)."""
    return _compiled(sees_momentum=False)


@cache
def model_variant(*, sees_contacts: bool, sees_momentum: bool) -> mujoco.MjModel:
    """The twin's model with optional sensors, which do not affect its motion.

    Args:
        sees_contacts: detect contacts, which exert no force.
        sees_momentum: add sensors of the arm's centre of mass, its velocity, and angular momentum about
            it, after those of the IMU.
    """
    model = copy(_compiled(sees_momentum=sees_momentum)[0])
    if not sees_contacts:
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    return model


@cache
def _compiled(*, sees_momentum: bool) -> tuple[mujoco.MjModel, Array]:
    """Compile the twin's model and return it with the passive friction moments of unit acceleration (2,).

    From m545.xml: no visual geoms, no joint limits (the drives hold them), velocity-source drives,
    friction applied from outside so that each machine of a batch has its own, IMU sensors.
    """
    tree = mujoco.MjSpec.from_file(str(MJCF_PATH))
    for geom in list(tree.geoms):
        if geom.contype == 0 and geom.conaffinity == 0:
            tree.delete(geom)
        else:
            geom.margin, geom.gap = -DETECTION_DEPTH_M, DETECTION_DEPTH_M
    nominal = load_spec().passive
    friction: list[float] = []
    for joint in tree.joints:
        if joint.name in PASSIVE_JOINTS:
            friction.append(float(joint.frictionloss) / nominal.coulomb_friction_rad_per_s2)
            joint.frictionloss, joint.damping = 0.0, np.zeros(3)
            continue
        joint.limited, joint.armature = 0, DRIVE_INERTIA
        drive = tree.add_actuator()
        drive.name = drive.target = joint.name
        drive.trntype = mujoco.mjtTrn.mjTRN_JOINT
        drive.set_to_motor()
        # Force that removes a velocity error within one step; ctrl is that error.
        drive.gainprm[0] = DRIVE_INERTIA / CONTROL_PERIOD_S
    for kind, name in (
        (mujoco.mjtSensor.mjSENS_GYRO, "imu_gyro"),
        (mujoco.mjtSensor.mjSENS_ACCELEROMETER, "imu_accel"),
    ):
        sensor = tree.add_sensor()
        sensor.type, sensor.name = kind, name
        sensor.objtype, sensor.objname = mujoco.mjtObj.mjOBJ_SITE, "imu"
    if sees_momentum:
        for kind in _MOMENTUM_SENSORS:
            sensor = tree.add_sensor()
            sensor.type = kind
            sensor.objtype, sensor.objname = mujoco.mjtObj.mjOBJ_BODY, "boom"
    tree.option.timestep = CONTROL_PERIOD_S
    tree.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    tree.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    model = tree.compile()
    order = [model.joint(i).name for i in range(model.njnt)]
    if order != [*ACTIVE_JOINTS, *PASSIVE_JOINTS] or model.nv != JOINT_COUNT:
        raise PlantError(
            f"m545.xml has the joints {order}, the twin needs the order of JOINT_NAMES"
        )
    return model, np.asarray(friction)
