"""Shadow: what another policy version would have done in throws that were recorded. Nothing moves.

Two questions, answered apart:

- In the same situations: the version is shown the observations that the network saw in the throw. How do its
  velocities differ up to the release, and when would it have let go?
- On its own: the version throws in the machine's twin from the same start at the same target and pace, and so
  does the version that flew. Where do both come down?
"""

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
from pydantic import ValidationError

from evaluation.shadow.results import PredictedThrow, ShadowReport, ShadowThrow
from machine.calibration import ValveCalibration
from machine.conventions import (
    DEFAULT_PACE_RATIO,
    RELEASE_THRESHOLD_RATIO,
    Array,
    Motion,
)
from machine.errors import LogError
from machine.messages import Target
from machine.reach import reach_m
from machine.spec import MachineSpec
from runtime.control.control_types import ControlParams
from runtime.control.policy import PolicyRunner
from runtime.records.throw_log import ThrowLog
from sim_twin.throws.campaign import ThrowOutcome, run_throws, throw_errors
from sim_twin.twin.profile import TwinProfile, exact_profile, nominal_profile
from sim_twin.twin.twin import Twin

MIN_STEP_COUNT: Final = 5
"""Policy steps below which a record says nothing of a policy."""


class _Usable(NamedTuple):
    log: ThrowLog
    target_m: Array
    start_rad_m: Array
    start_ns: int
    pace_ratio: float
    calibration: ValveCalibration
    profile: TwinProfile
    actions: Array
    """(S, A) of the version that flew, up to and with its release."""
    observations: Array
    """(S, D) without the pace."""
    times_s: Array
    """(S,) from the start."""


def shadow(
    candidate: PolicyRunner,
    logs: Sequence[ThrowLog],
    spec: MachineSpec,
    flown: Mapping[str, PolicyRunner] | None = None,
) -> ShadowReport:
    """Run a version over recorded throws, each in the twin and with the calibration of its machine.

    Args:
        candidate: the version.
        logs: throws; those of the other mode, of scripted motions, cut off before a release or out of the
            version's reach are left out, with the reason.
        spec: machine type.
        flown: versions at hand by their sha256, for the comparison in the twin.

    Raises:
        LogError: no throw can be used.
    """
    usable: list[_Usable] = []
    left_out: list[tuple[str, str]] = []
    for log in logs:
        found = _usable(candidate, log, spec)
        if isinstance(found, str):
            left_out.append((_id(log), found))
        else:
            usable.append(found)
    if not usable:
        reasons = "; ".join(f"{name}: {why}" for name, why in left_out[:3]) or "there are no logs"
        raise LogError(f"no throw can be shadowed by {candidate.card.policy_id}: {reasons}")
    known = flown or {}
    theirs: dict[int, PredictedThrow] = {}
    for sha256, runner in known.items():
        rows = [n for n, one in enumerate(usable) if one.log.metadata["policy_sha256"] == sha256]
        predictions = _predict(runner, [usable[n] for n in rows], spec)
        theirs |= dict(zip(rows, predictions, strict=True))
    ours = _predict(candidate, usable, spec)
    return ShadowReport(
        policy_id=candidate.card.policy_id,
        policy_sha256=candidate.card.policy_sha256,
        machine_ids=_machines(usable),
        mode=candidate.card.mode,
        unregistered_ids=_machines(
            [one for one in usable if not _is_registered(one.calibration, candidate)]
        ),
        throws=tuple(
            _compare(candidate, one, theirs.get(n), ours[n]) for n, one in enumerate(usable)
        ),
        left_out=tuple(left_out),
    )


def _machine_id(log: ThrowLog) -> str:
    return str(log.metadata.get("machine_id", ""))


def _machines(throws: Sequence[_Usable]) -> tuple[str, ...]:
    return tuple(sorted({_machine_id(one.log) for one in throws}))


def _id(log: ThrowLog) -> str:
    return str(log.metadata.get("throw_id", ""))


