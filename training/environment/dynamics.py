"""Exact dynamics of the two free joints under a moving arm, and velocity response of the driven joints.

Pure functions over numpy or JAX arrays (see machine.kinematics.namespace). The free joints follow
Newton-Euler for hanger and gripper with load; the motion of the driven joints is prescribed.
Checked against MuJoCo on machine/m545.xml (tests/training/environment/test_dynamics.py).
"""

from typing import Any, NamedTuple, cast

from machine.conventions import GRAVITY_M_PER_S2
from machine.kinematics import namespace
from machine.spec import MachineSpec, Passive

Field = Any
"""Array of numpy or JAX, shape (N,) unless said otherwise."""


class ChainGeometry(NamedTuple):
    """The lengths of machine.spec.Geometry; some differ between machines (N,)."""

    slew_frame_height_m: Field
    boom_pivot_m: tuple[Field, Field, Field]
    boom_length_m: Field
    telescope_axis_offset_m: Field
    dipper_to_telescope_m: Field
    telescope_to_pin_m: Field
    pitch_to_roll_m: Field
    roll_to_grip_centre_m: Field

    @property
    def arm_plane_offset_m(self) -> Field:
        """Signed y of the arm plane in the slew frame."""
        return self.boom_pivot_m[1]


class DrawnMachine(NamedTuple):
    """Stands in for a spec in the kinematics, which read its geometry and passive joints only."""

    geometry: ChainGeometry
    passive: Passive


def drawn_machine(
    spec: MachineSpec,
    *,
    telescope_to_pin_error_m: Field = 0.0,
    pitch_to_roll_error_m: Field = 0.0,
    roll_to_grip_error_m: Field = 0.0,
) -> MachineSpec:
    """Spec with errors (N,) added to three lengths."""
    g = spec.geometry
    geometry = ChainGeometry(
        slew_frame_height_m=g.slew_frame_height_m,
        boom_pivot_m=g.boom_pivot_m,
        boom_length_m=g.boom_length_m,
        telescope_axis_offset_m=g.telescope_axis_offset_m,
        dipper_to_telescope_m=g.dipper_to_telescope_m,
        telescope_to_pin_m=g.telescope_to_pin_m + telescope_to_pin_error_m,
        pitch_to_roll_m=g.pitch_to_roll_m + pitch_to_roll_error_m,
        roll_to_grip_centre_m=g.roll_to_grip_centre_m + roll_to_grip_error_m,
    )
    # The kinematics read attributes by name: arrays in place of numbers work.
    return cast(MachineSpec, DrawnMachine(geometry, spec.passive))


class PassiveBody(NamedTuple):
    """Hanger and gripper with load; each value (N,) or one for all machines."""

    load_mass_kg: Field
    load_com_m: Field
    """Below the roll axis, gripper and ball together."""
    load_inertia_kg_m2: tuple[Field, Field, Field]
    """Of gripper and ball about their common centre of mass."""
    viscous_n_m_s: tuple[Field, Field]
    """Viscous friction of pitch and roll."""
    coulomb_n_m: tuple[Field, Field]
    """Dry friction of pitch and roll."""


