"""Synthetic records of pendulums, joints and balls with known effects.

The equations are independent of the product. Each maker returns columns (rows,) with sensor noise, under
column names and units that other programs use. With no effect given the record is that of the ideal stage.
"""

import math
from collections.abc import Callable, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from diagnosis.verdict import Diagnosis

Columns = dict[str, np.ndarray]
Slope = Callable[[np.ndarray], np.ndarray]


def write(path: Path, columns: Mapping[str, np.ndarray], separator: str = ",") -> Path:
    """A table of columns; text columns as they are, numbers with 9 digits."""
    cells = [
        [str(v) for v in column] if column.dtype.kind in "UO" else [f"{v:.9g}" for v in column]
        for column in columns.values()
    ]
    rows = [separator.join(columns), *(separator.join(row) for row in zip(*cells, strict=True))]
    path.write_text("\n".join(rows) + "\n")
    return path


def joined(runs: list[Columns], **labels: list[str]) -> Columns:
    """Several runs in one table, with a column for each label."""
    merged = {name: np.concatenate([run[name] for run in runs]) for name in runs[0]}
    for name, values in labels.items():
        sizes = [len(next(iter(run.values()))) for run in runs]
        merged[name] = np.repeat(np.array(values), sizes)
    return merged


def _ode(slope: Slope, state: np.ndarray, seconds: np.ndarray, fine_s: float) -> np.ndarray:
    """States at `seconds`, (rows, states), by explicit midpoint in steps of at most `fine_s`."""
    rows = [state]
    for start, end in pairwise(seconds.tolist()):
        count = max(1, int(np.ceil((end - start) / fine_s)))
        h = (end - start) / count
        for _ in range(count):
            state = state + h * slope(state + 0.5 * h * slope(state))
        rows.append(state)
    return np.array(rows)


def pendulum(
    rng: np.random.Generator,
    viscous: float = 0.0,
    coulomb: float = 0.0,
    quadratic: float = 0.0,
    rate_hz: float = 50.0,
    noise_rad: float = 0.003,
) -> Columns:
    """A swing of 20 s: t in s, theta in degrees, its rate in deg/s with a gyro's bias."""
    omega = rng.uniform(2.2, 4.5)
    t = np.arange(0.0, 20.0, 1.0 / rate_hz)
    h, x, v = 5e-4, rng.uniform(0.35, 0.7), 0.0
    states: list[tuple[float, float]] = []
    for _ in range(int(t[-1] / h) + 2):
        states.append((x, v))
        pull = -(omega**2) * math.sin(x)
        moved = v + h * (pull - viscous * v - quadratic * abs(v) * v)
        held = coulomb * h
        # Dry friction takes what is left of the speed, and then holds against any weaker pull.
        v = math.copysign(max(abs(moved) - held, 0.0), moved)
        if v == 0.0 and abs(pull) > coulomb:
            v = moved
        x += h * v
    s = np.array(states)[np.round(t / h).astype(int)]
    angle = s[:, 0] + rng.uniform(-0.03, 0.03) + rng.normal(0.0, noise_rad, len(t))
    gyro = s[:, 1] + rng.normal(0.0, 3.0 * noise_rad, len(t)) + rng.uniform(-0.01, 0.01)
    return {"t": t, "theta_deg": np.degrees(angle), "omega_deg_s": np.degrees(gyro)}


def swing_angles(
    viscous: float = 0.0,
    coulomb: float = 0.0,
    air: float = 0.0,
    start: float = 0.6,
    frequency: float = 3.0,
    span_s: float = 14.0,
) -> np.ndarray:
    """Angles of a pendulum every millisecond, rad, by semi-implicit Euler with exact dry friction."""
    step_s = 1e-3
    angle, rate, rows = start, 0.0, []
    for _ in range(round(span_s / step_s)):
        rows.append(angle)
        pull = -(frequency**2) * math.sin(angle) - viscous * rate - air * abs(rate) * rate
        if abs(rate) < 2.0 * coulomb * step_s and abs(pull) < coulomb:
            rate = 0.0
        else:
            rate += step_s * (pull - coulomb * np.sign(rate))
        angle += step_s * rate
    return np.array(rows)


CAUGHT_S = 14.03


