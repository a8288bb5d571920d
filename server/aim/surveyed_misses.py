"""Measured throws of a machine from the history, as aim corrections are made from them."""

from typing import Final, NamedTuple

import numpy as np
from sqlalchemy import select

from machine.conventions import Mode
from machine.messages import AimShift
from server.aim.bias_map import Misses
from server.schemas.history import Outcome
from server.store.database import Database
from server.store.models import Plan, Throw
from server.store.throw_filters import threw_a_ball

CONSIDERED_COUNT: Final = 1000
"""Newest throws."""


class SurveyedMisses(NamedTuple):
    """Throws and their misses, oldest first."""

    throw_ids: tuple[str, ...]
    misses: Misses


def surveyed_misses(
    database: Database,
    machine_id: str,
    mode: Mode,
    *,
    policy_sha256: str,
    calibration_sha256: str,
    twin_profile_version: int,
) -> SurveyedMisses:
    """Misses of throws that were made with this policy, calibration and twin profile.

    What a throw's plan corrected is added to its miss: it is then what the machine misses without.
    """
    columns = (
        Throw.range_m,
        Throw.target_z_m,
        Throw.measured_downrange_error_m,
        Throw.measured_crossrange_error_m,
        Throw.predicted_sd_downrange_m,
        Throw.predicted_sd_crossrange_m,
        Throw.predicted_downrange_error_m,
        Throw.predicted_crossrange_error_m,
    )
    query = (
        select(Throw.throw_id, Plan.aim, *columns)
        .join(Plan, Plan.plan_id == Throw.plan_id)
        .where(
            Throw.machine_id == machine_id,
            Throw.mode == mode.value,
            Throw.policy_sha256 == policy_sha256,
            Throw.outcome == Outcome.LANDED.value,
            threw_a_ball(),
            Plan.calibration_sha256 == calibration_sha256,
            Plan.twin_profile_version == twin_profile_version,
            *(column.is_not(None) for column in columns),
            Throw.predicted_sd_downrange_m > 0.0,
            Throw.predicted_sd_crossrange_m > 0.0,
        )
        .order_by(Throw.throw_id.desc())
        .limit(CONSIDERED_COUNT)
    )
    with database.read() as session:
        rows = session.execute(query).all()[::-1]
    values = np.array([row[2:] for row in rows], dtype=float).reshape(len(rows), len(columns))
    shifts = np.array([corrected_m(row[1]) for row in rows], dtype=float).reshape(len(rows), 2)
    # Columns from measured to measured minus predicted, without what the plan corrected.
    values[:, 2:4] += shifts - values[:, 6:8]
    return SurveyedMisses(tuple(row[0] for row in rows), Misses(*values.T))


def corrected_m(aim: dict[str, object] | None) -> tuple[float, float]:
    """Miss downrange and crossrange that a plan's aim correction took away; zero without one."""
    if aim is None:
        return 0.0, 0.0
    shift = AimShift.model_validate(aim)
    return shift.downrange_m, shift.crossrange_m