def passive_body(
    spec: MachineSpec,
    payload_mass_kg: Field,
    *,
    friction_scale: Field = 1.0,
    com_error_m: Field = 0.0,
    inertia_scale: Field = 1.0,
    mass_scale: Field = 1.0,
) -> PassiveBody:
    """Combine gripper and ball. Friction torques are the paper's accelerations times nominal inertias."""
    p, g, ball = spec.passive, spec.geometry, spec.ball
    com, gripper = p.gripper_com_m + com_error_m, p.gripper_mass_kg * mass_scale
    mass = gripper + payload_mass_kg
    load_com = (gripper * com + payload_mass_kg * g.roll_to_grip_centre_m) / mass
    spread = (
        gripper * (com - load_com) ** 2
        + payload_mass_kg * (g.roll_to_grip_centre_m - load_com) ** 2
    )
    # A basketball is a shell: 2/3 m r^2.
    shell = 2.0 / 3.0 * payload_mass_kg * ball.radius_m**2
    ix, iy, iz = (value * inertia_scale * mass_scale for value in p.gripper_inertia_kg_m2)
    # The nominal inertias turn the paper's friction acceleration into the torque the MJCF carries.
    roll_inertia = p.gripper_inertia_kg_m2[0] + p.gripper_mass_kg * p.gripper_com_m**2
    pitch_inertia = (
        p.hanger_inertia_kg_m2[1]
        + p.hanger_mass_kg * p.hanger_com_m**2
        + p.gripper_inertia_kg_m2[1]
        + p.gripper_mass_kg * (g.pitch_to_roll_m + p.gripper_com_m) ** 2
    )
    viscous, coulomb = p.viscous_friction_per_s, p.coulomb_friction_rad_per_s2
    return PassiveBody(
        load_mass_kg=mass,
        load_com_m=load_com,
        load_inertia_kg_m2=(ix + spread + shell, iy + spread + shell, iz + shell),
        viscous_n_m_s=(
            pitch_inertia * viscous * friction_scale,
            roll_inertia * viscous * friction_scale,
        ),
        coulomb_n_m=(
            pitch_inertia * coulomb * friction_scale,
            roll_inertia * coulomb * friction_scale,
        ),
    )


class PinMotion(NamedTuple):
    """Tool pin in the slewing arm plane: distance from the slew axis, rates and accelerations."""

    x_m: Field
    x_rate_m_per_s: Field
    x_acceleration_m_per_s2: Field
    z_acceleration_m_per_s2: Field


def pin_motion(spec: MachineSpec, q: Field, v: Field, active_acceleration: Field) -> PinMotion:
    """Motion of the tool pin for q, v (N, 6) and active_acceleration (N, 4)."""
    xp, g = namespace(q), spec.geometry
    boom, tube = q[..., 1], q[..., 1] + q[..., 2]
    boom_rate, tube_rate = v[..., 1], v[..., 1] + v[..., 2]
    boom_acc = active_acceleration[..., 1]
    tube_acc = boom_acc + active_acceleration[..., 2]
    length = g.dipper_to_telescope_m + g.telescope_to_pin_m + q[..., 3]
    out_rate, out_acc = v[..., 3], active_acceleration[..., 3]
    cb, sb, ct, st = xp.cos(boom), xp.sin(boom), xp.cos(tube), xp.sin(tube)
    x = g.boom_pivot_m[0] + g.boom_length_m * cb + g.telescope_axis_offset_m * ct + length * st
    x_rate = (
        -g.boom_length_m * sb * boom_rate
        + (length * ct - g.telescope_axis_offset_m * st) * tube_rate
        + st * out_rate
    )
    along_tube = out_acc - length * tube_rate**2
    across_tube = length * tube_acc + 2.0 * out_rate * tube_rate
    offset_in = g.telescope_axis_offset_m * tube_rate**2
    offset_up = g.telescope_axis_offset_m * tube_acc
    boom_in, boom_up = g.boom_length_m * boom_rate**2, g.boom_length_m * boom_acc
    x_acc = (
        -cb * boom_in - sb * boom_up - ct * offset_in - st * offset_up
        + st * along_tube + ct * across_tube
    )  # fmt: skip
    z_acc = (
        -sb * boom_in + cb * boom_up - st * offset_in + ct * offset_up
        - ct * along_tube + st * across_tube
    )  # fmt: skip
    return PinMotion(x, x_rate, x_acc, z_acc)


