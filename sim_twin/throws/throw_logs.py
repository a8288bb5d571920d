"""Throw logs of campaigns, with the rows that a machine's recorder writes.

True states and random parameters of the simulator are not logged, so that a log of the virtual machine
contains no more information than a log of a real one.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machine.conventions import CONTROL_PERIOD_NS, DEFAULT_PACE_RATIO, Array, IntArray
from machine.messages import EventKind, ImpactSurvey, MachineEvent, ThrowEnd
from machine.telemetry import BALL_ROW, IMU_ROW
from runtime.control.control_loop import ControlOutputs, ControlParams
from runtime.driver import SensorSample, SimulatedDriver
from runtime.records.log_writer import StoredLog, write_throw_log
from runtime.records.recorder import log_path
from runtime.records.throw_log import RESULT_RECORD, ThrowLog
from sim_twin.throws.campaign import ThrowOutcome, ThrowResult
from sim_twin.twin.profile import TwinProfile


@dataclass(frozen=True, slots=True)
class LogContext:
    """Metadata of every log of a campaign."""

    machine_id: str
    throw_prefix: str
    """Prefix of throw ids: this, a dash, and a number."""
    twin_profile_version_count: int
    out_dir: Path
    twin_profile: TwinProfile | None = None
    """Twin profile of the machine, stored in every log so that a log can be diagnosed without other files."""
    throw_numbers: tuple[int, ...] = ()
    """Numbers of the throws within their set; counted from 0 if empty."""
    pace_ratio: float = DEFAULT_PACE_RATIO
    """Id of the campaign's policy."""
    free_from_ns: int = 0
    """Earliest time of the first log on the machine's clock; the plant's clock is moved on to it."""
    throw_period_s: float = 0.0
    """Time from one throw of the set to the next on the machine's clock, on which throws that are simulated
    side by side follow each other; 0 leaves them side by side."""
    test: str = ""
    """Kind of identification test (sim_twin.commissioning.motions); empty for throws."""


class CampaignRecorder:
    """Collects the rows of the running batch and writes one log per throw at its end."""

    def __init__(self, params: ControlParams, context: LogContext) -> None:
        """Start an empty recording; `params` are those of the campaign."""
        self._params, self._context = params, context
        self.stored: list[StoredLog] = []
        self._first, self._count, self._start_ns = 0, 0, 0
        self._later_ns: int | None = None
        self._control: list[NDArray[np.void]] = []
        self._policy: list[NDArray[np.void]] = []
        self._samples: list[SensorSample] = []

    def begin(self, plant: SimulatedDriver, first_throw_count: int, throw_count: int) -> None:
        """Start a batch: its first `throw_count` machines carry out throws from `first_throw_count` on."""
        self._first, self._count = first_throw_count, throw_count
        self._start_ns = plant.now_ns()
        if self._later_ns is None:
            self._later_ns = max(0, self._context.free_from_ns - self._start_ns)
        self._samples = [plant.read()]
        self._control, self._policy = [], []

    def tick(self, now_ns: int, sample: SensorSample, outputs: ControlOutputs) -> None:
        """Collect one tick of the batch."""
        self._control.append(outputs.row)
        if outputs.policy_row is not None:
            self._policy.append(outputs.policy_row)
        self._samples.append(sample)

    def end(self, results: Sequence[ThrowResult]) -> None:
        """Write the batch's logs.

        Raises:
            LogError: a file cannot be written.
        """
        control, policy = np.stack(self._control), np.stack(self._policy)
        imu = _stacked(self._samples, "imu_t_mono_ns", "imu_gyro_rad_per_s", "imu_accel_m_per_s2")
        ball = _stacked(self._samples, "ball_t_mono_ns", "ball_position_m")
        for index in range(self._count):
            result = results[index]
            if not self.wants(result):
                continue
            ticks = min(round(result.simulated_s * 1e9 / CONTROL_PERIOD_NS), control.shape[0])
            last = self._samples[ticks]
            numbers = self._context.throw_numbers
            number = numbers[self._first + index] if numbers else self._first + index
            throw_id = f"{self._context.throw_prefix}-{number:04d}"
            rows = policy[:, index]
            rows = rows[(rows["t_mono_ns"] > 0) & (rows["t_mono_ns"] <= last.t_mono_ns)]
            log = ThrowLog(
                metadata=self._metadata(throw_id, result),
                control=control[:ticks, index],
                policy=rows,
                imu=_rows(IMU_ROW, [part[: ticks + 1, index] for part in imu]),
                ball=_rows(BALL_ROW, [part[: ticks + 1, index] for part in ball]),
                events=self._events(throw_id, result, control[:ticks, index], last, index),
                impact=_survey(result, last, index),
                impact_t_mono_ns=int(last.impact_t_mono_ns[index]),
            )
            later_ns = (self._later_ns or 0) + round(number * self._context.throw_period_s * 1e9)
            self.store(throw_id, _later(log, later_ns))
        self._control, self._policy, self._samples = [], [], []

    def wants(self, result: ThrowResult) -> bool:
        """Whether to write a throw's log; here all."""
        del result
        return True

    def store(self, throw_id: str, log: ThrowLog) -> None:
        """Write one log."""
        self.stored.append(write_throw_log(log_path(self._context.out_dir, throw_id), log))

    def _metadata(self, throw_id: str, result: ThrowResult) -> dict[str, Any]:
        params, context = self._params, self._context
        x, y, z = result.target_m
        own = context.twin_profile
        return {
            **({} if own is None else {"twin_profile": own.model_dump(mode="json")}),
            **({"test": context.test} if context.test else {}),
            "throw_id": throw_id,
            "machine_id": context.machine_id,
            "mode": params.mode.value,
            "target": {"x_m": x, "y_m": y, "z_m": z},
            "pace_ratio": context.pace_ratio,
            "plan_hash": "",
            "policy_id": "" if params.policy is None else params.policy.card.policy_id,
            "policy_sha256": "" if params.policy is None else params.policy.card.policy_sha256,
            "model_sha256": params.spec.sha256,
            "twin_profile_version": context.twin_profile_version_count,
            "software": _software(),
            "calibration": params.calibration.model_dump(mode="json"),
            "spec": params.spec.model_dump(mode="json"),
            RESULT_RECORD: _ended(result).model_dump(mode="json"),
        }

    def _events(
        self,
        throw_id: str,
        result: ThrowResult,
        control: NDArray[np.void],
        last: SensorSample,
        index: int,
    ) -> tuple[MachineEvent, ...]:
        """Events that a machine sends in such a throw, in order."""
        found = [(EventKind.THROW_STARTED, self._start_ns, {})]
        opened = np.flatnonzero(control["gripper_open_commanded"])
        if opened.size:
            at_ns = int(control["t_mono_ns"][opened[0]])
            found.append((EventKind.RELEASE_COMMANDED, at_ns, {}))
        impact = _survey(result, last, index)
        if impact is not None:
            at_ns = int(last.impact_t_mono_ns[index])
            found.append((EventKind.IMPACT, at_ns, impact.model_dump(mode="json")))
        ended = _ended(result).model_dump(mode="json")
        found.append((EventKind.THROW_ENDED, int(last.t_mono_ns), ended))
        return tuple(
            MachineEvent(
                machine_id=self._context.machine_id,
                boot_id="campaign",
                sequence_count=number,
                t_mono_ns=at_ns,
                t_utc="",
                kind=kind,
                throw_id=throw_id,
                data=data,
            )
            for number, (kind, at_ns, data) in enumerate(found)
        )


