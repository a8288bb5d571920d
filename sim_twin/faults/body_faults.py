"""Faults of the virtual machine's rigid body: tool, pose of the base, a chassis that gives way.

A compliant chassis has extra joints below the slew. All other faults are changed properties of the unit.
"""

from dataclasses import replace
from functools import cache

import mujoco
import numpy as np

from machine.conventions import ACTIVE_COUNT, GRAVITY_M_PER_S2, JOINT_COUNT, Array
from machine.kinematics import hanging_pitch_rad
from machine.spec import MJCF_PATH, MachineSpec
from sim_twin.faults.drive_faults import DriveLimits
from sim_twin.faults.fault import EffectSizes
from sim_twin.virtual.units import MachineUnit

CHASSIS_MASS_KG = 5600.0
CHASSIS_INERTIA_KG_M2 = (3500.0, 8000.0, 9500.0)
"""About its centre: what is left of 12 t, as a box of 4.6 x 2.6 x 1.1 m (assumed)."""
CHASSIS_HEIGHT_M = 0.85
SWAY_DAMPING_RATIO = 0.3
"""Of critical: legs on soil (assumed)."""
SWAY_INERTIA_KG_M2 = 6.0e4
"""Of the whole machine about the contact line with the ground, arm at 6 m."""
UPPER_WEIGHT_ARM_KG_M = -0.70 * 4700.0
"""Counterweight: mass times distance from the slew axis, along the upper carriage's x axis (MJCF)."""
SWAY_JOINTS = {"sway_pitch": (0.0, 1.0, 0.0), "sway_roll": (1.0, 0.0, 0.0)}
TORSION_JOINT = {"turntable_torsion": (0.0, 0.0, 1.0)}
TORSION_TORQUE_N_M = 52.0e3
"""Largest slew torque, at which `windup_rad` is reached (press text of the M5)."""


def altered_unit(sizes: EffectSizes, unit: MachineUnit) -> MachineUnit:
    """The unit with another tool, load or base pose."""
    longer = sizes.built_in("gripper_length", "extra_length_m")
    roll = unit.base_tilt_rad[0] + sizes.built_in("base_tilt", "roll_rad")
    pitch = unit.base_tilt_rad[1] + sizes.built_in("base_tilt", "pitch_rad")
    return replace(
        unit,
        gripper_com_m=unit.gripper_com_m + longer,
        roll_to_grip_centre_m=unit.roll_to_grip_centre_m + longer,
        gripper_inertia_ratio=unit.gripper_inertia_ratio
        * (1.0 + sizes.built_in("gripper_inertia", "extra_inertia_ratio")),
        ball_mass_kg=unit.ball_mass_kg + sizes.built_in("payload_mass", "extra_mass_kg"),
        base_tilt_rad=(roll, pitch),
        base_height_error_m=unit.base_height_error_m
        + sizes.built_in("base_height", "extra_height_m"),
    )


