"""Series for the report: measurements, and the twin's answer to the same commands, before and after.

An effect of a drive is simulated from the commands to the impact, so that a late joint is also late
downstream. Any other effect is simulated from the measured motion of the joints, so that the errors that the
drives of every machine have do not hide it. The mean error of healthy machines of the type is corrected
before and after alike.
"""

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any
from uuid import UUID

import numpy as np

from diagnosis.hypotheses.gap_problem import GapProblem
from diagnosis.linearisation.open_loop import corrected_input
from diagnosis.linearisation.simulation import joint_latency_s
from diagnosis.linearisation.simulation_batch import ALL
from diagnosis.loading.prepared import PreparedThrow
from machine.conventions import ACTIVE_JOINTS, CONTROL_PERIOD_S, Array
from sim_twin.effects.effect import Effect, acting_effect, effect_stage
from sim_twin.effects.table import EFFECTS
from sim_twin.replay.drives import replay_drives
from sim_twin.replay.replay import ReplayElement, replay
from sim_twin.replay.types import ReplayOutput

SHOWN_COUNT = 3
"""Throws: the first, one of the middle, and the last."""
DIGITS = 4
PITCH_AXIS = 1
"""Axis of the gyro about which the load swings in a throw straight ahead."""
NO_EFFECTS: tuple[Effect, ...] = ()
TURN_RATE = "gripper's turn rate"
HEIGHT = "load's height in flight"
FROM_MEASURED = {TURN_RATE: "turn rate from measured joints", HEIGHT: "height from measured joints"}
"""Titles of these series where the joints are taken as measured."""


def overlay(
    problem: GapProblem, effects: Sequence[Effect], where: tuple[str, str | None] | None = None
) -> dict[str, Any]:
    """Plots ``{name: {x, x_unit, unit, measured, twin_before, twin_after, throw_id, thrown_utc}}``.

    ``twin_after`` only with effects; ``thrown_utc`` is None where it is not known.

    The signals that the effects act on come first, then the located stage, then the rest of the chain.

    Args:
        problem: the throws and their twin.
        effects: of the best cause.
        where: stage and joint of the largest gap.
    """
    places = [(effect_stage(e), e.joint, acting_effect(e)) for e in effects]
    if where is not None:
        places.append((*where, ""))
    wanted = [_signal(*place) for place in places]
    is_driven = not effects or any(effect_stage(e) == "actuation" for e in effects)
    plots = _all(problem, effects, is_driven=is_driven)
    names = list(dict.fromkeys([name for name in wanted if name in plots] + list(plots)))
    titles = {} if is_driven else FROM_MEASURED
    throws = dict(enumerate(problem.prepared, start=1))
    return {
        f"{titles.get(name, name)}, throw {number}": {**plot, **_source(throws[number])}
        for name in names
        for number, plot in plots[name].items()
    }


def _source(p: PreparedThrow) -> dict[str, str | None]:
    """Which throw a plot shows, and when it was if its id tells: one of version 7 begins with it."""
    throw_id = p.throw.throw_id
    try:
        known = UUID(throw_id)
    except ValueError:
        return {"throw_id": throw_id, "thrown_utc": None}
    if known.version != 7:
        return {"throw_id": throw_id, "thrown_utc": None}
    at = datetime.fromtimestamp((known.int >> 80) / 1000.0, UTC)
    return {"throw_id": throw_id, "thrown_utc": at.strftime("%Y-%m-%dT%H:%M:%SZ")}


def _signal(stage: str, joint: str | None, effect: str) -> str:
    """The signal that shows an effect, or the term of a stage, best."""
    if joint is not None:
        return f"{joint} velocity"
    if stage == "swing" or (effect in EFFECTS and EFFECTS[effect].part == "imu"):
        return TURN_RATE
    # A limited pump shows at the boom, which needs the most flow.
    return f"{ACTIVE_JOINTS[1]} velocity" if stage == "actuation" else HEIGHT