class FailureRecorder(CampaignRecorder):
    """Writes a limited number of logs, of failed throws only."""

    def __init__(self, params: ControlParams, context: LogContext, most_count: int) -> None:
        """Start an empty recording that writes at most `most_count` logs."""
        super().__init__(params, context)
        self._left_count = most_count

    def wants(self, result: ThrowResult) -> bool:
        """Whether the throw failed and the limit is not reached."""
        if result.outcome is ThrowOutcome.LANDED or self._left_count == 0:
            return False
        self._left_count -= 1
        return True


def _later(log: ThrowLog, by_ns: int) -> ThrowLog:
    """The log with all its times later by `by_ns`; times 0, which mean never, stay."""
    if by_ns == 0:
        return log

    def shifted(rows: NDArray[np.void]) -> NDArray[np.void]:
        rows = rows.copy()
        for name in rows.dtype.names or ():
            if name.endswith("t_mono_ns"):
                rows[name] += by_ns * (rows[name] > 0)
        return rows

    return replace(
        log,
        control=shifted(log.control),
        policy=shifted(log.policy),
        imu=shifted(log.imu),
        ball=shifted(log.ball),
        events=tuple(
            event.model_copy(update={"t_mono_ns": event.t_mono_ns + by_ns}) for event in log.events
        ),
        impact_t_mono_ns=log.impact_t_mono_ns + by_ns * (log.impact_t_mono_ns > 0),
    )


def _software() -> str:
    try:
        return f"downrange {version('downrange')}"
    except PackageNotFoundError:
        return "downrange"


def _ended(result: ThrowResult) -> ThrowEnd:
    landed = result.outcome is ThrowOutcome.LANDED
    released = np.isfinite(result.throw_duration_s)
    return ThrowEnd(
        outcome="landed" if landed else "aborted",
        detail="" if landed else result.outcome.value,
        release_speed_m_per_s=result.release_speed_m_per_s if released else None,
        throw_duration_s=result.throw_duration_s if released else None,
    )


def _survey(result: ThrowResult, last: SensorSample, index: int) -> ImpactSurvey | None:
    if result.outcome is not ThrowOutcome.LANDED:
        return None
    x, y, z = (float(v) for v in last.impact_position_m[index])
    return ImpactSurvey(position_m=(x, y, z), sd_m=float(last.impact_sd_m[index]), source="survey")


def _stacked(samples: Sequence[SensorSample], *names: str) -> list[Array | IntArray]:
    """Columns of the samples, each (ticks, N, ...); the sample time is the first."""
    return [np.stack([getattr(sample, name) for sample in samples]) for name in names]


def _rows(dtype: np.dtype[np.void], columns: Sequence[Array | IntArray]) -> NDArray[np.void]:
    """Whether samples are new: their time is set and differs from the previous tick's."""
    time_ns = columns[0]
    new = time_ns > 0
    new[1:] &= time_ns[1:] != time_ns[:-1]
    rows = np.zeros(int(np.count_nonzero(new)), dtype=dtype)
    for name, column in zip(dtype.names or (), columns, strict=True):
        rows[name] = column[new]
    return rows
