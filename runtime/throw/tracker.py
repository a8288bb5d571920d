"""Follows one throw from acceptance to impact: which rows its log gets, how the load left, where it landed.

It watches and reports; it decides nothing about motion.
"""

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from machine.kinematics import grip_centre
from machine.messages import EventKind, ImpactSurvey
from machine.site.thrown_material import MaterialFootprint
from machine.spec import MachineSpec
from machine.telemetry import BALL_ROW, IMU_ROW
from runtime.driver import SensorSample
from runtime.throw.protocol import ThrowEvent

IMPACT_WAIT_NS: Final = 3_000_000_000
"""A load still in the air when the throw has ended lands within this; the log waits for it."""


@dataclass(frozen=True, slots=True)
class _Throw:
    throw_id: str
    plan_id: str | None
    first_tick_count: int
    has_left: bool = False
    has_impact: bool = False
    release_speed_m_per_s: float | None = None
    release_position_m: tuple[float, float, float] | None = None
    result: dict[str, Any] | None = None
    """Set when the throw has ended; the log stays open while the load is in the air."""
    ended_ns: int = 0


class ThrowTracker:
    """At most one throw at a time; the last one is remembered for an impact that comes late."""

    def __init__(self, spec: MachineSpec, sample: SensorSample) -> None:
        self._spec = spec
        self._throw: _Throw | None = None
        self._is_logging = False
        self._imu_ns = int(sample.imu_t_mono_ns[0])
        self._ball_ns = int(sample.ball_t_mono_ns[0])
        self._impact_ns = int(sample.impact_t_mono_ns[0])

    @property
    def throw_id(self) -> str | None:
        """The throw whose log is open."""
        return self._throw.throw_id if self._is_logging and self._throw is not None else None

    def enrich(self, event: ThrowEvent, tick_count: int, now_ns: int) -> ThrowEvent:
        """Note an event of the throw protocol; returns it with what is known about the release."""
        if event.kind is EventKind.THROW_ACCEPTED and event.throw_id is not None:
            self._throw = _Throw(event.throw_id, event.plan_id, tick_count)
            self._is_logging = True
        throw = self._throw
        if event.kind is not EventKind.THROW_ENDED or throw is None:
            return event
        data = {
            **event.data,
            "release_speed_m_per_s": throw.release_speed_m_per_s,
            "release_position_m": throw.release_position_m,
        }
        self._throw = replace(throw, result=data, ended_ns=now_ns)
        return replace(event, data=data)

    def watch(self, row: np.void, load_gone: bool, sample: SensorSample) -> ThrowEvent | None:
        """One tick; returns an impact, once.

        Args:
            row: telemetry.CONTROL_ROW of this tick.
            load_gone: the release was commanded and the load has left.
            sample: of this tick.
        """
        throw = self._throw
        if throw is not None and load_gone and not throw.has_left:
            tool = grip_centre(
                self._spec, row["joint_position_rad_m"], row["joint_velocity_rad_m_per_s"]
            )
            x, y, z = (float(value) for value in tool.position_m)
            speed = float(np.linalg.norm(tool.velocity_m_per_s))
            self._throw = replace(
                throw,
                has_left=True,
                release_speed_m_per_s=speed if np.isfinite(speed) else None,
                release_position_m=(x, y, z) if np.isfinite((x, y, z)).all() else None,
            )
        return self._impact(sample)

    def _impact(self, sample: SensorSample) -> ThrowEvent | None:
        t_ns = int(sample.impact_t_mono_ns[0])
        if t_ns == self._impact_ns:
            return None
        self._impact_ns = t_ns
        throw = self._throw
        if t_ns == 0 or throw is None or not throw.has_left or throw.has_impact:
            return None
        self._throw = replace(throw, has_impact=True)
        x, y, z = (float(value) for value in sample.impact_position_m[0])
        survey = ImpactSurvey(
            position_m=(x, y, z),
            sd_m=float(sample.impact_sd_m[0]),
            source="survey",
            footprint=_footprint(sample),
        )
        data = {**survey.model_dump(mode="json"), "t_mono_ns": t_ns}
        return ThrowEvent(EventKind.IMPACT, throw.throw_id, throw.plan_id, data)

    def rows(self, control: NDArray[np.void], sample: SensorSample) -> dict[str, NDArray[np.void]]:
        """Rows of this tick for the log, by channel; `control` gets the throw's own tick numbers."""
        rows = {"control": control}
        if self._is_logging and self._throw is not None:
            control["tick_count"] -= self._throw.first_tick_count
        imu_ns, ball_ns = int(sample.imu_t_mono_ns[0]), int(sample.ball_t_mono_ns[0])
        if imu_ns != self._imu_ns:
            self._imu_ns = imu_ns
            imu = np.zeros(1, IMU_ROW)
            imu["t_mono_ns"] = imu_ns
            imu["gyro_rad_per_s"] = sample.imu_gyro_rad_per_s
            imu["accel_m_per_s2"] = sample.imu_accel_m_per_s2
            rows["imu"] = imu
        if ball_ns not in (self._ball_ns, 0):
            ball = np.zeros(1, BALL_ROW)
            ball["t_mono_ns"] = ball_ns
            ball["position_m"] = sample.ball_position_m
            rows["ball"] = ball
        self._ball_ns = ball_ns
        return rows

    def finished(self, now_ns: int) -> dict[str, Any] | None:
        """Result of a log that is complete with this tick; then it is closed."""
        throw = self._throw
        if not self._is_logging or throw is None or throw.result is None:
            return None
        is_flying = throw.has_left and not throw.has_impact
        if is_flying and now_ns - throw.ended_ns < IMPACT_WAIT_NS:
            return None
        self._is_logging = False
        return throw.result


def _footprint(sample: SensorSample) -> MaterialFootprint | None:
    """Of bulk material, where the driver measures it."""
    if sample.impact_volume_m3 is None or sample.impact_covariance_m2 is None:
        return None
    xx, xy, yy = (float(value) for value in sample.impact_covariance_m2[0])
    volume_m3 = float(sample.impact_volume_m3[0])
    try:
        return MaterialFootprint(volume_m3=volume_m3, covariance_m2=(xx, xy, yy))
    except ValueError:
        # NaN for a ball; and what a driver measures must not stop the control loop.
        return None
