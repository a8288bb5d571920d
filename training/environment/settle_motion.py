"""Settle motion after the release: the runtime's control law as a function of the true state.

Returns requested velocities; limits and pump flow are applied to every request elsewhere. The law is that
of runtime.control.swing_control.settle and runtime.control.follow_through, for noise-free joints, in numpy
or JAX (compared in tests/training/environment/test_settle_motion.py). Training includes it so that the
gripper stays clear of arm and ground after a throw.
"""

from typing import Any

from machine.kinematics import namespace, pin_in_plane
from machine.spec import MachineSpec
from machine.starts import SAFE_ACTIVE_RAD_M
from runtime.control import follow_through, swing_control
from runtime.control.imu_estimator import swing_frequency_rad_per_s

Field = Any


def settle_request(spec: MachineSpec, time_s: Field, q: Field, v: Field) -> Field:
    """Requested velocities (N, 4) for positions q and velocities v (N, 6), time_s (N,) after the release."""
    xp, g = namespace(q), spec.geometry
    pitch, roll = swing_frequency_rad_per_s(spec)
    tube = q[..., 1] + q[..., 2]
    swing, swing_rate = tube + q[..., 4], v[..., 1] + v[..., 2] + v[..., 4]
    lean, lean_rate = q[..., 5], v[..., 5]
    amplitude = xp.sqrt(swing**2 + (swing_rate / pitch) ** 2 + lean**2 + (lean_rate / roll) ** 2)
    length = g.dipper_to_telescope_m + g.telescope_to_pin_m + q[..., 3]
    across = g.telescope_axis_offset_m * xp.cos(tube) + length * xp.sin(tube)
    along = length * xp.cos(tube) - g.telescope_axis_offset_m * xp.sin(tube)
    radius = g.boom_pivot_m[0] + g.boom_length_m * xp.cos(q[..., 1]) + across
    calm = 1.0 / (1.0 + (amplitude / swing_control.RETURN_SWING_RAD) ** 2)
    gap = [SAFE_ACTIVE_RAD_M[i] - q[..., i] for i in range(4)]
    fastest = swing_control.RETURN_SPEED_RAD_M_PER_S
    pose_return = [
        xp.clip(swing_control.RETURN_GAIN_PER_S * gap[i], -fastest[i], fastest[i]) * calm
        for i in range(4)
    ]
    pitch_lead, roll_lead = swing_control.DAMPING_LEAD_S
    outward = _pin_speed(_ahead(swing, swing_rate, pitch, pitch_lead), amplitude)
    sideways = _pin_speed(_ahead(lean, lean_rate, roll, roll_lead), amplitude)
    arm = xp.sin(tube)
    telescope = swing_control.TELESCOPE_WEIGHT * arm
    outward = outward / (along * along + telescope * arm + 0.1)
    damped = xp.stack(
        [
            sideways / xp.maximum(radius, 2.0),
            pose_return[1],
            pose_return[2] + along * outward,
            pose_return[3] + telescope * outward,
        ],
        axis=-1,
    )
    first = _follow_through(spec, q, _ahead(swing, swing_rate, pitch, follow_through.LEAD_S))
    first = xp.concatenate([damped[..., :1], first], axis=-1)
    large = amplitude > follow_through.LARGE_SWING_RAD
    runs = (time_s < follow_through.LASTS_S) & large
    return xp.where(runs[..., None], first, damped)


def _follow_through(spec: MachineSpec, q: Field, swing_ahead: Field) -> Field:
    """Requests (N, 3) of boom, dipper and telescope while the swing is large."""
    xp, f = namespace(q), follow_through
    out = swing_ahead > 0.0
    height = pin_in_plane(spec, q)[..., 1]
    folds = ~out & (q[..., 1] + q[..., 2] > f.FOLDED_RAD)
    return xp.stack(
        [
            xp.clip(f.LIFT_PER_S * (f.PIN_HEIGHT_M - height), 0.0, f.LIFT_RAD_PER_S),
            xp.where(folds, -f.FOLD_RAD_PER_S, 0.0),
            xp.where(out, f.OUTWARD_M_PER_S, 0.0),
        ],
        axis=-1,
    )


def _ahead(angle: Field, rate: Field, frequency: float, lead_s: float) -> Field:
    xp = namespace(angle)
    phase = xp.asarray(frequency * lead_s)
    return angle * xp.cos(phase) + rate * (xp.sin(phase) / frequency)


def _pin_speed(angle: Field, amplitude: Field) -> Field:
    xp = namespace(angle)
    limit = swing_control.DAMPING_SPEED_M_PER_S
    wanted = xp.clip(swing_control.DAMPING_M_PER_S_PER_RAD * angle, -limit, limit)
    return xp.where(amplitude > 2.0 * swing_control.DAMPING_DEAD_ZONE_RAD, wanted, 0.0)