class FaultyBody:
    """Bodies of N machines: yaw of the base, chassis joints, hoses, joint friction."""

    def __init__(self, sizes: EffectSizes, spec: MachineSpec) -> None:
        self._yaw_rad = sizes.built_in("base_yaw_drift", "yaw_rad")
        sway = sizes.built_in("chassis_compliance", "pitch_rad")
        windup = sizes.built_in("turntable_torsion", "windup_rad")
        self._joints: dict[str, tuple[float, float, float]] = {}
        stiffness: list[float] = []
        if sway > 0.0:
            self._joints.update(SWAY_JOINTS)
            stiffness += [largest_arm_moment() / sway] * 2
        if windup > 0.0:
            self._joints.update(TORSION_JOINT)
            stiffness.append(TORSION_TORQUE_N_M / windup)
        self.front_count = len(self._joints)
        """Joints in front of the slew."""
        self._is_swaying = sway > 0.0
        self._stiffness = np.asarray(stiffness)
        damping = 2.0 * SWAY_DAMPING_RATIO * np.sqrt(self._stiffness * SWAY_INERTIA_KG_M2)
        self._damping = damping
        # The MJCF's nominal damping is the friction a unit of the paper's rate times the inertia.
        inertia = swing_inertia(spec)
        self._viscous = sizes.machine("passive_viscous_friction", "extra_viscous_per_s")
        self._viscous = self._viscous[:, None] * inertia
        coulomb = sizes.machine("passive_coulomb_friction", "extra_coulomb_rad_per_s2")
        self._coulomb = coulomb[:, None] * inertia
        hose = sizes.machine("hose_stiffness", "stiffness_per_s2")
        self._hose = hose[:, None] * inertia
        self._hose_rest = np.zeros((sizes.count, 2))

    def build(self, tree: mujoco.MjSpec) -> None:
        """Turn the base, and put the chassis on joints."""
        chassis = tree.body("chassis")
        half = 0.5 * self._yaw_rad
        turned = np.zeros(4)
        yaw = np.array([np.cos(half), 0.0, 0.0, np.sin(half)])
        mujoco.mju_mulQuat(turned, yaw, np.asarray(chassis.quat))
        chassis.quat = turned
        if not self._joints:
            return
        for name, axis in self._joints.items():
            chassis.add_joint(
                name=name,
                type=mujoco.mjtJoint.mjJNT_HINGE,
                axis=axis,
                pos=(0.0, 0.0, -CHASSIS_HEIGHT_M),
                limited=mujoco.mjtLimited.mjLIMITED_FALSE,
            )
        chassis.explicitinertial = True
        chassis.mass, chassis.inertia = CHASSIS_MASS_KG, np.array(CHASSIS_INERTIA_KG_M2)
        chassis.ipos, chassis.iquat = np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
        # Wheels and legs stand on the ground: what they give way by is in the joints.
        for geom in chassis.geoms:
            geom.contype = geom.conaffinity = 0

    def settle(self, position: Array, bias_torque: Array) -> None:
        """Let the chassis of qpos (N, front + 6) take its rest under the load of qfrc_bias; in place."""
        front = self.front_count
        self._hose_rest = position[:, front + ACTIVE_COUNT :].copy()
        if front:
            load = self._counterweight(position[:, front]) - bias_torque[:, :front]
            position[:, :front] = load / self._stiffness

    def swing_torque(self, position: Array, velocity: Array, stick_rad_per_s: float) -> Array:
        """Further torque on the free joints (N, 2)."""
        return (
            -self._viscous * velocity
            - self._coulomb * np.tanh(velocity / stick_rad_per_s)
            - self._hose * (position - self._hose_rest)
        )

    def front_torque(self, position: Array, velocity: Array) -> Array:
        """Torque on the chassis joints (N, front) at qpos and qvel (N, front + 6)."""
        front = self.front_count
        spring = self._stiffness * position[:, :front] + self._damping * velocity[:, :front]
        return self._counterweight(position[:, front]) - spring

    def _counterweight(self, slew_rad: Array) -> Array:
        """What cancels the counterweight's moment: the base was levelled with it."""
        torque = np.zeros((slew_rad.size, self.front_count))
        if self._is_swaying:
            moment = GRAVITY_M_PER_S2 * UPPER_WEIGHT_ARM_KG_M
            # Weight W at (x, y) turns by (-y W, x W) about x and y.
            torque[:, 0] = -moment * np.cos(slew_rad)
            torque[:, 1] = moment * np.sin(slew_rad)
        return torque


@cache
def _nominal_model() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(str(MJCF_PATH))


def swing_inertia(spec: MachineSpec) -> Array:
    """Inertias (2,) about the free joints, kg m2: the MJCF's damping over the rate that it was made from."""
    first = JOINT_COUNT - 2
    return np.asarray(_nominal_model().dof_damping[first:]) / spec.passive.viscous_friction_per_s


@cache
def _scan_arm() -> tuple[Array, Array, Array]:
    """Static gravity torques (P, 6) and least inertias (4,) over the joints' ranges, and arm moments (P,)."""
    model = _nominal_model()
    data = mujoco.MjData(model)
    low, high = np.asarray(model.jnt_range)[1:ACTIVE_COUNT].T
    torques, moments = [], []
    inertia = np.full(ACTIVE_COUNT, np.inf)
    mass = np.zeros((model.nv, model.nv))
    boom = model.body("boom").id
    for share in np.ndindex(5, 5, 4):
        data.qpos[:] = 0.0
        data.qpos[1:ACTIVE_COUNT] = low + (high - low) * np.asarray(share) / (4.0, 4.0, 3.0)
        data.qpos[ACTIVE_COUNT] = hanging_pitch_rad(np.asarray(data.qpos)[:ACTIVE_COUNT])
        data.qvel[:] = 0.0
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, mass)
        inertia = np.minimum(inertia, np.diag(mass)[:ACTIVE_COUNT])
        torques.append(np.asarray(data.qfrc_bias).copy())
        arm_x = data.subtree_com[boom][0]
        moments.append(model.body_subtreemass[boom] * GRAVITY_M_PER_S2 * arm_x)
    return np.array(torques), inertia, np.array(moments)


def drive_limits() -> DriveLimits:
    """Largest static moments and least inertias of the driven joints over their ranges."""
    torques, inertia, _ = _scan_arm()
    moment = np.abs(torques[:, :ACTIVE_COUNT]).max(axis=0)
    moment[0] = np.inf
    return DriveLimits(moment, inertia)


def largest_arm_moment() -> float:
    """Largest gravity moment of the arm about the slew axis, N m."""
    return float(np.abs(_scan_arm()[2]).max())