def _all(
    problem: GapProblem, effects: Sequence[Effect], *, is_driven: bool
) -> dict[str, dict[int, dict[str, Any]]]:
    """All plots by name of the signal and number of the throw."""
    shown = _shown(problem.prepared)
    cases = {"twin_before": NO_EFFECTS}
    if effects:
        cases["twin_after"] = tuple(effects)
    found = {
        name: _simulate(problem, shown, case, is_driven=is_driven) for name, case in cases.items()
    }
    plots: dict[str, dict[int, dict[str, Any]]] = {}
    for k, p in enumerate(shown):
        number, at_s, rows = _number(problem, p), p.motion.t_s, p.motion.t_s.size
        for joint, name in enumerate(ACTIVE_JOINTS):
            measured = p.throw.sensor_velocity_rad_m_per_s[:, joint]
            plots.setdefault(f"{name} velocity", {})[number] = _plot(
                at_s,
                "m/s" if name == "telescope" else "rad/s",
                np.interp(at_s, p.throw.sensor_t_s, measured),
                {case: velocity[k][:rows, joint] for case, (velocity, _) in found.items()},
            )
        if p.throw.imu_t_s.size > 1:
            measured = p.throw.gyro_rad_per_s[:, PITCH_AXIS]
            plots.setdefault(TURN_RATE, {})[number] = _plot(
                at_s,
                "rad/s",
                np.interp(at_s, p.throw.imu_t_s, measured, left=np.nan, right=np.nan),
                {case: o.gyro_rad_per_s[k, :rows, PITCH_AXIS] for case, (_, o) in found.items()},
            )
        if p.throw.ball_t_s.size > 1:
            plots.setdefault(HEIGHT, {})[number] = _plot(
                p.throw.ball_t_s,
                "m",
                p.throw.ball_m[:, 2],
                {c: _height(p, o.ball_position_m[k, :, 2]) for c, (_, o) in found.items()},
            )
    return plots


def _plot(
    at_s: Array, unit: str, measured: Array, lookalikes: Mapping[str, Array]
) -> dict[str, Any]:
    return {
        "x": _listed(at_s),
        "x_unit": "s",
        "unit": unit,
        "measured": _listed(measured),
        **{case: _listed(values) for case, values in lookalikes.items()},
    }


def _shown(prepared: Sequence[PreparedThrow]) -> list[PreparedThrow]:
    places = np.unique(np.linspace(0, len(prepared) - 1, SHOWN_COUNT).round().astype(int))
    return [prepared[int(place)] for place in places]


def _number(problem: GapProblem, p: PreparedThrow) -> int:
    return next(i for i, other in enumerate(problem.prepared, start=1) if other is p)


def _simulate(
    problem: GapProblem,
    shown: Sequence[PreparedThrow],
    effects: tuple[Effect, ...],
    *,
    is_driven: bool,
) -> tuple[list[Array], ReplayOutput]:
    """Corrected joint velocities (T, 4) of each throw, and the replay from these or measured ones."""
    inputs = [p.input for p in shown]
    driven = replay_drives(
        inputs,
        [ReplayElement(i, effects) for i in range(len(inputs))],
        problem.profile,
        problem.calibration,
    )
    present = (*problem.profile.effects, *effects)
    moved = [
        corrected_input(p, problem.healthy, driven[k], joint_latency_s(present, p.input))
        for k, p in enumerate(shown)
    ]
    elements = [ReplayElement(i, effects, measured_joints=ALL) for i in range(len(inputs))]
    given = moved if is_driven else inputs
    output = replay(given, elements, problem.profile, problem.calibration)
    return [data.velocity_rad_m_per_s for data in moved], output


def _height(p: PreparedThrow, height_m: Array) -> Array:
    """Height of the twin's load at the times of the tracker; NaN while it is not in the air."""
    flying = np.flatnonzero(np.isfinite(height_m))
    if flying.size < 2:
        return np.full(p.throw.ball_t_s.size, np.nan)
    at_s = float(p.motion.t_s[0]) + flying * CONTROL_PERIOD_S
    return np.interp(p.throw.ball_t_s, at_s, height_m[flying], left=np.nan, right=np.nan)


def _listed(values: Array) -> list[float | None]:
    """Rounded, None where there is no number."""
    return [round(float(v), DIGITS) if np.isfinite(v) else None for v in values]
