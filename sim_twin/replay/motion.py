"""True motion from measured motion, under each element's hypothesis about the sensors."""

from collections.abc import Sequence

import numpy as np

from machine.conventions import ACTIVE_COUNT, CONTROL_PERIOD_S, JOINT_COUNT, Array, BoolArray
from runtime.control.imu_estimator import start_angle
from sim_twin.replay.turned_imu import swing_from_gyro
from sim_twin.replay.types import ReplayElement, ReplayInput
from sim_twin.twin.twin import Twin
from sim_twin.twin.twin_effects import PrescribedMotion


def padded(values: Array, ticks: int, *, hold: bool) -> Array:
    """Values (T, C) with rows appended up to `ticks`: the last row repeated, or zeros."""
    missing = ticks - values.shape[0]
    return np.pad(values, [(0, missing), (0, 0)], mode="edge" if hold else "constant")


def shifted(values: Array, ticks: Array) -> Array:
    """Values (T, ...) shifted by `ticks` (...) rows; constant beyond the ends.

    Cubic interpolation: linear interpolation would smooth the noise and bias estimated latencies.
    """
    last = values.shape[0] - 1
    whole = np.floor(ticks + 1e-9).astype(np.int64)
    s = ticks - whole
    weights = (
        -s * (s - 1.0) * (s - 2.0) / 6.0,
        (s + 1.0) * (s - 1.0) * (s - 2.0) / 2.0,
        -(s + 1.0) * s * (s - 2.0) / 2.0,
        (s + 1.0) * s * (s - 1.0) / 6.0,
    )
    row = np.arange(last + 1).reshape(-1, *(1,) * (values.ndim - 1)) + whole
    out = np.zeros_like(values)
    for step, weight in enumerate(weights, start=-1):
        out += weight * np.take_along_axis(values, np.clip(row + step, 0, last), axis=0)
    return out


