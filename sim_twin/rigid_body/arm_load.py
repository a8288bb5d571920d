"""Gravity moments of the arm on its drives, relative to their largest values in the envelope.

Static, with a hanging gripper: accelerations and swing are neglected. Masses are those of the MJCF.
"""

from functools import cache
from typing import NamedTuple

import numpy as np

from machine.conventions import ACTIVE_COUNT, Array
from machine.kinematics import rotate_z
from machine.spec import MachineSpec
from sim_twin.rigid_body.model import twin_model

GRID_POINT_COUNT = 25


class _Masses(NamedTuple):
    """Mass (kg) and centre of mass (x, z) in the frame of a pivot."""

    boom: tuple[float, float, float]
    """From the boom's pivot, boom frame."""
    dipper: tuple[float, float, float]
    """From the dipper's pivot, dipper frame."""
    telescope: tuple[float, float, float]
    """From the dipper's pivot, dipper frame, at zero extension."""
    hanging: tuple[float, float, float]
    """Gripper and load as a point at the pin; from the dipper's pivot, at zero extension."""


@cache
def _masses() -> _Masses:
    model, _ = twin_model()
    mass = {name: float(model.body(name).mass[0]) for name in _BODIES}
    place = {name: model.body(name).pos + model.body(name).ipos for name in _BODIES}
    tube = model.body("telescope").pos
    pin = tube + model.body("hanger").pos
    hanging = mass["hanger"] + mass["gripper"] + mass["payload"]
    boom, dipper = model.body("boom").ipos, model.body("dipper").ipos
    return _Masses(
        boom=(mass["boom"], float(boom[0]), float(boom[2])),
        dipper=(mass["dipper"], float(dipper[0]), float(dipper[2])),
        telescope=(
            mass["telescope"],
            float(place["telescope"][0]),
            float(place["telescope"][2]),
        ),
        hanging=(hanging, float(pin[0]), float(pin[2])),
    )


_BODIES = ("boom", "dipper", "telescope", "hanger", "gripper", "payload")


def _moments(spec: MachineSpec, active_position_rad_m: Array) -> Array:
    """Moments divided by g (N, 4), kg m and kg, that act on each joint in the negative direction."""
    m = _masses()
    boom = active_position_rad_m[:, 1]
    tube = boom + active_position_rad_m[:, 2]
    out = active_position_rad_m[:, 3]
    cb, sb, ct, st = np.cos(boom), np.sin(boom), np.cos(tube), np.sin(tube)
    # Telescope and pin move along -z of the dipper frame as the telescope extends.
    beyond = sum(
        mass * (x * ct - (z - out * moves) * st)
        for (mass, x, z), moves in ((m.dipper, 0.0), (m.telescope, 1.0), (m.hanging, 1.0))
    )
    carried = m.dipper[0] + m.telescope[0] + m.hanging[0]
    result = np.zeros_like(active_position_rad_m)
    result[:, 2] = beyond
    result[:, 1] = (
        beyond
        + carried * spec.geometry.boom_length_m * cb
        + m.boom[0] * (m.boom[1] * cb - m.boom[2] * sb)
    )
    # The weight along the tube extends a telescope that points down.
    result[:, 3] = -(m.telescope[0] + m.hanging[0]) * ct
    return result


def _tipping_moment(spec: MachineSpec, active_position_rad_m: Array) -> Array:
    """Tipping moment of the arm's weight about the slew axis's foot, divided by g (N,), kg m."""
    m = _masses()
    arm_kg = m.boom[0] + m.dipper[0] + m.telescope[0] + m.hanging[0]
    return _moments(spec, active_position_rad_m)[:, 1] + arm_kg * spec.geometry.boom_pivot_m[0]


@cache
def _envelope(spec: MachineSpec) -> Array:
    """Active positions (P, 4) on a grid over the envelope."""
    low, high = spec.position_range_rad_m
    axes = [np.linspace(low[j], high[j], GRID_POINT_COUNT) for j in range(1, ACTIVE_COUNT)]
    grid = np.stack([a.ravel() for a in np.meshgrid(*axes, indexing="ij")], axis=-1)
    return np.concatenate([np.zeros((grid.shape[0], 1)), grid], axis=-1)


@cache
def _largest(spec: MachineSpec) -> tuple[Array, float]:
    poses = _envelope(spec)
    moments = np.abs(_moments(spec, poses)).max(axis=0)
    return np.maximum(moments, 1e-9), float(np.abs(_tipping_moment(spec, poses)).max())


def largest_tipping_moment(spec: MachineSpec) -> float:
    """Largest tipping moment of the arm in the envelope, divided by g, kg m."""
    return _largest(spec)[1]


def gravity_load_ratio(spec: MachineSpec, active_position_rad_m: Array) -> Array:
    """Gravity moment of each joint divided by its largest (N, 4); positive opposes positive motion."""
    return _moments(spec, active_position_rad_m) / _largest(spec)[0]


def tipping_ratio(spec: MachineSpec, active_position_rad_m: Array) -> Array:
    """Moment of the arm's weight on the base divided by its largest (N, 3), frame `machine`.

    A weight W at (x, y) has the moment (-y W, x W) about x and y.
    """
    m, largest = _masses(), _largest(spec)[1]
    arm_kg = m.boom[0] + m.dipper[0] + m.telescope[0] + m.hanging[0]
    outward = _tipping_moment(spec, active_position_rad_m) / largest
    aside = np.full(outward.shape, arm_kg * spec.geometry.arm_plane_offset_m / largest)
    moment = np.stack([-aside, outward, np.zeros(outward.size)], axis=-1)
    return rotate_z(moment, active_position_rad_m[:, 0])