def _usable(candidate: PolicyRunner, log: ThrowLog, spec: MachineSpec) -> _Usable | str:
    """What is needed of a log, or why it cannot be used."""
    card, metadata = candidate.card, log.metadata
    if metadata.get("model_sha256") != spec.sha256:
        return "it is of another machine type"
    if metadata.get("mode") != card.mode.value:
        return f"it was thrown in {metadata.get('mode')}, the version throws in {card.mode.value}"
    if not metadata.get("policy_sha256") or metadata.get("test"):
        return "no policy threw it"
    moving = np.flatnonzero(log.control["motion_code_count"] == int(Motion.THROW))
    if not moving.size:
        return "the throw did not begin"
    start = log.control[moving[0]]
    start_ns = int(start["t_mono_ns"])
    rows = log.policy[log.policy["t_mono_ns"] >= start_ns]
    opens = np.flatnonzero(
        rows["action_ratio"][:, len(card.action_names) - 1] > RELEASE_THRESHOLD_RATIO
    )
    # After the release the network has no say; its rows there are of another situation.
    rows = rows[: opens[0] + 1] if opens.size else rows
    if rows.size < MIN_STEP_COUNT:
        return f"it has {rows.size} policy steps before its release, {MIN_STEP_COUNT} are needed"
    try:
        target = Target.model_validate(metadata["target"])
        calibration = ValveCalibration.model_validate(metadata["calibration"])
        given = metadata.get("twin_profile")
        profile = nominal_profile(spec) if given is None else TwinProfile.model_validate(given)
    except (KeyError, ValidationError) as error:
        return f"its target, calibration or twin cannot be read ({_first_line(error)})"
    reach = reach_m(card, target.z_m)
    range_m = math.hypot(target.x_m, target.y_m)
    if range_m > reach + 1e-9:
        return f"its target is {range_m:.2f} m away, the version reaches {reach:.2f} m"
    width = len(card.observation_names) - int(candidate.is_paced)
    return _Usable(
        log=log,
        target_m=np.array([target.x_m, target.y_m, target.z_m]),
        start_rad_m=np.asarray(start["joint_position_rad_m"], dtype=np.float64),
        start_ns=start_ns,
        pace_ratio=float(metadata.get("pace_ratio", DEFAULT_PACE_RATIO)),
        calibration=calibration,
        profile=profile,
        actions=np.asarray(rows["action_ratio"][:, : len(card.action_names)]),
        observations=np.asarray(rows["observation_ratio"][:, :width]),
        times_s=(rows["t_mono_ns"] - start_ns) * 1e-9,
    )


def _first_line(error: Exception) -> str:
    return str(error).splitlines()[0]


def _is_registered(calibration: ValveCalibration, runner: PolicyRunner) -> bool:
    sha256 = runner.card.policy_sha256
    return any(one.policy_sha256 == sha256 for one in calibration.registrations)


def _compare(
    candidate: PolicyRunner, one: _Usable, flown: PredictedThrow | None, own: PredictedThrow
) -> ShadowThrow:
    seen = one.observations
    if candidate.is_paced:
        seen = np.column_stack([seen, np.full(len(seen), one.pace_ratio)])
    asked = candidate.infer(seen)
    difference = np.clip(asked[:, :-1], -1.0, 1.0) - np.clip(one.actions[:, :-1], -1.0, 1.0)
    down, cross = _measured(one)
    return ShadowThrow(
        throw_id=_id(one.log),
        machine_id=_machine_id(one.log),
        target=Target(x_m=one.target_m[0], y_m=one.target_m[1], z_m=one.target_m[2]),
        pace_ratio=one.pace_ratio,
        step_count=len(seen),
        action_difference_rms_ratio=float(np.sqrt(np.mean(difference**2))),
        flown_release_s=_first_release_s(one.actions, one.times_s),
        shown_release_s=_first_release_s(asked, one.times_s),
        measured_downrange_error_m=down,
        measured_crossrange_error_m=cross,
        flown=flown,
        candidate=own,
    )


def _first_release_s(actions: Array, times_s: Array) -> float | None:
    (opens,) = (actions[:, -1] > RELEASE_THRESHOLD_RATIO).nonzero()
    return float(times_s[opens[0]]) if opens.size else None


def _measured(one: _Usable) -> tuple[float | None, float | None]:
    impact = one.log.impact
    if impact is None:
        return None, None
    down, cross = throw_errors(np.array([impact.position_m]), one.target_m[None])
    return float(down[0]), float(cross[0])


def _predict(
    runner: PolicyRunner, throws: Sequence[_Usable], spec: MachineSpec
) -> list[PredictedThrow]:
    """Each throw by a version in the twin, without scatter; side by side where pace and twin are the same."""
    groups: dict[tuple[float, str, str], list[int]] = defaultdict(list)
    for number, one in enumerate(throws):
        same = one.pace_ratio, one.calibration.sha256, one.profile.model_dump_json()
        groups[same].append(number)
    found: dict[int, PredictedThrow] = {}
    for numbers in groups.values():
        first = throws[numbers[0]]
        twin = Twin(
            count=len(numbers),
            profile=exact_profile(first.profile),
            calibration=first.calibration.for_twin(),
        )
        results = run_throws(
            twin,
            ControlParams(spec, first.calibration.for_twin(), runner.card.mode, runner),
            np.stack([throws[n].target_m for n in numbers]),
            np.stack([throws[n].start_rad_m for n in numbers]),
            seed=0,
            ends_at_release=True,
            pace_ratio=first.pace_ratio,
        )
        released_m = twin.payload.release_position_m
        for row, (number, result) in enumerate(zip(numbers, results, strict=True)):
            landed = result.outcome is ThrowOutcome.LANDED
            place = released_m[row]
            found[number] = PredictedThrow(
                outcome=result.outcome,
                release_s=result.throw_duration_s if landed else None,
                release_m=(float(place[0]), float(place[1]), float(place[2])) if landed else None,
                release_speed_m_per_s=result.release_speed_m_per_s if landed else None,
                downrange_error_m=result.downrange_error_m if landed else None,
                crossrange_error_m=result.crossrange_error_m if landed else None,
            )
    return [found[number] for number in range(len(throws))]