class ReplayMotion:
    """Starts and prescribed joints of M elements.

    Corrects latencies of sensors and misalignment of the IMU.
    """

    def __init__(
        self,
        twin: Twin,
        throws: Sequence[ReplayInput],
        elements: Sequence[ReplayElement],
        ticks: int,
    ) -> None:
        """Compute true motion from reported motion.

        Args:
            twin: twin with the elements' effects.
            throws: input of each element.
            elements: M simulations.
            ticks: number of ticks of the longest throw.
        """
        self._ticks = ticks
        count = len(elements)
        self.reported_start = np.zeros((count, JOINT_COUNT))
        """(M, 6) reported start positions."""
        rates = np.zeros((count, JOINT_COUNT))
        self._mask = np.zeros((count, JOINT_COUNT), dtype=np.bool_)
        for row, (throw, element) in enumerate(zip(throws, elements, strict=True)):
            self.reported_start[row, :ACTIVE_COUNT] = throw.position_rad_m[0]
            self.reported_start[row, ACTIVE_COUNT:] = throw.swing_start_rad
            rates[row, ACTIVE_COUNT:] = throw.swing_rate_start_rad_per_s
            self._mask[row, :ACTIVE_COUNT] = element.measured_joints
            self._mask[row, ACTIVE_COUNT:] = element.measured_swing
        hung = np.array([t.hung_at_rest for t in throws])
        axes = twin.imu_axes()
        start = self.reported_start
        if axes is not None:
            start = start + np.stack(
                [_start_shift(t, a) for t, a in zip(throws, axes, strict=True)]
            )
        true = twin.true_pose(start, hung)
        self._is_given = bool(self._mask.any())
        if self._is_given:
            self._position, self._velocity = _reported(throws, ticks)
            if axes is not None:
                self._turn(throws, axes, start)
            self._advance(twin.sensor_latency_s())
            self._correct(twin, hung)
            true = np.where(self._mask, self._position[0], true)
            rates = np.where(self._mask, self._velocity[0], rates)
        self.start = (true, rates)
        """True positions and velocities (M, 6) at row 0."""

    def after(self, tick: int) -> PrescribedMotion | None:
        """True motion at the end of a tick."""
        if not self._is_given:
            return None
        row = min(tick + 1, self._ticks - 1)
        return PrescribedMotion(self._mask, self._position[row], self._velocity[row])

    def _turn(self, throws: Sequence[ReplayInput], axes: Array, start: Array) -> None:
        """Recompute the swing from starts (M, 6) for IMUs with axes (M, 3, 3)."""
        gyros = {i: t.gyro_rad_per_s for i, t in enumerate(throws)}
        known = {i: gyro for i, gyro in gyros.items() if gyro is not None}
        if not known:
            return
        rows = list(known)
        gyro = np.stack([padded(g, self._ticks, hold=True) for g in known.values()], axis=1)
        rate = np.einsum("nij,tnj->tni", axes[rows], gyro)
        position, velocity = self._position[:, rows], self._velocity[:, rows]
        angle, rates = swing_from_gyro(rate, velocity[..., 0], _swing(start[rows]))
        for measured, driven, new in (
            (self._position, position, angle),
            (self._velocity, velocity, rates),
        ):
            measured[:, rows, ACTIVE_COUNT] = new[..., 0] - driven[..., 1] - driven[..., 2]
            measured[:, rows, ACTIVE_COUNT + 1] = new[..., 1]

    def _advance(self, latency_s: Array | None) -> None:
        """Move joints (ticks, M, 6) earlier by their sensors' latencies (M, 6)."""
        if latency_s is None:
            return
        ticks = latency_s / CONTROL_PERIOD_S
        beyond = np.arange(self._ticks)[:, None, None] + ticks - (self._ticks - 1)
        # Beyond the end of the record a joint keeps its last speed.
        coasted = np.maximum(beyond, 0.0) * CONTROL_PERIOD_S * self._velocity[-1]
        self._position = shifted(self._position, ticks) + coasted
        self._velocity = shifted(self._velocity, ticks)

    def _correct(self, twin: Twin, hung: BoolArray) -> None:
        for tick in range(self._ticks):
            self._position[tick] = twin.true_pose(self._position[tick], hung)


def _start_shift(throw: ReplayInput, axes: Array) -> Array:
    """(6,) true minus reported start position of the gripper for an IMU with axes (3, 3)."""
    shift = np.zeros(JOINT_COUNT)
    force = throw.start_force_m_per_s2
    if force is not None:
        shift[ACTIVE_COUNT:] = start_angle(axes @ force) - start_angle(force)
    return shift


def _swing(pose: Array) -> Array:
    """Swing from the machine's vertical, and roll, (N, 2), for reported joint positions (N, 6)."""
    return np.stack([pose[:, 1] + pose[:, 2] + pose[:, 4], pose[:, 5]], axis=1)


def _reported(throws: Sequence[ReplayInput], ticks: int) -> tuple[Array, Array]:
    """Reported positions and velocities (ticks, M, 6); zeros for an unmeasured swing."""
    cache: dict[int, tuple[Array, Array]] = {}
    count = len(throws)
    position = np.zeros((ticks, count, JOINT_COUNT))
    velocity = np.zeros((ticks, count, JOINT_COUNT))
    for row, throw in enumerate(throws):
        if id(throw) not in cache:
            cache[id(throw)] = (
                _six(throw.position_rad_m, throw.swing_rad, ticks),
                _six(throw.velocity_rad_m_per_s, throw.swing_rate_rad_per_s, ticks),
            )
        position[:, row], velocity[:, row] = cache[id(throw)]
    return position, velocity


def _six(driven: Array, free: Array | None, ticks: int) -> Array:
    swing = np.zeros((driven.shape[0], 2)) if free is None else free
    return padded(np.concatenate([driven, swing], axis=1), ticks, hold=True)
