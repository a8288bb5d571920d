"""Loading of throw logs for the diagnosis: clock audit, small repairs with notes, refusals with reasons."""

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from diagnosis.loading.clock_audit import MIN_RATE_HZ, ClockAudit, audit_clock
from diagnosis.loading.log_checks import (
    MAX_MISSING_RATIO,
    RefusedLogError,
    check_constant,
    check_imu_units,
    check_joint_units,
    check_machine,
    check_places,
    check_stuck,
    check_valve_and_supply,
    is_number,
)
from diagnosis.loading.log_context import calibration_of, impact_of, profile_of, target_of
from diagnosis.loading.log_grid import ControlGrid, grid_control
from diagnosis.loading.throw_csv import LOG_SUFFIXES, WITHOUT_IMU, read_logs
from diagnosis.loading.throw_data import LoadedSet, ThrowData
from machine.conventions import Array
from machine.errors import LogError
from machine.spec import MachineSpec, load_spec
from runtime.records.log_reader import read_throw_log
from runtime.records.throw_log import RESULT_RECORD, ThrowLog

MIN_BALL_SAMPLES_COUNT: Final = 5
IMU_GAP_S: Final = 0.2
NO_IMU_NOTE: Final = (
    "no IMU: how the gripper swung is taken from the pitch and roll that the machine estimated; effects of "
    "the swing cannot be separated and are not claimed, nor a late valve from a late sensor"
)


def load_throws(
    paths: Sequence[Path],
    spec: MachineSpec | None = None,
    read_log: Callable[[Path], ThrowLog] = read_throw_log,
) -> LoadedSet:
    """Load throw logs.

    Args:
        paths: MCAP files, one a throw, CSV files, or folders of them.
        spec: the machine type that the logs must come from; the twin's own if left out.
        read_log: reads MCAP files; the server's has limits of memory and time.
    """
    machine = load_spec() if spec is None else spec
    refused: list[tuple[Path, str]] = []
    found: list[tuple[ThrowData, Mapping[str, Any]]] = []
    seen: dict[str, Path] = {}
    for path in _files(paths, refused):
        try:
            logs = read_logs(path, read_log)
        except LogError as error:
            refused.append((path, str(error)))
            continue
        for log in logs:
            name = f"throw {log.metadata['throw_id']}: " if len(logs) > 1 else ""
            try:
                throw, clocks = _load(path, log, machine)
            except LogError as error:
                refused.append((path, f"{name}{error}"))
                continue
            if throw.throw_id in seen:
                reason = f"throw {throw.throw_id} was already read from {seen[throw.throw_id]}"
                refused.append((path, reason))
                continue
            seen[throw.throw_id] = path
            found.append((throw, clocks))
    found = _of_one_machine(found, refused)
    return LoadedSet(
        throws=tuple(throw for throw, _ in found),
        refused=tuple(refused),
        rates=_rates([clocks for _, clocks in found]),
        clocks={throw.throw_id: clocks for throw, clocks in found},
    )


def _files(paths: Sequence[Path], refused: list[tuple[Path, str]]) -> list[Path]:
    files: list[Path] = []
    for path in paths:
        if path.is_dir():
            inside = sorted(p for p in path.rglob("*") if p.suffix.lower() in LOG_SUFFIXES)
            if not inside:
                refused.append((path, "the folder holds no throw log (*.mcap or *.csv)"))
            files += inside
        elif path.exists():
            files.append(path)
        else:
            refused.append((path, "no such file; give throw logs (.mcap, .csv) or folders"))
    return list(dict.fromkeys(files))


def _of_one_machine(
    found: list[tuple[ThrowData, Mapping[str, Any]]], refused: list[tuple[Path, str]]
) -> list[tuple[ThrowData, Mapping[str, Any]]]:
    """Keep the machine of most throws; without a majority keep none."""
    counts = Counter(throw.machine_id for throw, _ in found)
    if len(counts) <= 1:
        return found
    machine, most = counts.most_common(1)[0]
    majority = machine if 2 * most > len(found) else None
    listed = ", ".join(f"{name} ({count} throws)" for name, count in counts.most_common())
    for throw, _ in found:
        if throw.machine_id != majority:
            refused.append(
                (
                    throw.path,
                    f"throw of machine {throw.machine_id!r} in a set of several machines: {listed}. "
                    "Effects belong to one machine; diagnose each on its own",
                )
            )
    return [item for item in found if item[0].machine_id == majority]


