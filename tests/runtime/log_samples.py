"""Random throw logs."""

from typing import Any

import numpy as np

from machine.messages import EventKind, ImpactSurvey, MachineEvent
from runtime.records.throw_log import ROW_TYPES, ThrowLog


def random_rows(name: str, count: int, seed: int, *, specials: bool = False) -> np.ndarray:
    rng = np.random.default_rng(seed)
    rows = np.zeros(count, ROW_TYPES[name])
    for field in rows.dtype.names:
        kind = rows[field].dtype.kind
        shape = rows[field].shape
        if kind == "f":
            values = rng.normal(size=shape) * 10.0 ** rng.integers(-8, 8, size=shape)
            if specials:
                values[rng.random(shape) < 0.1] = np.nan
                values[rng.random(shape) < 0.05] = np.inf
            rows[field] = values
        else:
            rows[field] = rng.integers(0, 2 if kind == "b" else 100, size=shape)
    rows["t_mono_ns"] = 5_000_000_000 + np.arange(count) * 10_000_000
    return rows


def event(sequence: int, kind: EventKind = EventKind.THROW_STARTED) -> MachineEvent:
    return MachineEvent(
        machine_id="m001",
        boot_id="boot",
        sequence_count=sequence,
        t_mono_ns=5_000_000_000 + sequence,
        t_utc="2026-01-01T00:00:00+00:00",
        kind=kind,
        throw_id="t1",
        data={"n": sequence},
    )


def random_log(seed: int = 0, ticks: int = 120, **metadata: Any) -> ThrowLog:
    return ThrowLog(
        {"throw_id": "t1", "machine_id": "m001", "target": {"x_m": 8.25}, **metadata},
        random_rows("control", ticks, seed),
        random_rows("policy", ticks // 8, seed),
        random_rows("imu", ticks, seed),
        random_rows("ball", 20, seed),
        tuple(event(n) for n in range(3)),
        ImpactSurvey(position_m=(8.0, 0.1, 0.0), sd_m=0.02, source="survey"),
        6_000_000_000,
    )


def same_rows(one: ThrowLog, other: ThrowLog) -> bool:
    return all(
        np.array_equal(getattr(one, name)[field], getattr(other, name)[field], equal_nan=True)
        for name, dtype in ROW_TYPES.items()
        for field in dtype.names
        if dtype[field].base.kind == "f" or getattr(one, name)[field].dtype.kind != "f"
    )