def caught_swing(seed: int, coulomb: float = 0.03) -> Columns:
    """A swing with friction that a hand stops within 0.1 s of `CAUGHT_S`: angle in rad, rate in rad/s."""
    one = pendulum(np.random.default_rng(seed), viscous=0.05, coulomb=coulomb, noise_rad=0.0)
    t, angle = one["t"], np.radians(one["theta_deg"])
    held = t > CAUGHT_S
    angle = angle - np.mean(angle[:-1])
    angle[held] = angle[np.argmax(held)] * np.exp(-(t[held] - CAUGHT_S) / 0.1)
    rng = np.random.default_rng(seed)
    rate = np.gradient(angle, t) + rng.normal(0.0, 0.004, len(t)) + 0.01
    return {"t": t, "angle_rad": angle + rng.normal(0.0, 0.002, len(t)), "rate": rate}


def joint(
    rng: np.random.Generator,
    dead_time_s: float = 0.0,
    lag_s: float = 0.0,
    dead_band: float = 0.0,
    top_speed: float = np.inf,
    rate_hz: float = 50.0,
    noise_rad: float = 0.001,
    held_s: float = 0.0,
) -> Columns:
    """An excavator's joint over 40 s of steps and ramps: lever in per cent, angle in degrees, speed in deg/s.

    `held_s` is the period of the log of the lever, which keeps its value in between.
    """
    h = 2e-3
    t = np.arange(0.0, 40.0, h)
    knots = np.arange(0.0, 41.0, 1.6)
    sizes = rng.uniform(0.15, 1.0, len(knots)) * rng.choice([-1.0, 1.0], len(knots))
    sizes[::3] = 0.0
    steps = sizes[np.clip(np.searchsorted(knots, t, side="right") - 1, 0, None)]
    lever = np.where(t < 28.0, steps, np.interp(t, knots, sizes))
    gain = rng.uniform(0.3, 0.7)
    seen = np.concatenate([np.zeros(round(dead_time_s / h)), lever])[: len(t)]
    seen = np.sign(seen) * np.maximum(np.abs(seen) - dead_band, 0.0) / (1.0 - dead_band)
    wanted = np.clip(gain * seen, -top_speed * gain, top_speed * gain)
    speed = np.zeros(len(t))
    for k in range(1, len(t)):
        speed[k] = (
            wanted[k]
            if lag_s == 0.0
            else speed[k - 1] + (1.0 - np.exp(-h / lag_s)) * (wanted[k] - speed[k - 1])
        )
    angle = np.cumsum(speed) * h
    rows = np.arange(0.0, 39.9, 1.0 / rate_hz)
    at = (rows / h).astype(int)
    logged = at if held_s == 0.0 else (np.floor(rows / held_s) * held_s / h).astype(int)
    n = len(rows)
    return {
        "stamp_ms": rows * 1e3,
        "lever_pct": 100.0 * lever[logged],
        "boom_deg": np.degrees(angle[at] + rng.normal(0.0, noise_rad, n)),
        "boom_rate_deg_s": np.degrees(speed[at] + rng.normal(0.0, 10.0 * noise_rad, n)),
    }


def ball(
    rng: np.random.Generator,
    drag_per_m: float = 0.0,
    wind_m_per_s: tuple[float, float] = (0.0, 0.0),
    lift_per_m: float = 0.0,
    rate_hz: float = 60.0,
    noise_m: float = 0.005,
    scale: float = 1.0,
    tilt_rad: float = 0.0,
    is_drop: bool = False,
) -> Columns:
    """One throw or drop in x, y, z (up), by a tracker of a wrong scale that leans along x by `tilt_rad`."""
    if is_drop:
        v = np.zeros(3)
        span, height = rng.uniform(1.2, 1.6), 15.0
    else:
        speed, up, side = rng.uniform(7.0, 12.0), rng.uniform(0.5, 0.95), rng.uniform(-0.15, 0.15)
        v = speed * np.array([np.cos(up) * np.cos(side), np.cos(up) * np.sin(side), np.sin(up)])
        span, height = 2.0 * v[2] / 9.81, 1.8
    air = np.array([*wind_m_per_s, 0.0])
    right = np.array([v[1], -v[0], 0.0])
    right = right / max(float(np.linalg.norm(right)), 1e-9)

    def slope(s: np.ndarray) -> np.ndarray:
        w = s[3:] - air
        lift = lift_per_m * np.linalg.norm(s[3:]) * np.cross(right, s[3:])
        gravity = np.array([0.0, 0.0, -9.81])
        return np.concatenate([s[3:], gravity + lift - drag_per_m * np.linalg.norm(w) * w])

    t = np.arange(0.0, span, 1.0 / rate_hz)
    p = _ode(slope, np.concatenate([[0.0, 0.0, height], v]), t, 4e-3)[:, :3]
    x = p[:, 0] * np.cos(tilt_rad) + p[:, 2] * np.sin(tilt_rad)
    z = p[:, 2] * np.cos(tilt_rad) - p[:, 0] * np.sin(tilt_rad)
    seen = scale * np.stack([x, p[:, 1], z], axis=1) + rng.normal(0.0, noise_m, (len(t), 3))
    return {"t": t, "x": seen[:, 0], "y": seen[:, 1], "z": seen[:, 2]}


