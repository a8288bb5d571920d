"""The next version of a machine's twin profile from identified quantities."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.optimize import brentq

from diagnosis.identification.quantity import AxisSwing, Quantity
from diagnosis.identification.release_delay import ReleaseDelay
from diagnosis.identification.response import JointResponse
from machine.spec import MachineSpec
from sim_twin.effects.effect import Effect
from sim_twin.effects.table import EFFECTS
from sim_twin.twin.profile import TwinProfile

LENGTH_EFFECT = "gripper_length"
LENGTH_PARAMETER = "extra_length_m"
LONGEST_M = EFFECTS[LENGTH_EFFECT].parameter(LENGTH_PARAMETER).high
"""Bound of that effect, m (sim_twin.effects)."""


def with_response(profile: TwinProfile, joints: Sequence[JointResponse]) -> dict[str, Any]:
    """Response of the joints that were identified; the other joints keep theirs."""
    fields = ("dead_time_s", "natural_frequency_rad_per_s", "damping_ratio", "gain_ratio")
    values = {name: list(getattr(profile, name)) for name in fields}
    intervals: dict[str, tuple[float, float]] = {}
    for number, joint in enumerate(joints):
        needed = ("dead_time_s", "lag_s", "gain_ratio")
        if joint.best is None or any(joint.shared[name].value is None for name in needed):
            continue
        for name in fields:
            values[name][number] = joint.best[name]
            ci90 = joint.shared[name].ci90
            if ci90 is not None:
                intervals[f"{name}.{joint.joint}"] = ci90
    return {**{name: tuple(v) for name, v in values.items()}, "intervals": intervals}


def with_release(found: ReleaseDelay) -> dict[str, Any]:
    """Release delay and its standard deviation."""
    return _fields({"release_delay_s": found.mean, "release_delay_sd_s": found.sd})


def with_swing(
    profile: TwinProfile, axes: Sequence[AxisSwing], spec: MachineSpec
) -> dict[str, Any]:
    """Friction of both passive joints; the gripper's length as an effect where it differs from drawn."""
    changes: dict[str, Any] = {}
    intervals: dict[str, tuple[float, float]] = {}
    for field in ("viscous_friction_per_s", "coulomb_friction_rad_per_s2"):
        values = list(getattr(profile, field))
        for number, axis in enumerate(axes):
            known: Quantity = getattr(axis, field)
            if known.value is not None and known.ci90 is not None:
                values[number] = known.value
                intervals[f"{field}.{axis.joint}"] = (max(known.ci90[0], 0.0), known.ci90[1])
        changes[field] = tuple(values)
    extra = extra_length(axes, spec)
    if extra is not None and not extra[1] <= 0.0 <= extra[2]:
        others = tuple(e for e in profile.effects if e.effect != LENGTH_EFFECT)
        longer = Effect(effect=LENGTH_EFFECT, parameters={LENGTH_PARAMETER: extra[0]})
        changes["effects"] = (*others, longer)
        intervals[f"{LENGTH_EFFECT}.{LENGTH_PARAMETER}"] = extra[1:]
    return {**changes, "intervals": intervals}


def extra_length(axes: Sequence[AxisSwing], spec: MachineSpec) -> tuple[float, float, float] | None:
    """How much lower than drawn the gripper hangs, m, with an interval that covers both axes."""
    answers: list[tuple[float, float, float]] = []
    for number, axis in enumerate(axes):
        known = axis.length_m
        if known.value is None or known.ci90 is None:
            continue
        low, value, high = (
            _lower_by(length, number, spec)
            for length in (known.ci90[0], known.value, known.ci90[1])
        )
        answers.append((value, low, high))
    if not answers:
        return None
    value = float(np.mean([a[0] for a in answers]))
    return value, min(a[1] for a in answers), max(a[2] for a in answers)


def _lower_by(length_m: float, axis: int, spec: MachineSpec) -> float:
    """How much lower the centre of mass must be for this length of the equivalent pendulum, m."""
    low, high = swing_length(spec, axis, -LONGEST_M), swing_length(spec, axis, LONGEST_M)
    if length_m <= low or length_m >= high:
        return -LONGEST_M if length_m <= low else LONGEST_M
    found: Any = brentq(
        lambda extra: swing_length(spec, axis, extra) - length_m, -LONGEST_M, LONGEST_M
    )
    return float(found)


def swing_length(spec: MachineSpec, axis: int, extra_m: float = 0.0) -> float:
    """Length of the equivalent pendulum, m: inertia over mass moment about joint 0 (pitch) or 1 (roll)."""
    p = spec.passive
    arm = p.gripper_com_m + extra_m + (spec.geometry.pitch_to_roll_m if axis == 0 else 0.0)
    inertia = p.gripper_inertia_kg_m2[1 - axis] + p.gripper_mass_kg * arm**2
    moment = p.gripper_mass_kg * arm
    if axis == 0:
        inertia += p.hanger_inertia_kg_m2[1] + p.hanger_mass_kg * p.hanger_com_m**2
        moment += p.hanger_mass_kg * p.hanger_com_m
    return inertia / moment


def next_profile(
    profile: TwinProfile, changes: Mapping[str, Any], machine_id: str, note: str
) -> TwinProfile | None:
    """The next version with these changes; None when nothing was identified."""
    intervals: Mapping[str, tuple[float, float]] = changes.get("intervals", {})
    if not intervals:
        return None
    values = profile.model_dump()
    for name, value in changes.items():
        if name != "intervals":
            values[name] = [e.model_dump() for e in value] if name == "effects" else value
    values |= {
        "machine_id": machine_id,
        "version_count": profile.version_count + 1,
        "note": note,
        "intervals": {**values["intervals"], **intervals},
    }
    return TwinProfile.model_validate(values)


def _fields(known: Mapping[str, Quantity]) -> dict[str, Any]:
    values = {name: q.value for name, q in known.items() if q.value is not None}
    ends = {name: q.ci90 for name, q in known.items() if q.ci90 is not None}
    return {**values, "intervals": ends}