def _load(path: Path, log: ThrowLog, spec: MachineSpec) -> tuple[ThrowData, Mapping[str, Any]]:
    check_machine(log.metadata, spec)
    _check_outcome(log)
    grid = grid_control(log.control)
    notes = list(grid.notes)
    open_s = _opening_s(grid)
    _check_grid(grid, spec)
    imu_t_s, gyro, accel, imu_audit = _imu_of(log, grid.start_ns, open_s, notes)
    ball_t_s, ball_m, ball_audit = _ball_of(log, grid.start_ns, open_s, notes)
    impact_m, impact_sd_m, impact_s = impact_of(log, grid.start_ns, notes)
    target_m = target_of(log.metadata)
    check_places(target=target_m, ball=ball_m, impact=impact_m)
    if not np.all(np.isfinite(impact_m)) and len(ball_m) < MIN_BALL_SAMPLES_COUNT:
        raise RefusedLogError(
            f"no impact and {len(ball_m)} ball samples: nobody measured where this load went. Truncated, "
            "or neither survey nor tracker ran"
        )
    if not log.is_complete:
        notes.append("not closed by its recorder; read up to the damage")
    if dropped := int(log.metadata.get(RESULT_RECORD, {}).get("dropped_count") or 0):
        notes.append(f"its recorder dropped {dropped} rows")
    throw = ThrowData(
        throw_id=str(log.metadata.get("throw_id") or path.stem),
        machine_id=str(log.metadata.get("machine_id") or ""),
        mode=str(log.metadata.get("mode") or ""),
        target_m=target_m,
        t_s=grid.t_s,
        valve_ratio=grid.valve_ratio,
        gripper_open=grid.gripper_open,
        sensor_t_s=grid.sensor_t_s,
        sensor_position_rad_m=grid.sensor_position_rad_m,
        sensor_velocity_rad_m_per_s=grid.sensor_velocity_rad_m_per_s,
        joint_position_rad_m=grid.joint_position_rad_m,
        joint_velocity_rad_m_per_s=grid.joint_velocity_rad_m_per_s,
        imu_t_s=imu_t_s,
        gyro_rad_per_s=gyro,
        accel_m_per_s2=accel,
        open_command_t_s=open_s,
        switch_open_t_s=_switch_open_s(grid, open_s),
        ball_t_s=ball_t_s,
        ball_m=ball_m,
        impact_m=impact_m,
        impact_sd_m=impact_sd_m,
        impact_t_s=impact_s,
        supply_pressure_pa=grid.supply_pressure_pa,
        calibration=calibration_of(log.metadata),
        spec_sha256=str(log.metadata.get("model_sha256") or spec.sha256),
        twin_profile=profile_of(log.metadata),
        recorded_at_ns=grid.start_ns,
        path=path,
        notes=tuple(notes),
    )
    clocks = {
        "control": grid.audit.as_json(),
        "imu": imu_audit.as_json(),
        "ball": ball_audit.as_json(),
        "sensor_age_s": float(np.median(grid.t_s - grid.sensor_t_s)),
    }
    return throw, clocks


def _opening_s(grid: ControlGrid) -> float:
    """When the gripper was commanded to open, s after the throw's start."""
    opened = np.flatnonzero(grid.gripper_open & (grid.t_s >= 0.0))
    if opened.size == 0:
        raise RefusedLogError(
            f"it ends {grid.t_s[-1]:.2f} s after the throw's start without an opening command: "
            "truncated or aborted. Only throws that released can be diagnosed"
        )
    return float(grid.t_s[opened[0]])


def _switch_open_s(grid: ControlGrid, open_s: float) -> float:
    """When the load left the gripper's switch, s; nan if it was never seen."""
    # The latch was seen closed before: a switch that never closed carries no information.
    held = np.maximum.accumulate(grid.payload_held)
    left = np.flatnonzero(held & ~grid.payload_held & (grid.t_s >= open_s))
    return float(grid.t_s[left[0]]) if left.size else math.nan


def _imu_of(
    log: ThrowLog, start_ns: int, open_s: float, notes: list[str]
) -> tuple[Array, Array, Array, ClockAudit]:
    """Times (K,), gyro (K, 3), accelerometer (K, 3) and the audit of their clock."""
    fields = ("gyro_rad_per_s", "accel_m_per_s2")
    t_s, values, audit = _samples("imu", log.imu, fields, start_ns, notes)
    gyro, accel = values[:, :3], values[:, 3:]
    if log.metadata.get(WITHOUT_IMU):
        notes.append(NO_IMU_NOTE)
    else:
        _check_imu(t_s, gyro, accel, audit, open_s)
    return t_s, gyro, accel, audit