def passive_acceleration(
    spec: MachineSpec, body: PassiveBody, q: Field, v: Field, active_acceleration: Field
) -> Field:
    """Accelerations of pitch and roll, shape (N, 2), for prescribed driven joints.

    Both bodies are written in the hanger's frame (x outward, y left, z along the hanger). About the cross
    of pitch (-y) and roll (x) axes the mass matrix is diagonal: pitching moves the load along x only,
    rolling along y and z only. So each joint's equation is torque / inertia, with the torque that would be
    needed to keep its own acceleration at zero.
    """
    xp, g, p = namespace(q), spec.geometry, spec.passive
    swing, roll = q[..., 1] + q[..., 2] + q[..., 4], q[..., 5]
    turn, turn_acc = v[..., 0], active_acceleration[..., 0]
    swing_rate, roll_rate = v[..., 1] + v[..., 2] + v[..., 4], v[..., 5]
    tube_acc = active_acceleration[..., 1] + active_acceleration[..., 2]
    ss, cs, sr, cr = xp.sin(swing), xp.cos(swing), xp.sin(roll), xp.cos(roll)
    pin = pin_motion(spec, q, v, active_acceleration)
    # Pin acceleration less gravity, in the arm plane (turning with the cabin), then in the hanger's frame.
    ax = pin.x_acceleration_m_per_s2 - turn_acc * g.arm_plane_offset_m - turn**2 * pin.x_m
    ay = 2.0 * turn * pin.x_rate_m_per_s + turn_acc * pin.x_m - turn**2 * g.arm_plane_offset_m
    az = pin.z_acceleration_m_per_s2 + GRAVITY_M_PER_S2
    hx, hy, hz = cs * ax + ss * az, ay, -ss * ax + cs * az
    # Hanger: rate and bias acceleration (swing acceleration set to zero).
    wx, wy, wz = turn * ss, -swing_rate, turn * cs
    bx = turn_acc * ss + turn * swing_rate * cs
    bz = turn_acc * cs - turn * swing_rate * ss
    # Gripper, in its own frame: turned by the roll about x.
    gx, gy, gz = wx + roll_rate, cr * wy + sr * wz, -sr * wy + cr * wz
    ex = bx
    ey = sr * bz + roll_rate * gz
    ez = cr * bz - roll_rate * gy
    # Acceleration of the roll axis and of the load's centre of mass.
    drop = g.pitch_to_roll_m
    rx, ry, rz = _offset(hx, hy, hz, wx, wy, wz, bx, xp.zeros_like(bx), drop)
    fx, fy, fz = rx, cr * ry + sr * rz, -sr * ry + cr * rz
    com, mass = body.load_com_m, body.load_mass_kg
    cx, cy, _ = _offset(fx, fy, fz, gx, gy, gz, ex, ey, com)
    ix, iy, iz = body.load_inertia_kg_m2
    torque_x = ix * ex + (iz - iy) * gy * gz + com * mass * cy
    torque_y = iy * ey + (ix - iz) * gx * gz - com * mass * cx
    torque_z = iz * ez + (iy - ix) * gx * gy
    # Hanger's own share, and the load's force at the roll axis, about the pin's y axis.
    jx, jy, jz = p.hanger_inertia_kg_m2
    nx, _, _ = _offset(hx, hy, hz, wx, wy, wz, bx, xp.zeros_like(bx), p.hanger_com_m)
    own_y = (jx - jz) * wx * wz - p.hanger_com_m * p.hanger_mass_kg * nx
    about_pin_y = own_y + cr * torque_y - sr * torque_z - drop * mass * cx
    pitch_inertia = (
        jy
        + p.hanger_mass_kg * p.hanger_com_m**2
        + iy * cr**2
        + iz * sr**2
        + mass * (drop + com * cr) ** 2
    )
    roll_inertia = ix + mass * com**2
    pitch_friction = friction(body.viscous_n_m_s[0], body.coulomb_n_m[0], v[..., 4])
    roll_friction = friction(body.viscous_n_m_s[1], body.coulomb_n_m[1], roll_rate)
    swing_acc = (about_pin_y - pitch_friction) / pitch_inertia
    roll_acc = (-torque_x - roll_friction) / roll_inertia
    return xp.stack([swing_acc - tube_acc, roll_acc], axis=-1)


