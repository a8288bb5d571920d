"""Records of a joint with known effects, by a plant that is independent of the product."""

from pathlib import Path

import numpy as np

from tests.diagnosis.single_stage.synthetic import Columns

STEP_S = 0.002


LEVELS = (1.0, -0.6, 0.3, -0.15, 0.45, -0.8, 0.6, -0.3)


def plant(
    command: np.ndarray,
    dead_time_s: float = 0.0,
    lag_s: float = 0.0,
    band: tuple[float, float] = (0.0, 0.0),
    hysteresis: float = 0.0,
    limit: float = np.inf,
    gap: float = 0.0,
    gain: float = 0.5,
) -> tuple[np.ndarray, np.ndarray]:
    """Speed and position in steps of 2 ms, independent of the product."""
    late = round(dead_time_s / STEP_S)
    speed = spool = true = seen = 0.0
    speeds, positions = [], []
    for k in range(len(command)):
        u = command[k - late] if k >= late else 0.0
        spool = min(max(spool, u - hysteresis), u + hysteresis)
        dead = band[0] if spool > 0 else band[1]
        steady = gain * np.sign(spool) * max(abs(spool) - dead, 0.0) / (1.0 - dead)
        steady = min(max(steady, -limit), limit)
        speed = steady if lag_s == 0.0 else speed + STEP_S * (steady - speed) / lag_s
        true += STEP_S * speed
        seen = min(max(seen, true - gap / 2), true + gap / 2)
        speeds.append(speed)
        positions.append(seen)
    return np.array(speeds), np.array(positions)


def record(
    path: Path,
    rate_hz: float = 50.0,
    noise: float = 0.001,
    scale: float = 1.0,
    jitter: float = 0.0,
    degrees: bool = False,
    wrapped: bool = False,
    span_s: float = 28.0,
    levels: tuple[float, ...] = LEVELS,
    **effects: float | tuple[float, float],
) -> Path:
    """A table of steps with rests; `jitter` of the clock in sample periods."""
    rng = np.random.default_rng(4)
    time_s = np.arange(0.0, span_s, STEP_S)
    command = np.zeros_like(time_s)
    for number in range(int(span_s / 3.2)):
        on = (time_s >= 1.0 + 3.2 * number) & (time_s < 3.0 + 3.2 * number)
        command[on] = levels[number % len(levels)]
    _, position = plant(command, **effects)
    seen_s = np.arange(0.0, span_s - 0.1, 1.0 / rate_hz)
    seen_s = np.sort(seen_s + jitter / rate_hz * rng.uniform(-1, 1, len(seen_s))).clip(0.0)
    u = command[(seen_s / STEP_S).astype(int)] * scale
    y = np.interp(seen_s, time_s, position) + rng.normal(0.0, noise, len(seen_s))
    if wrapped:
        y = (y + np.pi) % (2.0 * np.pi) - np.pi
    if degrees:
        y = np.degrees(y)
    head = f"time,cmd,position_{'deg' if degrees else 'rad'}"
    rows = np.stack([seen_s, u, y], axis=1)
    np.savetxt(path, rows, delimiter=",", header=head, comments="", fmt="%.7g")
    return path


def operated(
    seed: int,
    stops: tuple[float, float] = (-np.inf, np.inf),
    command_late_s: float = 0.0,
    span_s: float = 60.0,
) -> Columns:
    """A joint of 0.4 rad/s, dead time 0.15 s, lag 0.15 s, bands of 10 %, under held levers at 50 Hz."""
    rng = np.random.default_rng(seed)
    count = round(span_s / STEP_S)
    lever = np.zeros(count)
    k, way = 0, 1.0
    while k < count:
        held = round(rng.uniform(0.6, 2.2) / STEP_S)
        if rng.random() < 0.65:
            way = -way if rng.random() < 0.75 else way
            lever[k : k + held] = way * rng.uniform(0.2, 1.0)
        k += held
    speed = angle = 0.0
    angles = np.zeros(count)
    for k in range(count):
        u = lever[max(k - 75, 0)]
        steady = 0.4 * np.sign(u) * max(abs(u) - 0.1, 0.0) / 0.9
        speed += STEP_S / 0.15 * (steady - speed)
        angle += STEP_S * speed
        if not stops[0] < angle < stops[1]:
            angle, speed = float(np.clip(angle, *stops)), 0.0
        angles[k] = angle
    rows = np.arange(0, count, 10)
    logged = np.clip(rows - round(command_late_s / STEP_S), 0, None)
    return {
        "time_s": rows * STEP_S,
        "cmd": lever[logged],
        "pos_rad": angles[rows] + rng.normal(0.0, 0.001, len(rows)),
    }