def _ball_of(
    log: ThrowLog, start_ns: int, open_s: float, notes: list[str]
) -> tuple[Array, Array, ClockAudit]:
    """Times (B,) and places (B, 3) of the load after the opening, and the audit of their clock."""
    t_s, position_m, audit = _samples("ball", log.ball, ("position_m",), start_ns, notes)
    t_s, position_m = t_s[t_s >= open_s], position_m[t_s >= open_s]
    check_constant("the tracked ball", position_m)
    if len(position_m) < MIN_BALL_SAMPLES_COUNT:
        notes.append("no ball track: release, speed and flight are one term of the miss")
    return t_s, position_m, audit


def _check_outcome(log: ThrowLog) -> None:
    outcome = str(log.metadata.get(RESULT_RECORD, {}).get("outcome") or "")
    if outcome in ("aborted", "stopped", "fault"):
        detail = log.metadata[RESULT_RECORD].get("detail") or "no detail"
        raise RefusedLogError(
            f"the throw ended {outcome} ({detail}); only throws that landed can be used"
        )


def _check_grid(grid: ControlGrid, spec: MachineSpec) -> None:
    position, velocity = grid.sensor_position_rad_m, grid.sensor_velocity_rad_m_per_s
    check_valve_and_supply(grid.valve_ratio, grid.supply_pressure_pa)
    check_stuck(position, velocity, grid.valve_ratio)
    check_joint_units(spec, position, velocity, grid.joint_position_rad_m)


def _samples(
    name: str, rows: NDArray[np.void], fields: tuple[str, ...], start_ns: int, notes: list[str]
) -> tuple[Array, Array, ClockAudit]:
    """Times (K,) from the throw's start and values (K, axes) of a sampled channel; holes are dropped."""
    time_s = (rows["t_mono_ns"] - start_ns).astype(np.float64) * 1e-9
    values = np.concatenate([rows[field].astype(np.float64) for field in fields], axis=1)
    audit = audit_clock(time_s)
    if audit.backward_count:
        raise RefusedLogError(
            f"the clock of /{name} goes back {audit.backward_count} times: it was set during the throw, "
            "or samples are out of order. Record with the machine's monotonic clock"
        )
    keep = np.concatenate([[True], np.diff(time_s) > 0.0])[: len(time_s)]
    finite = is_number(values)
    lost = int(np.sum(~finite))
    if lost > max(3, MAX_MISSING_RATIO * len(values)):
        raise RefusedLogError(
            f"/{name} has {lost} of {len(values)} samples with NaN: the sensor dropped out. Repair it "
            "and record this throw again"
        )
    if audit.duplicate_count:
        notes.append(f"/{name}: {audit.duplicate_count} duplicate samples dropped")
    if lost:
        notes.append(f"/{name}: {lost} samples with NaN dropped")
    keep &= finite
    return time_s[keep], values[keep], audit


def _check_imu(t_s: Array, gyro: Array, accel: Array, audit: ClockAudit, open_s: float) -> None:
    during = (t_s >= 0.0) & (t_s <= open_s)
    if int(np.sum(during)) < int(MIN_RATE_HZ * open_s):
        rate = float(np.sum(during)) / max(open_s, 1e-3)
        raise RefusedLogError(
            f"the IMU has {rate:.3g} samples a second during the throw, at least {MIN_RATE_HZ:g} are "
            "needed: it hung, has another clock, or was thinned out. Check its cable and clock"
        )
    gap_s = float(np.max(np.diff(t_s[during]), initial=0.0))
    if gap_s > IMU_GAP_S:
        raise RefusedLogError(
            f"{gap_s:.2f} s without an IMU sample during the throw: it dropped out or its clock jumped "
            f"(longest gap in the log {audit.longest_gap_s:.2f} s). Check its cable and clock"
        )
    check_constant("the gyro", gyro)
    check_constant("the accelerometer", accel)
    check_imu_units(gyro, accel)


def _rates(clocks: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    names = ("control", "imu", "ball") if clocks else ()
    return {name: float(np.median([clock[name]["rate_hz"] for clock in clocks])) for name in names}