def _offset(
    ax: Field, ay: Field, az: Field, wx: Field, wy: Field, wz: Field, ex: Field, ey: Field, d: Field
) -> tuple[Field, Field, Field]:
    """Acceleration of the point d below an origin: a + e x r + w x (w x r), r = (0, 0, -d)."""
    return (
        ax - d * (ey + wx * wz),
        ay + d * (ex - wy * wz),
        az + d * (wx**2 + wy**2),
    )


FRICTION_BLEND_RAD_PER_S = 0.005
"""Rate over which dry friction changes sign: a step would chatter at 100 Hz."""


def friction(viscous_n_m_s: Field, coulomb_n_m: Field, rate_rad_per_s: Field) -> Field:
    """Friction torque (paper, eq. 3): viscous and dry."""
    xp = namespace(rate_rad_per_s)
    dry = xp.tanh(rate_rad_per_s / FRICTION_BLEND_RAD_PER_S)
    return viscous_n_m_s * rate_rad_per_s + coulomb_n_m * dry


class DriveResponse(NamedTuple):
    """Parameters of the driven joints' velocity response, each (N, 4) in joint order."""

    dead_time_s: Field
    lag_s: Field
    natural_frequency_rad_per_s: Field
    damping_ratio: Field
    gain_positive_ratio: Field
    gain_negative_ratio: Field
    boom_from_dipper_ratio: Field = 0.0
    """(N,) share of the dipper's acceleration that its reaction takes from the boom's."""
    dipper_from_boom_ratio: Field = 0.0
    """(N,) share of the boom's acceleration that its reaction takes from the dipper's. The product of both
    is below 1."""


class ResponseState(NamedTuple):
    """State of the driven joints' response, each (N, 4)."""

    lagged: Field
    """Output of the first-order lag, rad/s and m/s."""
    acceleration: Field
    """Acceleration that each drive would give its joint with the other joints at rest."""


def respond(
    response: DriveResponse,
    state: ResponseState,
    velocity: Field,
    reference: Field,
    disturbance: Field,
    step_s: float,
) -> tuple[Field, ResponseState]:
    """One step of x' = (K r - x) / lag, s' = wn^2 (x + d - v) - 2 zeta wn v', v' = s - C v'; all (N, 4).

    C is the reaction between boom and dipper. The damping term is implicit, which keeps stiff, overdamped
    drives stable at 100 Hz.
    """
    xp = namespace(reference)
    gain = xp.where(reference > 0.0, response.gain_positive_ratio, response.gain_negative_ratio)
    share = 1.0 - xp.exp(-step_s / response.lag_s)
    lagged = state.lagged + share * (gain * reference - state.lagged)
    wn = response.natural_frequency_rad_per_s
    damping = 2.0 * response.damping_ratio * wn * step_s
    held = _reaction(xp, response, state.acceleration)
    pull = wn**2 * (lagged + disturbance - velocity)
    drive = (state.acceleration + step_s * pull + damping * held) / (1.0 + damping)
    velocity = velocity + step_s * (drive - _reaction(xp, response, drive))
    return velocity, ResponseState(lagged, drive)


def _reaction(xp: Any, response: DriveResponse, drive: Field) -> Field:
    """Reaction of boom and dipper on each other (N, 4), rad/s2: drive minus acceleration.

    a_boom = s_boom - b a_dipper, a_dipper = s_dipper - c a_boom.
    """
    b, c = response.boom_from_dipper_ratio, response.dipper_from_boom_ratio
    boom, dipper = drive[..., 1], drive[..., 2]
    share = 1.0 / (1.0 - b * c)
    zero = xp.zeros_like(boom)
    return xp.stack(
        [zero, boom - share * (boom - b * dipper), dipper - share * (dipper - c * boom), zero],
        axis=-1,
    )
