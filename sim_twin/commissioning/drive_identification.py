"""Drives of a machine as oil springs where they explain its motion better, and what remains unexplained."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from machine.conventions import ACTIVE_JOINTS, CONTROL_PERIOD_S, Array
from sim_twin.commissioning.drive_fit import as_array, fit_drive, simulate
from sim_twin.commissioning.drive_motion import DriveMotion
from sim_twin.commissioning.response_fit import ResponseFit
from sim_twin.twin.oil_spring import FourDrives, OilSpringDrive
from sim_twin.twin.profile import TwinProfile

LEAST_GAIN_RATIO = 0.05
"""Share by which the error on runs that were not fitted must fall for an oil spring to be taken."""
HELD_OUT_EVERY = 4
"""One run in four judges the fit of the others."""
RISE_S = 0.6
"""Time after a change of the command that counts as rise or reversal, behind the dead time."""
STANDING_RAD_M_PER_S = 1e-4
"""Speed asked for below which a valve counts as closed: the tables' edge of the dead band."""
PHASES = ("rise", "reversal", "ringing")


class JointExplanation(NamedTuple):
    """What a joint's drive model explains of its motion, on runs that were not fitted."""

    joint: str
    drive: OilSpringDrive
    is_oil_spring: bool
    """Whether the oil spring replaces the linear response."""
    linear_explained_ratio: float
    """Share of the speed's variance that the linear response explains."""
    explained_ratio: float
    """Share that the chosen drive explains."""
    unexplained_by_phase_ratio: dict[str, float]
    """Shares of what is left: in the rise after a step, after a reversal, in the ringing after both."""
    residual_rad_m_per_s: float
    """Root mean square of what is left."""
    at_bound: tuple[str, ...]
    """Parameters that the search ended at a bound of."""
    plot_s: Array
    """(T,) times of the held-out run that is explained worst."""
    plot_measured: Array
    """(T,) its measured speed."""
    plot_simulated: Array
    """(T,) its simulated speed."""


def linear_drive(fit: ResponseFit) -> OilSpringDrive:
    """The linear response as a drive: all its damping is friction."""
    return OilSpringDrive(
        dead_time_s=fit.dead_time_s,
        valve_lag_s=0.0,
        natural_frequency_rad_per_s=fit.natural_frequency_rad_per_s,
        oil_damping_ratio=0.0,
        friction_damping_ratio=fit.damping_ratio,
        gain_ratio=fit.gain_ratio,
    )


def identify_drives(
    records: tuple[DriveMotion, ...],
    responses: tuple[ResponseFit, ...],
    show: Callable[[str], None] = lambda _: None,
) -> tuple[JointExplanation, ...]:
    """Fit an oil spring to each joint and judge it on runs that were not fitted.

    Args:
        records: one per driven joint.
        responses: linear response of each.
        show: called with the name of the next joint.
    """
    found: list[JointExplanation] = []
    for joint, record, response in zip(ACTIVE_JOINTS, records, responses, strict=True):
        show(f"  drive of the {joint} ...")
        found.append(explain_joint(joint, record, linear_drive(response)))
    return tuple(found)


def explain_joint(joint: str, record: DriveMotion, linear: OilSpringDrive) -> JointExplanation:
    """The better of an oil spring and the linear response, and what it leaves."""
    runs = np.arange(len(record.velocity_rad_m_per_s))
    judges = runs % HELD_OUT_EVERY == HELD_OUT_EVERY - 1
    held_out = record.runs(np.flatnonzero(judges))
    fit = fit_drive(record.runs(np.flatnonzero(~judges)))
    with_linear, with_oil = _error(held_out, linear), _error(held_out, fit.drive)
    better = _rms(with_oil) < (1.0 - LEAST_GAIN_RATIO) * _rms(with_linear)
    chosen = fit.drive if better else linear
    error = with_oil if better else with_linear
    worst = int(np.argmax((error**2).mean(axis=1)))
    measured = held_out.velocity_rad_m_per_s
    phases = _phases(held_out, chosen.dead_time_s)
    power = max(float((error**2).sum()), 1e-30)
    return JointExplanation(
        joint=joint,
        drive=chosen,
        is_oil_spring=better,
        linear_explained_ratio=_explained(measured, with_linear),
        explained_ratio=_explained(measured, error),
        unexplained_by_phase_ratio={
            name: float((error[phases == index] ** 2).sum()) / power
            for index, name in enumerate(PHASES)
        },
        residual_rad_m_per_s=_rms(error),
        at_bound=fit.at_bound if better else (),
        plot_s=CONTROL_PERIOD_S * np.arange(1, measured.shape[1] + 1),
        plot_measured=measured[worst],
        plot_simulated=measured[worst] + error[worst],
    )


def with_drives(profile: TwinProfile, found: tuple[JointExplanation, ...]) -> TwinProfile:
    """The profile with the drives, if any joint's is an oil spring."""
    if not any(one.is_oil_spring for one in found):
        return profile
    slew, boom, dipper, telescope = (one.drive for one in found)
    drives: FourDrives = (slew, boom, dipper, telescope)
    named = ", ".join(one.joint for one in found if one.is_oil_spring)
    note = f"{profile.note}; oil springs of {named} from steps, stops and reversals"
    return profile.model_copy(update={"drives": drives, "note": note})


def _error(record: DriveMotion, drive: OilSpringDrive) -> Array:
    """Simulated less measured speeds (N, T)."""
    return simulate(record, as_array(drive)[None])[0] - record.velocity_rad_m_per_s


def _rms(error: Array) -> float:
    return float(np.sqrt(np.mean(error**2)))


def _explained(measured: Array, error: Array) -> float:
    return 1.0 - float((error**2).sum() / ((measured - measured.mean()) ** 2).sum())


def _phases(record: DriveMotion, dead_time_s: float) -> Array:
    """Index into `PHASES` (N, T) of every tick."""
    speed = record.actuator_speed_rad_m_per_s
    side = np.where(np.abs(speed) > STANDING_RAD_M_PER_S, np.sign(speed), 0.0)
    changed = np.diff(speed, axis=1, prepend=0.0) != 0.0
    within = round((dead_time_s + RISE_S) / CONTROL_PERIOD_S)
    phases = np.full(speed.shape, PHASES.index("ringing"))
    for run, ticks in enumerate(changed):
        last = 0.0
        for tick in np.flatnonzero(ticks):
            now = float(side[run, tick])
            name = "ringing" if now == 0.0 else "reversal" if now * last < 0.0 else "rise"
            phases[run, tick : tick + within] = PHASES.index(name)
            last = now or last
    return phases