def throws(rng: np.random.Generator, count: int = 5, **effects: Any) -> Columns:
    """Throws of a ball, filmed: the scale is good to 0.6 %, the vertical to 0.35 degrees."""
    camera = {"scale": 1.0 + rng.normal(0.0, 0.006), "tilt_rad": rng.normal(0.0, 0.006)}
    return joined([ball(rng, **camera, **effects) for _ in range(count)])


def effects(found: Diagnosis) -> set[str]:
    """Names of the effects of the first cause."""
    return {effect.effect for effect in found.causes[0].effects}


def value(found: Diagnosis, effect: str, parameter: str) -> tuple[float, float, float]:
    """Low end, value and high end of one parameter."""
    (one,) = [e for e in found.causes[0].effects if e.effect == effect]
    fitted = one.parameters[parameter]
    return fitted.ci90[0], fitted.value, fitted.ci90[1]


def join_notes(found: Diagnosis) -> str:
    """All notes as one text."""
    return " ".join(found.evidence["notes"])


DROPS = Path(__file__).parents[1] / "data" / "ball_drops" / "ball_drops.csv"


FLIGHT_STEP_S = 0.001


def thrown(
    velocity: tuple[float, float, float],
    drag_per_m: float = 0.0,
    wind: tuple[float, float, float] = (0.0, 0.0, 0.0),
    span_s: float = 1.2,
) -> np.ndarray:
    """Positions every millisecond, semi-implicit Euler, (ticks, 3)."""
    p, v, rows = np.array([0.0, 0.0, 1.5]), np.array(velocity, dtype=float), []
    for _ in range(round(span_s / FLIGHT_STEP_S)):
        rows.append(p.copy())
        air = v - np.array(wind)
        v = v + FLIGHT_STEP_S * (
            np.array([0.0, 0.0, -9.81]) - drag_per_m * np.linalg.norm(air) * air
        )
        p = p + FLIGHT_STEP_S * v
    return np.array(rows)


def write_flights(
    path: Path, flights: list[np.ndarray], rate_hz: float = 100.0, noise_m: float = 0.003
) -> Path:
    rng = np.random.default_rng(1)
    lines = ["t,x,y,z"]
    for flight in flights:
        rows = flight[:: round(1.0 / rate_hz / FLIGHT_STEP_S)]
        rows = rows + rng.normal(0.0, noise_m, rows.shape)
        lines += [f"{k / rate_hz:.5f},{x:.5f},{y:.5f},{z:.5f}" for k, (x, y, z) in enumerate(rows)]
    path.write_text("\n".join(lines) + "\n")
    return path


def real_drops(path: Path, *balls: str, columns: slice = slice(None)) -> Path:
    """Rows of the measured drops of these balls."""
    rows = [line.split(",") for line in DROPS.read_text().splitlines()]
    chosen = [rows[0], *(row for row in rows[1:] if row[0] in balls)]
    path.write_text("\n".join(",".join(row[columns]) for row in chosen) + "\n")
    return path


def write_angles(
    path: Path, angle: np.ndarray, rate_hz: float = 50.0, held_s: float = 0.0, offset: float = 0.0
) -> Path:
    """A table of angles in degrees; `angle` every millisecond, held at first for `held_s`."""
    angle = np.concatenate([np.full(round(1000.0 * held_s), angle[0]), angle])
    seen = angle[:: round(1000.0 / rate_hz)] + offset
    seen = seen + np.random.default_rng(2).normal(0.0, 0.002, len(seen))
    columns = {"time_s": np.arange(len(seen)) / rate_hz, "theta_deg": np.degrees(seen)}
    return write(path, columns, ";")
