"""Which throws a diagnosis takes: those to diagnose, and the healthy ones that they are compared with.

Only throws of the machine itself that landed and have a log; what cannot be used is refused, never left out.
"""

from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from sqlalchemy import Select, select
from sqlalchemy.orm import Session

from diagnosis.loading.kept_reference import LEAST_REFERENCE_COUNT, KeptReference
from server.errors import ConflictError
from server.schemas.gap import MAX_THROWS_COUNT, MIN_THROWS_COUNT, GapRunRequest
from server.schemas.history import Outcome
from server.store.database import Database
from server.store.models import Throw
from server.store.throw_filters import threw_a_ball


class ChosenThrows(NamedTuple):
    """Ids of throws, oldest first; none is in both."""

    throw_ids: tuple[str, ...]
    reference_throw_ids: tuple[str, ...]
    """Empty: compared with healthy machines of the type."""
    kept_logs: Mapping[str, Path] = {}
    """Logs of the reference throws that commissioning has kept, by id."""
    reference_days: Mapping[str, int] = {}
    """Those throws by day."""
    material_m: float | None = None
    """Least displacement of the impact from which an effect is claimed."""


def choose_throws(
    database: Database, machine_id: str, request: GapRunRequest, kept: KeptReference
) -> ChosenThrows:
    """Look up what a request names, and the reference throws that are kept where it names none.

    Raises:
        ConflictError: throws that cannot be used, or too few.
    """
    days = {path.stem: day for day, logs in kept.logs().items() for path in logs}
    paths = {path.stem: path for logs in kept.logs().values() for path in logs}
    asked = request.reference_throw_ids or ()
    healthy = tuple(throw_id for throw_id in asked if throw_id not in paths)
    with database.read() as session:
        if request.throw_ids is not None:
            throw_ids = _named(session, machine_id, request.throw_ids, "throws_unusable", "throws")
        else:
            throw_ids = _newest(session, machine_id, request, healthy)
        reference = _named(
            session, machine_id, healthy, "reference_unusable", "throws to compare with"
        )
    if len(throw_ids) < MIN_THROWS_COUNT:
        raise ConflictError(
            "too_few_throws",
            f"{machine_id} has {len(throw_ids)} landed throws with a log"
            f"{'' if request.mode is None else f' in {request.mode.value}'}"
            f"{f' beside the {len(healthy)} to compare with' if healthy else ''}; at least "
            f"{MIN_THROWS_COUNT} are needed, better 12. Throw more, at mixed targets.",
        )
    wanted = set(paths) & set(asked) if asked else set(paths) - set(throw_ids)
    known = [throw_id for throw_id in paths if throw_id in wanted][-MAX_THROWS_COUNT:]
    if not asked and (request.against == "type" or len(known) < LEAST_REFERENCE_COUNT):
        known = []
    return ChosenThrows(
        throw_ids,
        (*known, *reference),
        {throw_id: paths[throw_id] for throw_id in known},
        Counter(days[throw_id] for throw_id in known),
        request.material_m,
    )


def _usable(machine_id: str) -> Select[str]:
    return (
        select(Throw.throw_id)
        .where(
            Throw.machine_id == machine_id,
            Throw.has_log.is_(True),
            Throw.outcome == Outcome.LANDED.value,
            threw_a_ball(),
        )
        .order_by(Throw.throw_id.desc())
    )


def _named(
    session: Session, machine_id: str, wanted: tuple[str, ...], code: str, what: str
) -> tuple[str, ...]:
    rows = session.scalars(_usable(machine_id).where(Throw.throw_id.in_(wanted))).all()
    missing = sorted(set(wanted) - set(rows))
    if missing:
        raise ConflictError(
            code,
            f"{len(missing)} of {len(wanted)} {what} are not landed throws of {machine_id} with a "
            f"log and a ball: {', '.join(missing[:3])}. Leave them out.",
            {"throw_ids": list(missing)},
        )
    return tuple(reversed(rows))


def _newest(
    session: Session, machine_id: str, request: GapRunRequest, healthy: tuple[str, ...]
) -> tuple[str, ...]:
    wanted = _usable(machine_id).where(Throw.throw_id.not_in(healthy))
    if request.mode is not None:
        wanted = wanted.where(Throw.mode == request.mode.value)
    return tuple(reversed(session.scalars(wanted.limit(request.newest_count)).all()))
