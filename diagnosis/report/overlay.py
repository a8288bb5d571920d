"""Series for the report: what was measured, and what the twin says of the same commands, before and after.

Everything is simulated from the commands to the impact, so that a late joint is seen late downstream too.
What every healthy machine of the type differs by is taken into account before and after alike.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from diagnosis.causes.problem import Problem
from diagnosis.causes.residuals import ALL
from diagnosis.loading.prepared import PreparedThrow
from diagnosis.shrink import corrected_input
from diagnosis.simulate import joint_latency_s
from machine.conventions import ACTIVE_JOINTS, CONTROL_PERIOD_S, Array
from sim_twin.effects.effect import Effect
from sim_twin.replay.drives import replay_drives
from sim_twin.replay.replay import ReplayElement, replay
from sim_twin.replay.types import ReplayOutput

SHOWN_COUNT = 3
"""Throws: the first, one of the middle, and the last."""
DIGITS = 4
NO_EFFECTS: tuple[Effect, ...] = ()


def overlay(
    problem: Problem, effects: Sequence[Effect], first_joint: str | None = None
) -> dict[str, Any]:
    """Plots ``{name: {x, x_unit, unit, measured, twin_before, twin_after}}``; the last only with effects.

    Args:
        problem: the throws and their twin.
        effects: what was found.
        first_joint: the joint to show first.
    """
    shown = _shown(problem.prepared)
    cases = {"twin_before": NO_EFFECTS}
    if effects:
        cases["twin_after"] = tuple(effects)
    found = {name: _simulate(problem, shown, case) for name, case in cases.items()}
    joints = sorted(range(len(ACTIVE_JOINTS)), key=lambda j: ACTIVE_JOINTS[j] != first_joint)
    plots: dict[str, Any] = {}
    for joint in joints:
        unit = "m/s" if ACTIVE_JOINTS[joint] == "telescope" else "rad/s"
        for k, p in enumerate(shown):
            rows = p.motion.t_s.size
            plots[f"{ACTIVE_JOINTS[joint]} velocity, throw {_number(problem, p)}"] = {
                "x": _listed(p.motion.t_s),
                "x_unit": "s",
                "unit": unit,
                "measured": _listed(
                    np.interp(
                        p.motion.t_s,
                        p.throw.sensor_t_s,
                        p.throw.sensor_velocity_rad_m_per_s[:, joint],
                    )
                ),
                **{
                    name: _listed(velocity[k][:rows, joint])
                    for name, (velocity, _) in found.items()
                },
            }
    for k, p in enumerate(shown):
        if p.throw.ball_t_s.size < 2:
            continue
        plots[f"load's height in flight, throw {_number(problem, p)}"] = {
            "x": _listed(p.throw.ball_t_s),
            "x_unit": "s",
            "unit": "m",
            "measured": _listed(p.throw.ball_m[:, 2]),
            **{
                name: _listed(_height(p, output.ball_position_m[k, :, 2]))
                for name, (_, output) in found.items()
            },
        }
    return plots


def _shown(prepared: Sequence[PreparedThrow]) -> list[PreparedThrow]:
    places = np.unique(np.linspace(0, len(prepared) - 1, SHOWN_COUNT).round().astype(int))
    return [prepared[int(place)] for place in places]


def _number(problem: Problem, p: PreparedThrow) -> int:
    return next(i for i, other in enumerate(problem.prepared, start=1) if other is p)


def _simulate(
    problem: Problem, shown: Sequence[PreparedThrow], effects: tuple[Effect, ...]
) -> tuple[list[Array], ReplayOutput]:
    """Joint velocities (T, 4) a throw from its commands, corrected; and all that follows from them."""
    inputs = [p.input for p in shown]
    alone = replay_drives(
        inputs,
        [ReplayElement(i, effects) for i in range(len(inputs))],
        problem.profile,
        problem.calibration,
    )
    own = (*problem.profile.effects, *effects)
    moved = [
        corrected_input(p, problem.healthy, alone[k], joint_latency_s(own, p.input))
        for k, p in enumerate(shown)
    ]
    elements = [ReplayElement(i, effects, measured_joints=ALL) for i in range(len(inputs))]
    output = replay(moved, elements, problem.profile, problem.calibration)
    return [data.velocity_rad_m_per_s for data in moved], output


def _height(p: PreparedThrow, height_m: Array) -> Array:
    """The twin's load at the moments at which the real one was tracked; NaN when it was not in the air."""
    flying = np.flatnonzero(np.isfinite(height_m))
    if flying.size < 2:
        return np.full(p.throw.ball_t_s.size, np.nan)
    at_s = float(p.motion.t_s[0]) + flying * CONTROL_PERIOD_S
    return np.interp(p.throw.ball_t_s, at_s, height_m[flying], left=np.nan, right=np.nan)


def _listed(values: Array) -> list[float | None]:
    """Rounded, None where there is no number."""
    return [round(float(v), DIGITS) if np.isfinite(v) else None for v in values]
